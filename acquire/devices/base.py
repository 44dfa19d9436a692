"""What capture asks of its devices: three small protocols, and the two roles beside them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from rigs.session.layout import Truth
from rigs.waveform import Waveform

T = TypeVar("T")


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
    """A picture (height, width) or (height, width, 3) of bytes, and the host monotonic time it was taken.

    Where it was collected in a rhythm, `n_missing` tells how many that were due before it are missing: the camera did
    not send them, or they waited too long to be held any longer.
    """

    image: NDArray[np.uint8]
    host_time_s: float
    n_missing: int = 0


@dataclass(frozen=True)
class Rhythm:
    """One frame per interval, the first an interval after a host monotonic time."""

    since_s: float
    interval_s: float


@dataclass(frozen=True)
class EmissionStart:
    """When an emission began, by the trigger board's clock and by the host's monotonic clock."""

    board_time_s: float
    host_time_s: float
    host_std_s: float = float("nan")


@dataclass(frozen=True)
class Ping:
    """One reading of the trigger board's clock.

    Parameters
    ----------
    earliest_s, latest_s : float
        Host times between which it was read.
    board_s : float
        The reading, unrolled.
    """

    earliest_s: float
    latest_s: float
    board_s: float

    @property
    def middle_s(self) -> float:
        """The host time of the reading, as far as anybody can tell."""
        return 0.5 * (self.earliest_s + self.latest_s)

    @property
    def round_trip_s(self) -> float:
        """How long the reading may have taken."""
        return self.latest_s - self.earliest_s


@dataclass(frozen=True)
class ClockFit:
    """A line from a device's clock to the host's monotonic clock.

    Parameters
    ----------
    since_s : float
        Host time of the first reading it rests on.
    host_s, reading : float
        A point of the line: host time, and what the device's clock (seconds, or samples) read then.
    rate : float
        Of the device's clock, per second of the host.
    rate_std : float
        Standard deviation of `rate`, as a share of it.
    std_s : float
        Standard deviation of a host time that the line gives, within the readings it rests on.
    n_readings : int
        How many those are.
    """

    since_s: float
    host_s: float
    reading: float
    rate: float
    rate_std: float
    std_s: float
    n_readings: int


class TriggerBoard(Protocol):
    """The board that drives the buzzers, one at a time."""

    def open(self) -> str:
        """Connect and return the firmware's name and version. Raises DeviceError or FirmwareError."""

    def play(self, buzzer: int, waveform: Waveform) -> EmissionStart:
        """Start one emission and return at once.

        Raises
        ------
        DeviceRestartedError
            The board forgot what it was told, but answers: close it, open it, and play again.
        DeviceError
            It is lost, or cannot play this.
        """

    def read_clock(self) -> list[Ping]:
        """Read the board's clock once more, and return all readings since the last call. Raises as `play` does."""

    def clock_fit(self) -> ClockFit:
        """Return the line from the board's clock to the host's; it holds since the board was opened last."""

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
        """Wait for the next frame and return it; never a stale one. Raises DeviceError, also where it is frozen."""

    def collect(self, rhythm: Rhythm | None) -> int:
        """Collect frames from now on, also after it was lost and opened again; None: no more, and forget them.

        Returns how many were due until now and are missing, beyond those of which the collected frames tell.
        """

    def collected(self) -> list[Frame]:
        """Return the frames collected since the last call, in order, without waiting; none while it is closed.

        Raises
        ------
        DeviceError
            It is lost or frozen, and nothing that it sent before is left.
        """

    def close(self) -> None:
        """Stop the camera; safe to call twice."""


class Clock(Protocol):
    """The host's monotonic clock, or a virtual one that only moves when somebody sleeps or reads."""

    def now_s(self) -> float:
        """Return the time in seconds."""

    def sleep_s(self, duration_s: float) -> None:
        """Let time pass."""

    def wait_for(self, call: Callable[[], T], meanwhile: Callable[[], None]) -> T:
        """Return what a device's call returns, or raise what it raises; `meanwhile` is called while it waits."""


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
