"""What one solve of a growing session leaves to the next, so that nothing is looked at or listened to twice."""

from __future__ import annotations

from dataclasses import dataclass, field

from calib.corners import SeenPoses
from calib.joint.continuation import Continuation
from calib.sound import Ear


@dataclass
class Memory:
    """What is kept of the poses so far.

    Parameters
    ----------
    ear : Ear
        Has heard their emissions.
    poses : SeenPoses
        Their corners.
    continuation : Continuation or None
        Where the last solve ended.
    is_over : bool
        No more poses come. Then only the corners are kept: all else is done as if the session was given at once.
    """

    ear: Ear
    poses: SeenPoses = field(default_factory=dict)
    continuation: Continuation | None = None
    is_over: bool = False
