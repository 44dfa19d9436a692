"""What an answer rests on, measurement by measurement, for those who want to look closer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class Evidence:
    """Residuals of all measurements.

    Parameters
    ----------
    pose, buzzer : (n_emissions,) integer arrays
        The session's number of the pose, and the buzzer's id.
    residuals_s : (n_emissions, n_mics) array
        Arrivals minus modelled ones, about the mean of their emission; NaN where missing.
    used : (n_emissions, n_mics) bool array
        Which the answer rests on.
    distances_m : (n_emissions, n_mics) array
        From buzzer to microphone.
    corners_px, corner_residuals_px : (n_poses, n_corners, 2) arrays
        Of the poses of the view, in their order; NaN where not seen.
    """

    pose: NDArray[np.int32]
    buzzer: NDArray[np.int32]
    residuals_s: FloatArray
    used: BoolArray
    distances_m: FloatArray
    corners_px: FloatArray
    corner_residuals_px: FloatArray

    @property
    def present(self) -> BoolArray:
        """Which arrivals (n_emissions, n_mics) are there."""
        return np.isfinite(self.residuals_s)


def arrivals_of_differences(differences_s: FloatArray, pairs: NDArray[np.int32], n_mics: int) -> FloatArray:
    """Share residuals of pairs out to microphones.

    Parameters
    ----------
    differences_s : (n_emissions, n_pairs) array
        Of pairs (i, j), that of j minus that of i; NaN where missing.
    pairs : (n_pairs, 2) integer array
    n_mics : int

    Returns
    -------
    (n_emissions, n_mics) array whose differences fit best, with the mean 0; NaN where no pair says anything.
    """
    incidence = np.zeros((len(pairs), n_mics))
    rows = np.arange(len(pairs))
    incidence[rows, pairs[:, 1]], incidence[rows, pairs[:, 0]] = 1.0, -1.0
    out = np.full((len(differences_s), n_mics), np.nan)
    for row, of_pairs_s in enumerate(differences_s):
        present = np.isfinite(of_pairs_s)
        heard = np.abs(incidence[present]).any(axis=0)
        out[row, heard] = np.linalg.lstsq(incidence[present][:, heard], of_pairs_s[present], rcond=None)[0]
    return out
