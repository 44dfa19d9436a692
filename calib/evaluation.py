"""How far an answer is from the truth, where a session carries one; no single figure tells it all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigs.geometry import pair_distances, rigid_alignment

FloatArray = NDArray[np.float64]

PAPER_MICS = 8


@dataclass(frozen=True)
class Evaluation:
    """Errors against the truth, in metres.

    Parameters
    ----------
    truth : str
        Where the truth comes from.
    rmse_m : float
        Root mean square error of the microphones in the camera frame.
    rmse_aligned_m : float
        The same after the best rigid alignment: the array's shape alone.
    distance_rmse_m : float
        Root mean square error of the distances between microphones: shape and scale, no frame needed.
    rotation_deg : float
        Angle of the best rigid alignment: how far the truth's frame is turned against the camera's.
    paper_rmse_m : float or None
        The paper's figure for 8 microphones: squared errors of microphones 1 to 7 summed, over 8.
    """

    truth: str
    rmse_m: float
    rmse_aligned_m: float
    distance_rmse_m: float
    rotation_deg: float
    paper_rmse_m: float | None


def evaluate(positions_m: FloatArray, truth_m: FloatArray, source: str) -> Evaluation:
    """Compare positions with the truth, both (n_mics, 3) in the camera frame."""
    errors_m = positions_m - truth_m
    alignment = rigid_alignment(positions_m, truth_m)
    aligned_m = alignment.apply(positions_m) - truth_m
    cosine = np.clip((np.trace(alignment.rotation) - 1) / 2, -1.0, 1.0)
    distance_errors_m = pair_distances(positions_m) - pair_distances(truth_m)
    paper_rmse_m = None
    if len(positions_m) == PAPER_MICS:
        paper_rmse_m = float(np.sqrt(np.sum(errors_m[:7] ** 2) / PAPER_MICS))
    return Evaluation(
        truth=source,
        rmse_m=_rms_length(errors_m),
        rmse_aligned_m=_rms_length(aligned_m),
        distance_rmse_m=float(np.sqrt(np.mean(distance_errors_m**2))),
        rotation_deg=float(np.degrees(np.arccos(cosine))),
        paper_rmse_m=paper_rmse_m,
    )


def _rms_length(vectors_m: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors_m**2, axis=1))))
