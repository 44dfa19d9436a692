"""Residuals by microphone, buzzer, pose and distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.evidence import Evidence

FloatArray = NDArray[np.float64]

LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
N_BINS, LEAST_IN_BIN = 12, 8


@dataclass(frozen=True)
class Group:
    """Residuals of arrivals that have something in common.

    Parameters
    ----------
    label : int
        Of the microphone's channel, the buzzer or the pose.
    n_used, n_rejected : int
    quantiles_us : (5,) array
        At LEVELS, of those used; NaN where there are none.
    rms_us : float
    """

    label: int
    n_used: int
    n_rejected: int
    quantiles_us: FloatArray
    rms_us: float


def by_channel(evidence: Evidence, channels: tuple[int, ...]) -> list[Group]:
    """Return a group for each microphone."""
    labels = np.broadcast_to(np.array(channels), evidence.residuals_s.shape)
    return _groups(evidence, labels)


def by_buzzer(evidence: Evidence) -> list[Group]:
    """Return a group for each buzzer."""
    return _groups(evidence, np.broadcast_to(evidence.buzzer[:, None], evidence.residuals_s.shape))


def by_pose(evidence: Evidence) -> list[Group]:
    """Return a group for each pose."""
    return _groups(evidence, np.broadcast_to(evidence.pose[:, None], evidence.residuals_s.shape))


def over_distance(evidence: Evidence) -> tuple[FloatArray, FloatArray]:
    """Return bins' mean distances (n_bins,) in metres and the residuals' rms there (n_bins,) in microseconds."""
    chosen = evidence.used & evidence.present
    distances_m, residuals_us = evidence.distances_m[chosen], 1e6 * evidence.residuals_s[chosen]
    order = np.argsort(distances_m)
    bins = [part for part in np.array_split(order, N_BINS) if len(part) >= LEAST_IN_BIN]
    centres_m = np.array([distances_m[part].mean() for part in bins])
    return centres_m, np.array([np.sqrt(np.mean(residuals_us[part] ** 2)) for part in bins])


def corner_rms_by_pose(evidence: Evidence) -> FloatArray:
    """Return how well each pose's corners fit (n_poses,), root mean square in pixels; NaN where not known."""
    squares = np.sum(evidence.corner_residuals_px**2, axis=2)
    counts = np.isfinite(squares).sum(axis=1)
    return np.where(counts > 0, np.sqrt(np.nansum(squares, axis=1) / np.maximum(counts, 1)), np.nan)


def _groups(evidence: Evidence, labels: NDArray[np.int32]) -> list[Group]:
    return [_group(evidence, int(label), labels == label) for label in np.unique(labels)]


def _group(evidence: Evidence, label: int, among: NDArray[np.bool_]) -> Group:
    used = among & evidence.used & evidence.present
    residuals_us = 1e6 * evidence.residuals_s[used]
    n_rejected = int((among & evidence.present & ~evidence.used).sum())
    if not len(residuals_us):
        return Group(label, 0, n_rejected, np.full(len(LEVELS), np.nan), float("nan"))
    rms_us = float(np.sqrt(np.mean(residuals_us**2)))
    return Group(label, len(residuals_us), n_rejected, np.quantile(residuals_us, LEVELS), rms_us)
