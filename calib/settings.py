"""What the user may choose of a calibration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from calib.sound import TdoaMode

Method = Literal["joint", "ours-1", "ours-2", "ours-3"]
Block = Literal["speed", "buzzers", "scale", "corners", "intrinsics", "poses"]


@dataclass(frozen=True)
class Settings:
    """What the user may choose.

    Parameters
    ----------
    method : {"joint", "ours-1", "ours-2", "ours-3"}
    seed : int
        For first guesses drawn at random.
    reference_channel : int or None
        Input channel of the reference microphone of ours-1; None: the first.
    excluded_channels : tuple of int
        Input channels to leave out.
    tdoa : {"auto", "matched", "gcc-phat"}
        How arrivals are measured in the sound.
    hold : tuple of str
        Blocks of unknowns that joint holds: "speed", "buzzers", "scale", "corners", "intrinsics",
        "poses". Their own errors count in the covariance.
    exact : tuple of str
        Likewise, and known exactly.
    find_delays : bool
        Joint finds a delay of each channel.
    ignore_sync : bool
        Joint leaves open when emissions began, even where the board's sync output was recorded.
    suggest_poses : int
        How many further board positions joint suggests.
    """

    method: Method = "joint"
    seed: int = 0
    reference_channel: int | None = None
    excluded_channels: tuple[int, ...] = ()
    tdoa: TdoaMode = "auto"
    hold: tuple[Block, ...] = ()
    find_delays: bool = False
    suggest_poses: int = 0
    ignore_sync: bool = False
    exact: tuple[Block, ...] = ()

    @property
    def holds(self) -> tuple[Block, ...]:
        """What is held, known exactly or not."""
        return tuple(dict.fromkeys((*self.hold, *self.exact)))
