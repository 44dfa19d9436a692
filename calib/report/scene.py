"""What turn.js draws: the array with its ellipsoids, the camera, and every board."""

from __future__ import annotations

from typing import Any

import numpy as np

from calib.report.geometry import SIGMAS_95, board_rims_m, drawn_boards, exaggeration, frustum_m
from calib.result import Calibration
from rigs.description import RigDescription


def scene(result: Calibration, description: RigDescription) -> dict[str, Any]:
    """Return the scene as plain values, metres and square metres in the camera frame."""
    return {
        "sigmas": SIGMAS_95,
        "exaggeration": exaggeration(result),
        "microphones": [
            {
                "channel": int(channel),
                "at": _rounded(place_m),
                "covariance": [[float(f"{value:.4g}") for value in row] for row in covariance],
                "std_mm": round(1e3 * float(np.linalg.norm(std_m)), 3),
            }
            for channel, place_m, covariance, std_m in zip(
                result.channels, result.positions_m, result.covariance_m2, result.std_m, strict=True
            )
        ],
        "frustum": [_rounded(corner) for corner in frustum_m(result)],
        "boards": [
            {"pose": int(pose), "rim": [_rounded(corner) for corner in rim[:4]]}
            for pose, rim in zip(
                result.view.pose[drawn_boards(result)], board_rims_m(result, description.board), strict=True
            )
        ],
    }


def _rounded(point_m: np.ndarray) -> list[float]:
    return [round(float(value), 5) for value in point_m]
