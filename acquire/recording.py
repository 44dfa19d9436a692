"""The recording: everything the devices deliver, on its way into the session file."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquire.clocks import Clocks
from acquire.devices.base import AudioBlock, Frame, Rig
from acquire.disk import DiskSpace
from acquire.errors import DeviceLostError, InterruptedCaptureError, losing
from acquire.film import Film
from acquire.screen import Screen
from acquire.status import Message, Status
from rigs.description import RigDescription
from rigs.session.layout import FLAG_GAP, FLAG_OVERFLOW
from rigs.session.writer import SessionWriter

_STEP_S = 0.1
_FLUSH_S = 1.0
_MUTE_S = 1.0  # an unplugged sound device falls silent rather than failing
_FIRST_BLOCK_S = 2.0
_LATE_S = 2.0  # a device that is later than that has lost the sound
_COMPLAIN_S = 30.0


class Recording:
    """Audio without a break, the film of each pose, and log lines.

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

    Attributes
    ----------
    clocks : Clocks
    film : Film
    losses : int
        How often audio was lost so far.
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
        signal = description.signal
        self._keep_samples = round((2 * signal.gap_s + signal.waveform().duration_s + 3) * self._sample_rate_hz)
        self.clocks, self.film = Clocks(writer, description), Film(rig.camera, writer, description)
        self._disk = DiskSpace(Path(status.file), description)
        self._blocks: deque[tuple[int, NDArray[np.float32]]] = deque()
        now_s = rig.clock.now_s()
        self._start_s = self._flushed_s = now_s
        self._heard_s, self._mute_s = now_s, _FIRST_BLOCK_S
        self._complained_s = float("-inf")
        self._is_gap = self._is_excused = False

    def say(self, level: str, text: str) -> None:
        """Tell the operator, and store it in the log; `level` is "info", "warning" or "error"."""
        self.note(level, text)
        self.tell(level, text)

    def note(self, level: str, text: str) -> None:
        """Store it in the log only."""
        self.writer.append_log(self.rig.clock.now_s(), level, text)

    def tell(self, level: str, text: str) -> None:
        """Tell the operator only."""
        message = Message(self.rig.clock.now_s() - self._start_s, level, text)
        self.status.messages.append(message)
        self._screen.say(message)

    def listen(self) -> None:
        """Store the audio that has come in, and within a pose the frames.

        Raises
        ------
        DeviceLostError
            The sound device failed or fell silent, or the camera is lost.
        DiskShortError
            The disk is nearly full.
        InterruptedCaptureError
            Somebody wants the capture to end.
        """
        with losing("audio"):
            blocks = self.rig.audio.read()
        for block in blocks:
            self._store(block)
        self._note_backlog(blocks)
        self._check_mute()
        self._watch()
        self._go_on()

    def idle(self, duration_s: float) -> None:
        """Let time pass without a sound device. Raises as `listen` does, but for the sound device."""
        self.rig.clock.sleep_s(duration_s)
        self._watch()
        self._go_on()

    def reopened(self, part: str) -> None:
        """Take note that a device was lost and is open again: "trigger", "audio" or "camera"."""
        self._is_excused = True  # opening takes seconds, in which audio waits
        if part == "audio":
            self._is_gap = True
            self._heard_s, self._mute_s = self.rig.clock.now_s(), _FIRST_BLOCK_S

    def look(self) -> Frame:
        """Return the camera's next frame. Raises DeviceLostError, and as `listen` does."""
        with losing("camera"):
            frame = self.rig.camera.read()
        self.listen()
        return frame

    def record(self, duration_s: float) -> None:
        """Let time pass, storing what comes in. Raises as `listen` does."""
        end_s = self.rig.clock.now_s() + duration_s
        while (left_s := end_s - self.rig.clock.now_s()) > 1e-6:
            self.rig.clock.sleep_s(min(_STEP_S, left_s))
            self.listen()

    def record_until(self, sample: int) -> None:
        """Record until a row of the recording is in, which comes later than its time, and nothing is in doubt."""
        end_s = self.rig.clock.now_s() + _LATE_S
        while self.writer.n_samples < sample or self.clocks.is_in_doubt:
            if self.rig.clock.now_s() > end_s:
                return
            self.record(_STEP_S)

    def samples(self, first_sample: int, end_sample: int) -> tuple[int, NDArray[np.float32]]:
        """Return what is still at hand of rows `first_sample` to `end_sample`, and the row where it begins."""
        wanted = [block for block in self._blocks if block[0] < end_sample and block[0] + len(block[1]) > first_sample]
        if not wanted:
            return first_sample, self._blocks[-1][1][:0]
        begin = wanted[0][0]
        first = max(first_sample, begin)
        return first, np.concatenate([held for _, held in wanted])[first - begin : end_sample - begin]

    def flush(self) -> None:
        """Bring everything recorded so far safely into the file."""
        self.writer.flush()
        self._flushed_s = self.rig.clock.now_s()

    def _watch(self) -> None:
        """Store the frames that have come in, within a pose."""
        with losing("camera"):
            self.film.store()

    def _store(self, block: AudioBlock) -> None:
        if not len(block.samples):
            return
        first_sample = self.writer.n_samples
        was_gone, self._is_gap = self._is_gap, False
        if was_gone:
            block = replace(block, flags=block.flags | FLAG_GAP)
        step_s = self.clocks.hear(first_sample, block)
        flags = block.flags | (FLAG_GAP if step_s is not None else 0)
        self.writer.append_audio(block.samples, host_time_s=block.host_time_s, adc_time_s=block.adc_time_s, flags=flags)
        if flags & (FLAG_OVERFLOW | FLAG_GAP):
            self._note_loss(first_sample, self._why_lost(block.flags, step_s, was_gone=was_gone))
        self._heard_s, self._mute_s = self.rig.clock.now_s(), _MUTE_S
        self.status.hear(block.samples, len(block.samples) / self._sample_rate_hz)
        self._hold(first_sample, block.samples)

    def _note_loss(self, sample: int, why: str) -> None:
        self.losses += 1
        self.clocks.latency.forget()  # stamps that step may mean that the audio path has changed
        where = f"before {sample / self._sample_rate_hz:.1f} s of the recording"
        self.say("warning", why.format(where=where))

    def _why_lost(self, flags: int, step_s: float | None, *, was_gone: bool) -> str:
        if was_gone:
            return "audio is missing {where}: the sound device was gone"
        if step_s is not None and step_s < 0:
            return f"the host's clock jumped by {-step_s:.2f} s {{where}}: did the computer sleep?"
        who = "the sound device" if flags & (FLAG_OVERFLOW | FLAG_GAP) else "the clock"
        return f"{who} says audio was lost {{where}}: close other programs if it happens again"

    def _note_backlog(self, blocks: list[AudioBlock]) -> None:
        if not blocks:
            return
        waited_s = sum(len(block.samples) for block in blocks) / self._sample_rate_hz
        self.status.backlog_s = waited_s
        now_s, excused = self.rig.clock.now_s(), self._is_excused
        self._is_excused = False
        if self.status.is_behind and not excused and now_s - self._complained_s > _COMPLAIN_S:
            self._complained_s = now_s
            self.say(
                "warning",
                f"{waited_s:.1f} s of audio had to wait, nothing of it is lost: the disk or the computer is too slow; "
                "close other programs or record to another disk",
            )

    def _check_mute(self) -> None:
        mute_s = self.rig.clock.now_s() - self._heard_s
        if mute_s > self._mute_s:
            raise DeviceLostError(
                f"the sound device has delivered nothing for {mute_s:.0f} s: "
                "check that it is plugged in and not used by another program",
                "audio",
            )

    def _go_on(self) -> None:
        """Flush and show what there is, unless this is the end."""
        if self._stop_wanted():
            raise InterruptedCaptureError("stopped on request")
        now_s = self.rig.clock.now_s()
        if now_s - self._flushed_s >= _FLUSH_S:
            self.flush()
            self._disk.check()
        self.status.time_s = now_s - self._start_s
        self._screen.show(self.status)

    def _hold(self, first_sample: int, samples: NDArray[np.float32]) -> None:
        self._blocks.append((first_sample, samples))
        while first_sample - self._blocks[0][0] > self._keep_samples:
            self._blocks.popleft()
