"""The camera's intrinsics: given by the rig description, or found from the session's own pictures."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.corners import PoseCorners
from calib.errors import NotEnoughDataError
from rigs.board import board_corners_m, estimate_pose, project
from rigs.description import Board, Camera, Intrinsics
from rigs.geometry import Pose

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class View:
    """The camera and where it saw the board.

    Parameters
    ----------
    intrinsics : Intrinsics
    source : str
        "rig description" or "session".
    pose : (n_poses,) integer array
        The session's numbers of the poses.
    board_to_camera : list of Pose
    rms_px : float
        Root mean square distance of corners seen from corners projected.
    """

    intrinsics: Intrinsics
    source: str
    pose: NDArray[np.int32]
    board_to_camera: list[Pose]
    rms_px: float


def look(camera: Camera, board: Board, corners: PoseCorners) -> View:
    """Find intrinsics, where the rig description has none, and the board's poses.

    Raises
    ------
    NotEnoughDataError
        No pose could be found.
    """
    if isinstance(camera.intrinsics, Intrinsics):
        intrinsics, source = camera.intrinsics, "rig description"
    else:
        intrinsics, source = estimate_intrinsics(corners.corners_px, board, camera.size_px), "session"
    poses = [estimate_pose(view, board, intrinsics) for view in corners.corners_px]
    good = np.array([pose is not None for pose in poses])
    if not good.any():
        raise NotEnoughDataError("no board pose fits the corners: check camera.intrinsics and board.corners")
    found = [pose for pose in poses if pose is not None]
    residuals_px = corner_residuals_px(corners.corners_px[good], found, board, intrinsics)
    rms_px = float(np.sqrt(np.nanmean(np.sum(residuals_px**2, axis=2))))
    return View(intrinsics, source, corners.pose[good], found, rms_px)


def estimate_intrinsics(corners_px: FloatArray, board: Board, size_px: tuple[int, int]) -> Intrinsics:
    """Find focal lengths, principal point and distortion (k1, k2, p1, p2; k3 = 0) from corners (n, n_corners, 2).

    Source: Z. Zhang, IEEE TPAMI 22 (2000) 1330, doi:10.1109/34.888718, as OpenCV has it.
    """
    seen: NDArray[np.bool_] = np.asarray(np.isfinite(corners_px).all(axis=2))
    points = [board_corners_m(board)[view].astype(np.float32) for view in seen]
    pixels = [view_px[view].astype(np.float32) for view_px, view in zip(corners_px, seen, strict=True)]
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-10)
    # k3 costs more in noise than it explains for any lens short of a fisheye
    with _one_thread():
        _, matrix, distortion, _, _ = cv2.calibrateCamera(
            points, pixels, size_px, np.eye(3), np.zeros(5), flags=cv2.CALIB_FIX_K3, criteria=criteria
        )
    k1, k2, p1, p2 = (float(value) for value in np.ravel(distortion)[:4])
    return Intrinsics(
        focal_px=(float(matrix[0, 0]), float(matrix[1, 1])),
        principal_px=(float(matrix[0, 2]), float(matrix[1, 2])),
        distortion=(k1, k2, p1, p2, 0.0),
    )


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let OpenCV sum in one order: with several threads the last digits differ from run to run."""
    n_threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(n_threads)


def corner_residuals_px(corners_px: FloatArray, poses: list[Pose], board: Board, intrinsics: Intrinsics) -> FloatArray:
    """Return corners seen minus corners projected (n_poses, n_corners, 2), NaN where not seen."""
    points_m = board_corners_m(board)
    return np.asarray(corners_px - np.array([project(points_m, pose, intrinsics) for pose in poses]))
