"""The errors of a verification in figures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.verification.pipeline import Verification

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Spread:
    """How one error is spread over the emissions located.

    Parameters
    ----------
    name : str
        With its unit.
    median, rms, percentile_95, largest : float
    expected_rms : float or None
        Root mean square that the covariances promise, where there is such a promise.
    """

    name: str
    median: float
    rms: float
    percentile_95: float
    largest: float
    expected_rms: float | None = None


def spreads(verification: Verification) -> list[Spread]:
    """Return the figures of every kind of error; none where nothing was located."""
    one, found = verification.comparison, verification.located.found
    if not found.any():
        return []
    out = [
        _spread("picture_px", one.error_px[found], one.expected_px[found]),
        _spread("bearing_deg", one.error_deg[found], one.expected_deg[found]),
        _spread("space_m", one.error_m[found], one.expected_m[found]),
        _spread("across_m", one.across_m[found]),
        _spread("space_m_per_m", one.error_m[found] / one.distance_m[found]),
    ]
    steered_px = verification.steered_error_px
    return out if steered_px is None else [*out, _spread("steered_px", steered_px)]


def _spread(name: str, errors: FloatArray, expected: FloatArray | None = None) -> Spread:
    return Spread(
        name,
        float(np.median(errors)),
        float(np.sqrt(np.mean(errors**2))),
        float(np.percentile(errors, 95)),
        float(errors.max()),
        None if expected is None else float(np.sqrt(np.mean(expected**2))),
    )
