"""The soundtrack: audio without a break on its way into the session file, and what is wrong with it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from acquire.clocks import Clocks
from acquire.devices.base import AudioBlock, Rig
from acquire.errors import DeviceLostError, losing
from acquire.holdups import REMEDIES, Cause, HoldUps
from acquire.losses import Losses
from acquire.status import Status
from rigs.description import RigDescription
from rigs.session.layout import FLAG_GAP, FLAG_OVERFLOW
from rigs.session.writer import SessionWriter

_MUTE_S = 1.0  # an unplugged sound device falls silent rather than failing
_FIRST_BLOCK_S = 2.0
_COMPLAIN_S = 30.0
_SLOW_SETTLING_S = 5.0  # stamps that are good from the first one are known to be after 3 s
_SETTLING_S = 15.0
_VOID_S = 2.0  # microphones always deliver some noise
VOID = (
    "all microphones deliver digital silence: unmute the sound device, switch on its phantom power, or correct "
    "audio.device and audio.channels"
)


class Soundtrack:
    """Stores what the sound device delivers, and holds the last of it at hand.

    Parameters
    ----------
    rig : Rig
        With its sound device open.
    writer : SessionWriter
    clocks : Clocks
        Told of every block.
    description : RigDescription
    status : Status
    say : callable
        Tells the operator and the log: level and text.
    holdups : HoldUps

    Attributes
    ----------
    losses : Losses
    """

    def __init__(
        self,
        rig: Rig,
        writer: SessionWriter,
        clocks: Clocks,
        description: RigDescription,
        status: Status,
        say: Callable[[str, str], None],
        holdups: HoldUps,
    ) -> None:
        self._audio, self._clock = rig.audio, rig.clock
        self._writer, self._clocks, self._status, self._say = writer, clocks, status, say
        self._holdups, self.losses = holdups, Losses(say)
        self._sample_rate_hz = float(description.audio.sample_rate_hz)
        self._n_microphones = len(description.audio.microphone_channels())
        self._void_s, self._is_void_told = 0.0, False
        signal = description.signal
        self._keep_samples = round((2 * signal.gap_s + signal.waveform().duration_s + 3) * self._sample_rate_hz)
        self._blocks: deque[tuple[int, NDArray[np.float32]]] = deque()
        self._complained_s = float("-inf")
        self._is_gap = False
        self._is_ready = self._is_awaited = False
        self._begin()

    def reopened(self) -> None:
        """Take note that the sound device was lost and is open again: what comes now follows a gap."""
        self._is_gap = True
        self._begin()

    def take(self) -> None:
        """Store the audio that has come in. Raises DeviceLostError where the device failed or fell silent."""
        with losing("audio"):
            blocks = self._audio.read()
        if blocks:
            self._note_backlog(blocks)
        for block in blocks:
            self._store(block)
        self._note_void()
        self.losses.pass_over(self._writer.n_samples / self._sample_rate_hz)
        self._check_mute()

    @property
    def is_void(self) -> bool:
        """No microphone has delivered anything but zeros for a while."""
        return self._void_s > _VOID_S

    def is_ready(self) -> bool:
        """Tell whether sound can be placed: its stamps have settled since the device was opened, or never do."""
        if self._is_ready:
            return True
        waited_s = self._clock.now_s() - self._opened_s
        if self._clocks.is_settled and not self._is_gap:  # what settled before a gap says nothing
            self._is_ready = True
        elif waited_s > _SETTLING_S:
            self._is_ready = True
            self._say(
                "warning",
                f"the sound device's times still shift {waited_s:.0f} s after it was opened, going on: close other "
                "programs, give it a USB port of its own",
            )
        elif waited_s > _SLOW_SETTLING_S and not self._is_awaited:
            self._is_awaited = True
            self._say("info", f"waiting until the sound device's times have settled, {_SETTLING_S:g} s at most")
        return self._is_ready

    def samples(self, first_sample: int, end_sample: int) -> tuple[int, NDArray[np.float32]]:
        """Return what is still at hand of rows `first_sample` to `end_sample`, and the row where it begins."""
        wanted = [block for block in self._blocks if block[0] < end_sample and block[0] + len(block[1]) > first_sample]
        if not wanted:
            return first_sample, self._blocks[-1][1][:0]
        begin = wanted[0][0]
        first = max(first_sample, begin)
        return first, np.concatenate([held for _, held in wanted])[first - begin : end_sample - begin]

    def _begin(self) -> None:
        self._opened_s = self._heard_s = self._clock.now_s()
        self._mute_s = _FIRST_BLOCK_S
        self._is_ready = self._is_awaited = False
        self._is_excused = True  # what came while the capture was set up had to wait

    def _store(self, block: AudioBlock) -> None:
        if not len(block.samples):
            return
        first_sample = self._writer.n_samples
        was_gone, self._is_gap = self._is_gap, False
        if was_gone:
            block = replace(block, flags=block.flags | FLAG_GAP)
        missing_s, step_s = self._clocks.missing_s(first_sample, block), self._clocks.hear(first_sample, block)
        flags = block.flags | (FLAG_GAP if step_s is not None else 0)
        with self._holdups.during(Cause.DISK):
            self._writer.append_audio(
                block.samples, host_time_s=block.host_time_s, adc_time_s=block.adc_time_s, flags=flags
            )
        if flags & (FLAG_OVERFLOW | FLAG_GAP):
            self._clocks.latency.forget()  # stamps that step may mean that the audio path has changed
            lost_s = step_s if step_s is not None else missing_s
            self.losses.note(
                first_sample / self._sample_rate_hz, lost_s, _why_lost(block.flags, step_s, was_gone=was_gone)
            )
        self._heard_s, self._mute_s = self._clock.now_s(), _MUTE_S
        has_sound = bool(block.samples[:, : self._n_microphones].any())
        self._void_s = 0.0 if has_sound else self._void_s + len(block.samples) / self._sample_rate_hz
        self._status.hear(block.samples, len(block.samples) / self._sample_rate_hz)
        self._hold(first_sample, block.samples)

    def _note_void(self) -> None:
        if self.is_void and not self._is_void_told:
            self._say("warning", VOID)
        self._is_void_told = self.is_void

    def _hold(self, first_sample: int, samples: NDArray[np.float32]) -> None:
        self._blocks.append((first_sample, samples))
        while first_sample - self._blocks[0][0] > self._keep_samples:
            self._blocks.popleft()

    def _note_backlog(self, blocks: list[AudioBlock]) -> None:
        waited_s = sum(len(block.samples) for block in blocks) / self._sample_rate_hz
        self._status.backlog_s = waited_s
        now_s, excused, cause = self._clock.now_s(), self._is_excused, self._holdups.blame()
        self._is_excused = False
        if self._status.is_behind and not excused and now_s - self._complained_s > _COMPLAIN_S:
            self._complained_s = now_s
            self._say(
                "warning",
                f"{waited_s:.1f} s of audio had to wait for {cause}, nothing of it is lost: {REMEDIES[cause]}",
            )

    def _check_mute(self) -> None:
        mute_s = self._clock.now_s() - self._heard_s
        if mute_s > self._mute_s:
            raise DeviceLostError(
                f"the sound device has delivered nothing for {mute_s:.0f} s: "
                "check that it is plugged in and not used by another program",
                "audio",
            )


def _why_lost(flags: int, step_s: float | None, *, was_gone: bool) -> str:
    if was_gone:
        return "the sound device was gone"
    if step_s is not None and step_s < 0:
        return f"the host's clock jumped by {-step_s:.2f} s: did the computer sleep?"
    who = "the sound device" if flags & (FLAG_OVERFLOW | FLAG_GAP) else "the clock"
    return f"{who} says so; close other programs if it happens again"
