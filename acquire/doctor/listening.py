"""The listening: a moment of quiet, then every buzzer once, on all channels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquire.devices.base import AudioInput, ClockFit, TriggerBoard
from acquire.doctor.devices import Devices
from acquire.errors import DeviceError, DeviceRestartedError, FirmwareError
from acquire.sample_clock import SampleClock
from rigs.description import RigDescription
from rigs.session.layout import FLAG_GAP, FLAG_OVERFLOW

QUIET_S = 1.0
AFTER_S = 0.5  # for the latency of the audio path, and for the room
_STEP_S = 0.05


@dataclass(frozen=True)
class Sounds:
    """What was recorded, from the first moment to the last.

    Parameters
    ----------
    samples : (n_samples, n_channels) float32 array
        Of the microphones.
    sync : (n_samples, 0 or 1) float32 array
        Of the channel that is wired to the trigger board's sync output.
    quiet_end : int
        Before this row nothing sounded.
    starts : tuple of float
        For each buzzer fired, the row at which it began by the clocks, without the latency of the audio path.
    fit : ClockFit
        Of the samples to the host's clock.
    span_s : float
        Between the stamps of the first and the last block.
    span_samples : int
        As many came within that time.
    n_losses : int
        How often the sound device said that samples were lost.
    trigger_lost : DeviceError, FirmwareError or None
        Why the trigger board did not play every buzzer.
    """

    samples: NDArray[np.float32]
    sync: NDArray[np.float32]
    quiet_end: int
    starts: tuple[float, ...]
    fit: ClockFit
    span_s: float
    span_samples: int
    n_losses: int
    trigger_lost: DeviceError | FirmwareError | None


class Listening:
    """Takes in what the sound device delivers.

    Parameters
    ----------
    devices : Devices
        With audio.
    description : RigDescription
    """

    def __init__(self, devices: Devices, description: RigDescription) -> None:
        assert devices.audio is not None
        self._audio: AudioInput = devices.audio
        self._clock, self._description = devices.clock, description
        self._waveform = description.signal.waveform()
        self._sample_clock = SampleClock(description.audio.sample_rate_hz)
        self._blocks: list[NDArray[np.float32]] = []
        self._stamps: list[tuple[int, float]] = []
        self._starts_s: list[float] = []  # not placed yet
        self._starts: list[float] = []
        self._n_samples = self._n_losses = 0

    def hear(self, trigger: TriggerBoard | None) -> Sounds:
        """Record the quiet, then each buzzer in turn where there is a trigger board, as long as it plays.

        Raises
        ------
        DeviceError
            The sound device was lost.
        """
        self._take()  # what gathered while nobody listened
        began = self._n_samples
        self._listen(QUIET_S)
        quiet_end = self._n_samples
        lost: DeviceError | FirmwareError | None = None
        for buzzer in self._description.board.buzzers if trigger else ():
            assert trigger is not None
            try:
                self._starts_s.append(self._started(trigger, buzzer.id))
            except (DeviceError, FirmwareError) as error:
                lost = error
                break
            self._listen(self._waveform.duration_s + max(self._description.signal.gap_s, AFTER_S))
        self._place(float("inf"))
        return self._sounds(began, quiet_end, lost)

    def _started(self, trigger: TriggerBoard, buzzer: int) -> float:
        """Fire a buzzer, and return when it began; a board that has restarted is opened again, once."""
        try:
            return trigger.play(buzzer, self._waveform).host_time_s
        except DeviceRestartedError:
            trigger.close()
            trigger.open()
            return trigger.play(buzzer, self._waveform).host_time_s

    def _place(self, end_s: float) -> None:
        """Place the emissions that began before a moment, by the clock as it is: after a loss it is another one."""
        placed_s = [start_s for start_s in self._starts_s if start_s < end_s]
        rows = [self._sample_clock.sample_at(start_s) for start_s in placed_s]
        self._starts += [row for row in rows if row is not None]
        self._starts_s = self._starts_s[len(placed_s) :]

    def _sounds(self, began: int, quiet_end: int, trigger_lost: DeviceError | FirmwareError | None) -> Sounds:
        fit = self._sample_clock.longest_fit()
        assert fit is not None  # the device delivered when it was opened
        recorded = np.concatenate(self._blocks)[began:]
        n_mics = len(self._description.audio.microphone_channels())
        (first, first_s), (last, last_s) = self._stamps[0], self._stamps[-1]
        return Sounds(
            recorded[:, :n_mics],
            recorded[:, n_mics:],
            quiet_end - began,
            tuple(row - began for row in self._starts),
            fit,
            last_s - first_s,
            last - first,
            self._n_losses,
            trigger_lost,
        )

    def _listen(self, duration_s: float) -> None:
        end_s = self._clock.now_s() + duration_s
        while (left_s := end_s - self._clock.now_s()) > 1e-6:
            self._clock.sleep_s(min(_STEP_S, left_s))
            self._take()

    def _take(self) -> None:
        for block in self._audio.read():
            if block.flags & (FLAG_OVERFLOW | FLAG_GAP):
                self._n_losses += 1
                self._place(block.host_time_s - self._waveform.duration_s)  # those that are over
                self._sample_clock.restart()
            self._sample_clock.add(self._n_samples, block.host_time_s)
            self._stamps.append((self._n_samples, block.host_time_s))
            self._blocks.append(block.samples)
            self._n_samples += len(block.samples)
