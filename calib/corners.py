"""The board's corners in the pictures: found in some frames of each pose, and averaged over them."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import chain, islice

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


SeenPoses = dict[int, "FloatArray | str"]  # corners (n_corners, 2) of a pose, or why it is left out


@dataclass(frozen=True)
class PoseCorners:
    """Corners of the poses at which the board was found standing still.

    Parameters
    ----------
    pose : (n_poses,) integer array
        The session's numbers of these poses, ascending.
    corners_px : (n_poses, n_corners, 2) array
        Mean over frames of the pose; NaN for hidden corners.
    left_out : dict of int to str
        Other poses, and why they are not among these.
    """

    pose: NDArray[np.int32]
    corners_px: FloatArray
    left_out: dict[int, str] = field(default_factory=dict)

    @property
    def warnings(self) -> list[str]:
        """Which poses were left out, and why, in words."""
        return [f"pose {pose} left out: {why}" for pose, why in self.left_out.items()]

    def only(self, chosen: NDArray[np.bool_]) -> PoseCorners:
        """Return some of the poses (n_poses,)."""
        return PoseCorners(self.pose[chosen], self.corners_px[chosen])


def find_pose_corners(session: Session, seen: SeenPoses | None = None, *, min_poses: int | None = None) -> PoseCorners:
    """Find the corners of every accepted pose, or take those that the session begins with.

    Parameters
    ----------
    session : Session
    seen : SeenPoses or None
        Poses that were looked at before, and need not be again; the new ones are added.
    min_poses : int or None
        How many are needed; None: as many as a calibration needs.

    Raises
    ------
    NotEnoughDataError
        The session has too few poses, or the board was found in too few of them.
    """
    accepted = sorted(int(row["pose"]) for row in session.poses if row["accepted"])
    needed = session.description.min_poses if min_poses is None else min_poses
    note = f" ({MIN_POSES} with camera.intrinsics in the rig description)" if needed > MIN_POSES else ""
    if len(accepted) < needed:
        raise NotEnoughDataError(
            f"the session has {len(accepted)} accepted {'pose' if len(accepted) == 1 else 'poses'}, at least {needed} "
            f"are needed{note}: capture a session with more, 25 are good"
        )
    measured = session.corners_px
    if measured is None:
        found = _seen_corners(session, accepted, {} if seen is None else seen)
    else:
        rows = np.flatnonzero(session.poses["accepted"])
        rows = rows[np.argsort(session.poses["pose"][rows])]
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
    poor = {
        int(pose): f"only {n} corners of the board were seen"
        for pose, n in zip(found.pose, n_corners, strict=True)
        if n < MIN_CORNERS
    }
    return replace(found.only(n_corners >= MIN_CORNERS), left_out=found.left_out | poor)


def _seen_corners(session: Session, accepted: list[int], seen: SeenPoses) -> PoseCorners:
    seen |= _look_at(session, [pose for pose in accepted if pose not in seen])
    board = session.description.board
    found = {pose: view for pose in accepted if not isinstance(view := seen[pose], str)}
    left_out = {pose: why for pose in accepted if isinstance(why := seen[pose], str)}
    corners_px = np.array(list(found.values())).reshape(-1, board.corners[0] * board.corners[1], 2)
    return PoseCorners(np.array(list(found), dtype=np.int32), corners_px, left_out)


def _look_at(session: Session, poses: list[int]) -> SeenPoses:
    """Find the board in the pictures of some poses."""
    board, still_px = session.description.board, session.description.capture.still_px
    frames = {pose: _spread(np.flatnonzero(session.frames["pose"] == pose)).tolist() for pose in poses}
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # OpenCV lets go of the interpreter lock
        views = pool.map(lambda frame: find_corners(session.picture(frame), board), chain(*frames.values()))
        return {
            pose: _agreed([view for view in islice(views, len(of_pose)) if view is not None], still_px)
            for pose, of_pose in frames.items()
        }


def _agreed(views: list[FloatArray], still_px: float) -> FloatArray | str:
    """Return the mean corners of a pose, or what is wrong with it."""
    if not views:
        return "the board was not found in its pictures"
    moved_px = max(movement_px(view, views[0]) for view in views)
    if moved_px > still_px:
        return f"the board moved by {moved_px:.2f} px between its pictures"
    return _mean_of_seen(np.array(views))


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
