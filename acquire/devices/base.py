"""What capture asks of its devices: three small protocols, and the two roles beside them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rigs.session.layout import Truth
from rigs.waveform import Waveform


@dataclass(frozen=True)
class AudioBlock:
    """Consecutive samples as the driver handed them over.

    Parameters
    ----------
    samples : (n_samples, n_channels) float32 array
        Full scale = 1; columns as in `Audio.recorded_channels`.
    host_time_s : float
        Host monotonic time at which the first sample was taken.
    adc_time_s : float
        The driver's own time of it, NaN where it has none.
    flags : int
        `rigs.session.layout.FLAG_*`.
    """

    samples: NDArray[np.float32]
    host_time_s: float
    adc_time_s: float
    flags: int = 0


@dataclass(frozen=True)
class Frame:
    """A picture (height, width) or (height, width, 3) of bytes, and the host monotonic time it was taken."""

    image: NDArray[np.uint8]
    host_time_s: float


@dataclass(frozen=True)
class EmissionStart:
    """When an emission began, by the trigger board's clock and by the host's monotonic clock."""

    board_time_s: float
    host_time_s: float


class TriggerBoard(Protocol):
    """The board that drives the buzzers, one at a time."""

    def open(self) -> str:
        """Connect and return the firmware's name and version. Raises DeviceError or FirmwareError."""

    def play(self, buzzer: int, waveform: Waveform) -> EmissionStart:
        """Start one emission and return at once. Raises DeviceError."""

    def close(self) -> None:
        """Silence the board and let it go; safe to call twice."""


class AudioInput(Protocol):
    """A sound device that records all channels synchronously."""

    def open(self) -> str:
        """Start recording and return the driver's name and version. Raises DeviceError."""

    def read(self) -> list[AudioBlock]:
        """Return the blocks that came in since the last call, in order. Raises DeviceError."""

    def close(self) -> None:
        """Stop recording; safe to call twice."""


class Camera(Protocol):
    """A camera; `warnings` holds what its driver refused when it was opened."""

    warnings: list[str]

    def open(self) -> str:
        """Start the camera and return the driver's name and version. Raises DeviceError."""

    def read(self) -> Frame:
        """Wait for the next frame and return it; never a stale one. Raises DeviceError."""

    def close(self) -> None:
        """Stop the camera; safe to call twice."""


class Clock(Protocol):
    """The host's monotonic clock, or a virtual one that only moves when somebody sleeps or reads."""

    def now_s(self) -> float:
        """Return the time in seconds."""

    def sleep_s(self, duration_s: float) -> None:
        """Let time pass."""


class Operator(Protocol):
    """Whoever moves the board."""

    def ask_for_pose(self, pose: int) -> None:
        """Ask for the next board position; returns at once."""


@dataclass(frozen=True)
class Rig:
    """The devices of one rig, ready to be opened."""

    trigger: TriggerBoard
    audio: AudioInput
    camera: Camera
    clock: Clock
    operator: Operator
    truth: Truth | None = None
