"""Where the operator will hold the board: full in view, near and far, tilted every way, all over the picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from acquire.devices.simulated.draws import draws
from acquire.devices.simulated.lens import picture_points_px
from acquire.devices.simulated.texture import plate_corners_m
from rigs.description import Board, Intrinsics
from rigs.geometry import Pose, rotation_matrix

FloatArray = NDArray[np.float64]
_DISTANCE_M = (0.4, 1.0)
_TILT_RAD = np.radians(35)
_ROLL_RAD = np.radians(20)
_EDGE = 0.02  # of the picture's width stays free around the plate
_ATTEMPTS = 400


def planned_pose(board: Board, intrinsics: Intrinsics, size_px: tuple[int, int], seed: int, pose: int) -> Pose:
    """Return `board_to_camera` of one planned pose; any pose number >= 0 has one.

    A place that leaves the picture is drawn again, nearer and nearer to its middle and at last further away.
    """
    rng = draws(seed, "pose", pose)
    rotation, distance_m = _draw_rotation(rng), _draw_distance_m(seed, pose)
    corners_m = plate_corners_m(board)
    for attempt in range(_ATTEMPTS):
        spread = max(0.0, 1 - attempt / 40)
        offset = spread * rng.uniform(-0.5, 0.5, 2) * size_px / np.array(intrinsics.focal_px)
        growth = 1.02 ** max(0, attempt - 40)
        centre_m = distance_m * growth * np.append(offset, 1.0)
        candidate = Pose(rotation, centre_m - rotation @ corners_m.mean(axis=0))
        if _is_in_view(candidate.apply(corners_m), intrinsics, size_px):
            break
    return candidate


def _draw_distance_m(seed: int, pose: int) -> float:
    """Spread the distances evenly, however many poses there are (steps of the golden ratio)."""
    share = (draws(seed, "distances").uniform() + pose * (np.sqrt(5) - 1) / 2) % 1
    return float(_DISTANCE_M[0] + share * (_DISTANCE_M[1] - _DISTANCE_M[0]))


def _draw_rotation(rng: np.random.Generator) -> FloatArray:
    direction, tilt = rng.uniform(0, 2 * np.pi), _TILT_RAD * np.sqrt(rng.uniform())
    tilted = rotation_matrix(tilt * np.array([np.cos(direction), np.sin(direction), 0.0]))
    return np.asarray(tilted @ rotation_matrix(np.array([0.0, 0.0, rng.uniform(-_ROLL_RAD, _ROLL_RAD)])))


def _is_in_view(points_m: FloatArray, intrinsics: Intrinsics, size_px: tuple[int, int]) -> bool:
    if points_m[:, 2].min() < _DISTANCE_M[0] / 2:
        return False
    pixels, free_px = picture_points_px(points_m, intrinsics), _EDGE * size_px[0]
    return bool((pixels > free_px).all() and (pixels < np.array(size_px) - free_px).all())
