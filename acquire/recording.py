"""The recording: everything the devices deliver, on its way into the session file."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from acquire.devices.base import AudioBlock, Frame, Rig
from acquire.errors import DeviceError, InterruptedCaptureError
from acquire.sample_clock import SampleClock
from acquire.screen import Screen
from acquire.status import Message, Status
from rigs.description import RigDescription
from rigs.session.layout import FLAG_GAP, FLAG_OVERFLOW
from rigs.session.writer import SessionWriter

STEP_S = 0.1
_FLUSH_S = 1.0
_MUTE_S = 2.0  # an unplugged sound device falls silent rather than failing


class Recording:
    """Audio without a break, pictures where they are wanted, and log lines.

    Parameters
    ----------
    rig : Rig
        With its devices open.
    writer : SessionWriter
    description : RigDescription
    screen : Screen
    status : Status
        Kept up to date; the screen shows it.
    stop_wanted : callable
        True once somebody wants the capture to end.
    """

    def __init__(
        self,
        rig: Rig,
        writer: SessionWriter,
        description: RigDescription,
        screen: Screen,
        status: Status,
        stop_wanted: Callable[[], bool],
    ) -> None:
        self.rig, self.writer, self.status = rig, writer, status
        self.losses = 0
        self._screen, self._stop_wanted = screen, stop_wanted
        self._sample_rate_hz = float(description.audio.sample_rate_hz)
        self._frame_interval_s = description.capture.frame_interval_s
        signal = description.signal
        self._keep_samples = round((2 * signal.gap_s + signal.waveform().duration_s + 3) * self._sample_rate_hz)
        self._clock = SampleClock(self._sample_rate_hz)
        self._blocks: deque[tuple[int, NDArray[np.float32]]] = deque()
        now_s = rig.clock.now_s()
        self._start_s = self._flushed_s = self._heard_s = now_s
        self._frame_s = float("-inf")

    def say(self, level: str, text: str) -> None:
        """Tell the operator, and store it in the log; `level` is "info" or "warning"."""
        self.writer.append_log(self.rig.clock.now_s(), level, text)
        self.tell(level, text)

    def tell(self, level: str, text: str) -> None:
        """Tell the operator only."""
        message = Message(self.rig.clock.now_s() - self._start_s, level, text)
        self.status.messages.append(message)
        self._screen.say(message)

    def listen(self) -> None:
        """Store the audio that has come in.

        Raises
        ------
        DeviceError
            The sound device failed or fell silent.
        InterruptedCaptureError
            Somebody wants the capture to end.
        """
        if self._stop_wanted():
            raise InterruptedCaptureError("stopped on request")
        for block in self.rig.audio.read():
            self._store(block)
        now_s = self.rig.clock.now_s()
        if now_s - self._heard_s > _MUTE_S:
            raise DeviceError(
                f"the sound device has delivered nothing for {now_s - self._heard_s:.0f} s: "
                "check that it is plugged in and not used by another program"
            )
        if now_s - self._flushed_s >= _FLUSH_S:
            self.flush()
        self.status.time_s = now_s - self._start_s
        self._screen.show(self.status)

    def look(self) -> Frame:
        """Return the camera's next frame. Raises DeviceError and InterruptedCaptureError."""
        frame = self.rig.camera.read()
        self.listen()
        return frame

    def keep(self, frame: Frame, pose: int) -> None:
        """Store a frame."""
        self._frame_s = frame.host_time_s
        self.writer.append_frame(frame.image, host_time_s=frame.host_time_s, pose=pose)

    def record(self, duration_s: float, pose: int | None = None) -> None:
        """Let time pass, storing audio and, within a pose, now and then a frame.

        Raises DeviceError and InterruptedCaptureError.
        """
        end_s = self.rig.clock.now_s() + duration_s
        while (left_s := end_s - self.rig.clock.now_s()) > 1e-6:
            if pose is not None and self.rig.clock.now_s() - self._frame_s >= self._frame_interval_s:
                self.keep(self.look(), pose)
            else:
                self.rig.clock.sleep_s(min(STEP_S, left_s))
                self.listen()

    def record_until(self, sample: int, pose: int) -> None:
        """Record until a row of the recording is in, which comes later than its time by the device's latency."""
        end_s = self.rig.clock.now_s() + _MUTE_S
        while self.writer.n_samples < sample and self.rig.clock.now_s() < end_s:
            self.record(STEP_S, pose)

    def sample_at(self, host_time_s: float) -> int | None:
        """Return the row of the recording that was taken at a host time, None when that is unknown."""
        return self._clock.sample_at(host_time_s)

    def samples(self, first_sample: int, end_sample: int) -> tuple[int, NDArray[np.float32]]:
        """Return what is still at hand of rows `first_sample` to `end_sample`, and the row where it begins."""
        begin = self._blocks[0][0]
        held = np.concatenate([samples for _, samples in self._blocks])
        first = max(first_sample, begin)
        return first, held[first - begin : max(end_sample - begin, 0)]

    def flush(self) -> None:
        """Bring everything recorded so far safely into the file."""
        self.writer.flush()
        self._flushed_s = self.rig.clock.now_s()

    def _store(self, block: AudioBlock) -> None:
        if not len(block.samples):
            return
        first_sample = self.writer.n_samples
        overflowed = bool(block.flags & (FLAG_OVERFLOW | FLAG_GAP))
        if overflowed:
            self._clock.restart()
        jumped = self._clock.add(first_sample, block.host_time_s)
        flags = block.flags | (FLAG_GAP if jumped else 0)
        self.writer.append_audio(block.samples, host_time_s=block.host_time_s, adc_time_s=block.adc_time_s, flags=flags)
        if overflowed or jumped:
            self._note_loss(first_sample, "the sound device" if block.flags & FLAG_OVERFLOW else "the clock")
        self._heard_s = self.rig.clock.now_s()
        self.status.hear(block.samples, len(block.samples) / self._sample_rate_hz)
        self._hold(first_sample, block.samples)

    def _note_loss(self, sample: int, who: str) -> None:
        self.losses += 1
        self.say(
            "warning",
            f"{who} says audio was lost before {sample / self._sample_rate_hz:.1f} s of the recording: "
            "close other programs if it happens again",
        )

    def _hold(self, first_sample: int, samples: NDArray[np.float32]) -> None:
        self._blocks.append((first_sample, samples))
        while first_sample - self._blocks[0][0] > self._keep_samples:
            self._blocks.popleft()
