"""The board's corners in the pictures: found in some frames of each pose, and averaged over them."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from calib.errors import NotEnoughDataError
from rigs.board import find_corners, movement_px
from rigs.description import MIN_POSES
from rigs.session.reader import Session

FloatArray = NDArray[np.float64]

MIN_CORNERS = 8
ABSURD_PX = 1e5
_FRAMES_PER_POSE = 4  # the search for corners is most of the work, and their errors are mostly the same in each frame


@dataclass(frozen=True)
class PoseCorners:
    """Corners of the poses at which the board was found standing still.

    Parameters
    ----------
    pose : (n_poses,) integer array
        The session's numbers of these poses.
    corners_px : (n_poses, n_corners, 2) array
        Mean over frames of the pose; NaN for hidden corners.
    warnings : list of str
        Which poses were left out, and why.
    """

    pose: NDArray[np.int32]
    corners_px: FloatArray
    warnings: list[str] = field(default_factory=list)

    def only(self, chosen: NDArray[np.bool_]) -> PoseCorners:
        """Return some of the poses (n_poses,)."""
        return PoseCorners(self.pose[chosen], self.corners_px[chosen])


def find_pose_corners(session: Session, min_poses: int | None = None) -> PoseCorners:
    """Find the corners of every accepted pose, or take those that the session begins with.

    Parameters
    ----------
    session : Session
    min_poses : int or None
        How many are needed; None: as many as a calibration needs.

    Raises
    ------
    NotEnoughDataError
        The session has too few poses, or the board was found in too few of them.
    """
    accepted = [int(row["pose"]) for row in session.poses if row["accepted"]]
    needed = session.description.min_poses if min_poses is None else min_poses
    note = f" ({MIN_POSES} with camera.intrinsics in the rig description)" if needed > MIN_POSES else ""
    if len(accepted) < needed:
        raise NotEnoughDataError(
            f"the session has {len(accepted)} accepted poses, at least {needed} are needed{note}: capture a session "
            "with more, 25 are good"
        )
    measured = session.corners_px
    if measured is None:
        found = _seen_corners(session, accepted)
    else:
        rows = session.poses["accepted"] == 1
        found = PoseCorners(session.poses["pose"][rows], measured[rows])
    found = _with_enough_corners(found)
    if len(found.pose) < needed:
        raise NotEnoughDataError(
            f"the board was found standing still in {len(found.pose)} of {len(accepted)} poses, at least {needed} "
            f"are needed{note}: check board.corners and board.pattern in the rig description, light and focus"
        )
    return found


def _with_enough_corners(found: PoseCorners) -> PoseCorners:
    sane = (np.abs(found.corners_px) < ABSURD_PX).all(axis=2, keepdims=True)  # NaN is not less
    found = replace(found, corners_px=np.where(sane, found.corners_px, np.nan))
    n_corners = sane.sum(axis=(1, 2))
    warnings = [
        f"pose {pose} left out: only {n} corners of the board were seen"
        for pose, n in zip(found.pose, n_corners, strict=True)
        if n < MIN_CORNERS
    ]
    return replace(found.only(n_corners >= MIN_CORNERS), warnings=[*found.warnings, *warnings])


def _seen_corners(session: Session, accepted: list[int]) -> PoseCorners:
    board, still_px = session.description.board, session.description.capture.still_px
    frames = np.concatenate([_spread(np.flatnonzero(session.frames["pose"] == pose)) for pose in accepted])
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # OpenCV lets go of the interpreter lock
        seen = list(pool.map(lambda frame: find_corners(session.picture(frame), board), frames.tolist()))
    poses, corners, warnings = [], [], []
    for pose in accepted:
        views = [view for frame, view in zip(frames, seen, strict=True) if session.frames["pose"][frame] == pose
                 and view is not None]  # fmt: skip
        if not views:
            warnings.append(f"pose {pose} left out: the board was not found in its pictures")
            continue
        moved_px = max(movement_px(view, views[0]) for view in views)
        if moved_px > still_px:
            warnings.append(f"pose {pose} left out: the board moved by {moved_px:.2f} px between its pictures")
            continue
        poses.append(pose)
        corners.append(_mean_of_seen(np.array(views)))
    shape = (-1, board.corners[0] * board.corners[1], 2)
    return PoseCorners(np.array(poses, dtype=np.int32), np.array(corners).reshape(shape), warnings)


def _spread(frames: NDArray[np.intp]) -> NDArray[np.intp]:
    """Choose some of the frames of a pose, the first and the last among them."""
    if len(frames) <= _FRAMES_PER_POSE:
        return frames
    return np.asarray(frames[np.linspace(0, len(frames) - 1, _FRAMES_PER_POSE).round().astype(int)])


def _mean_of_seen(views: FloatArray) -> FloatArray:
    """Average corners (n_views, n_corners, 2) over the views that show them."""
    seen = np.isfinite(views).all(axis=2, keepdims=True)
    n_views = seen.sum(axis=0)
    total = np.where(seen, views, 0.0).sum(axis=0)
    return np.where(n_views > 0, total / np.maximum(n_views, 1), np.nan)
