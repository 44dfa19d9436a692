"""The stillness of the board: whether it is found, at a new place, and has come to rest."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from rigs.board import movement_px
from rigs.description import Capture

FloatArray = NDArray[np.float64]


class Sight(StrEnum):
    """What the camera sees of the board."""

    MISSING = "not found"
    SAME_PLACE = "where it was before"
    MOVING = "moving"
    SETTLING = "coming to rest"
    BLURRED = "blurred"
    STILL = "still"


class StillBoard:
    """Watches the corners until the board is found, somewhere new, and has stood still long enough.

    Parameters
    ----------
    limits : Capture
        `still_px`, `still_s` and `new_pose_px`.
    earlier_px : sequence of (n_corners, 2) arrays
        Corners of all accepted poses.
    """

    def __init__(self, limits: Capture, earlier_px: Sequence[FloatArray]) -> None:
        self._limits = limits
        self._earlier_px = earlier_px
        self._still_since: tuple[float, FloatArray] | None = None
        self.movement_px = float("nan")

    def see(self, corners_px: FloatArray | None, host_time_s: float) -> Sight:
        """Take the corners (n_corners, 2) of the next picture, None where the board is not found."""
        if corners_px is None:
            self._still_since, self.movement_px = None, float("nan")
            return Sight.MISSING
        if not all(self._is_new(corners_px, earlier_px) for earlier_px in self._earlier_px):
            self._still_since, self.movement_px = None, float("nan")
            return Sight.SAME_PLACE
        return self._follow(corners_px, host_time_s)

    def _is_new(self, corners_px: FloatArray, earlier_px: FloatArray) -> bool:
        return movement_px(corners_px, earlier_px) >= self._limits.new_pose_px

    def _follow(self, corners_px: FloatArray, host_time_s: float) -> Sight:
        if self._still_since is None:
            self._still_since = (host_time_s, corners_px)
        since_s, reference_px = self._still_since  # one reference for the whole time: a slow drift is movement too
        self.movement_px = movement_px(corners_px, reference_px)
        if not self.movement_px < self._limits.still_px:
            self._still_since = (host_time_s, corners_px)
            return Sight.MOVING
        return Sight.STILL if host_time_s - since_s >= self._limits.still_s else Sight.SETTLING
