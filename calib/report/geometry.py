"""Lines that stand for the camera and the board in drawings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.result import Calibration
from rigs.board import board_corners_m
from rigs.description import Board

FloatArray = NDArray[np.float64]

MOST_BOARDS = 150
FRUSTUM_SHARE = 0.6  # of the distance to the nearest board
SIGMAS_95 = 2.7955  # half axes of an ellipsoid that holds 95 % of a Gaussian in three dimensions


def board_rim_m(board: Board) -> FloatArray:
    """Return the outermost inner corners (5, 3) in the board frame, the first again at the end."""
    corners = board_corners_m(board).reshape(board.corners[1], board.corners[0], 3)
    return corners[[0, 0, -1, -1, 0], [0, -1, -1, 0, 0]]


def spread(n: int, most: int) -> NDArray[np.intp]:
    """Choose at most so many of n things, evenly: a drawing of a long session would else be as large as the session."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(np.intp))


def drawn_boards(result: Calibration) -> NDArray[np.intp]:
    """Return the rows of the board positions that are drawn."""
    return spread(len(result.view.pose), MOST_BOARDS)


def board_rims_m(result: Calibration, board: Board) -> FloatArray:
    """Return the rims (n_drawn, 5, 3) of the board positions that are drawn, in the camera frame."""
    poses = result.view.board_to_camera
    return np.array([poses[row].apply(board_rim_m(board)) for row in drawn_boards(result)])


def frustum_m(result: Calibration) -> FloatArray:
    """Return the corners (4, 3) of what the camera sees, some way before it."""
    (width, height), intrinsics = result.recording.picture_size_px, result.view.intrinsics
    focal_px, principal_px = np.array(intrinsics.focal_px), np.array(intrinsics.principal_px)
    corners_px = np.array([(0, 0), (width, 0), (width, height), (0, height)])
    nearest_m = min(float(pose.translation_m[2]) for pose in result.view.board_to_camera)
    rays = np.column_stack([(corners_px - principal_px) / focal_px, np.ones(4)])
    return np.asarray(FRUSTUM_SHARE * nearest_m * rays)


def exaggeration(result: Calibration) -> int:
    """Return the factor, of 1, 2, 5, 10 and so on, by which ellipsoids must grow to be seen beside the array."""
    semi_axis_m = SIGMAS_95 * float(np.sqrt(np.median(np.linalg.eigvalsh(result.covariance_m2)[:, -1])))
    extent_m = float(np.ptp(result.positions_m, axis=0).max())
    wanted = 0.09 * extent_m / max(semi_axis_m, 1e-9)
    steps = [step * 10**power for power in range(4) for step in (1, 2, 5)]
    return max([step for step in steps if step <= wanted], default=1)
