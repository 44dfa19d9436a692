"""How much was seen and heard: fields of the picture, depth, and the share of sounds behind each microphone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.evidence import Evidence
from calib.result import Calibration
from rigs.description import RigDescription

FloatArray = NDArray[np.float64]

FIELDS = (6, 4)  # of the picture, across and down


def fields_seen(result: Calibration, evidence: Evidence) -> NDArray[np.bool_]:
    """Return which fields (down, across) of the picture hold a corner of the board."""
    corners_px = evidence.corners_px[np.isfinite(evidence.corners_px).all(axis=2)]
    edges = [
        np.linspace(0, size_px, n + 1) for size_px, n in zip(result.recording.picture_size_px, FIELDS, strict=True)
    ]
    counts, *_ = np.histogram2d(corners_px[:, 1], corners_px[:, 0], bins=(edges[1], edges[0]))
    return np.asarray(counts > 0)


def depth_ratio(result: Calibration) -> float:
    """Return how many times farther than the nearest board the farthest one was."""
    distances_m = [pose.translation_m[2] for pose in result.view.board_to_camera]
    return float(max(distances_m) / min(distances_m))


def heard_shares(result: Calibration, evidence: Evidence, description: RigDescription) -> FloatArray:
    """Return for each microphone (n_mics,) how many of the sounds that every pose should have had it rests on."""
    n_wanted = len(result.view.pose) * len(description.board.buzzers) * description.signal.repeats
    used = (evidence.used & evidence.present).sum(axis=0)
    return np.asarray(np.minimum(used / max(n_wanted, 1), 1.0))
