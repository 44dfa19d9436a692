"""How well TDOAs fit an answer, and whose they are."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from calib.result import Residual

FloatArray = NDArray[np.float64]

MIN_SIGMA_S = 1e-9


@dataclass(frozen=True)
class FittedTdoas:
    """Residuals of TDOAs.

    Parameters
    ----------
    pose, buzzer : (n_emissions,) integer arrays
        The session's number of the pose, and the buzzer's id.
    residuals_s : (n_emissions, n_pairs) array
        Measured minus modelled; NaN where missing.
    used : (n_emissions, n_pairs) bool array
        Which the answer rests on.
    speed_m_s : float
        Speed of sound of the answer.
    pose_names : dict of int to str
        What poses are called where not by their number.
    """

    pose: NDArray[np.int32]
    buzzer: NDArray[np.int32]
    residuals_s: FloatArray
    used: NDArray[np.bool_]
    speed_m_s: float
    pose_names: dict[int, str] = field(default_factory=dict)

    @property
    def present(self) -> NDArray[np.bool_]:
        """Which TDOAs (n_emissions, n_pairs) are there."""
        return np.isfinite(self.residuals_s)

    def residual(self) -> Residual:
        """Return the figures of the fit."""
        n_used = int(self.used.sum())
        rms_s = float(np.sqrt(np.mean(self.residuals_s[self.used] ** 2))) if n_used else float("nan")
        return Residual(robust_sigma(self.residuals_s), rms_s, n_used, int(self.present.sum()) - n_used)


def robust_sigma(residuals_s: FloatArray) -> float:
    """Return 1.4826 times the median absolute value of the finite residuals: a standard deviation blind to outliers."""
    return max(float(1.4826 * np.median(np.abs(residuals_s[np.isfinite(residuals_s)]))), MIN_SIGMA_S)
