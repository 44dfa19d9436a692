"""The status of a capture: what it does now, and what it tells; screens show it, tests read it."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

QUIET_DBFS = -90.0
_FALL_DB_PER_S = 30.0
CHANNEL_REMEDIES = {
    "silent": "check its cable, power and mute switch; calibration cannot place it",
    "clipped": "turn its gain down",
}
OFTEN_MISSED = 0.2  # of the times that a buzzer was fired
_BEHIND_S = 1.0  # audio that waited longer than this tells of a slow disk


class State(StrEnum):
    """The states of a capture; drawn in docs/capture.md."""

    OPENING = "opening"
    WAITING = "waiting"
    SETTLING = "settling"
    FIRING = "firing"
    CHECKING = "checking"
    COMPARING = "comparing"
    RECONNECTING = "reconnecting"
    FINISHED = "finished"
    INTERRUPTED = "interrupted"
    LOST = "lost"
    GIVEN_UP = "given up"


@dataclass(frozen=True)
class Message:
    """One line for the operator and for the log: "info" or "warning", and when, since the session began."""

    time_s: float
    level: str
    text: str


@dataclass
class Status:
    """What a screen shows.

    Parameters
    ----------
    rig, file : str
        Names of the rig and of the session file.
    channels : tuple of int
        Input channels, in the order of the columns of the recording.
    poses : int
        How many are wanted.
    n_emissions : int
        How many a pose has.
    earlier_s : float
        Sound that the file held before this run.
    faults : dict of int to str
        Of each channel that is at fault, what it is.
    fired, missed : Counter of int
        How often each buzzer was fired for good, and how often no attempt was good.
    """

    rig: str
    file: str
    channels: tuple[int, ...]
    poses: int
    n_emissions: int
    state: State = State.OPENING
    saved: int = 0
    time_s: float = 0.0
    earlier_s: float = 0.0
    buzzer: int | None = None
    emission: int = 0
    board: str = "not looked for yet"
    advice: str = ""
    faults: dict[int, str] = field(default_factory=dict)
    fired: Counter[int] = field(default_factory=Counter)
    missed: Counter[int] = field(default_factory=Counter)
    messages: deque[Message] = field(default_factory=lambda: deque(maxlen=20))
    backlog_s: float = 0.0
    level_dbfs: NDArray[np.float64] = field(init=False)

    def __post_init__(self) -> None:
        self.level_dbfs = np.full(len(self.channels), QUIET_DBFS)

    def hear(self, samples: NDArray[np.float32], duration_s: float) -> None:
        """Move the level meters: up at once to the peak of samples (n, n_channels), down slowly."""
        peak = np.nan_to_num(np.abs(samples).max(axis=0, initial=0.0)).astype(float)
        peak_dbfs = 20 * np.log10(np.maximum(peak, 10 ** (QUIET_DBFS / 20)))
        self.level_dbfs = np.maximum(peak_dbfs, self.level_dbfs - _FALL_DB_PER_S * duration_s)

    @property
    def silent(self) -> tuple[int, ...]:
        """Channels that heard nothing until the end."""
        return tuple(sorted(channel for channel, kind in self.faults.items() if kind == "silent"))

    @property
    def is_behind(self) -> bool:
        """Audio waits longer than it should before it is stored."""
        return self.backlog_s > _BEHIND_S

    def pose_label(self) -> str:
        """Return which pose is being captured, counted from 1."""
        return f"pose {min(self.saved + 1, self.poses)} of {self.poses}"
