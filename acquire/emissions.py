"""The emissions of a pose: a buzzer is fired, what was heard is checked, and a bad one is fired again."""

from __future__ import annotations

from dataclasses import dataclass

from acquire.checks import EmissionCheck, check_emission
from acquire.devices.base import EmissionStart
from acquire.recording import Recording
from acquire.status import State
from rigs.description import RigDescription

ChannelFaults = frozenset[tuple[int, str]]
_UNKNOWN_SAMPLE = -1


@dataclass(frozen=True)
class Shot:
    """One emission: when it began, where it is expected in the recording, and what is wrong with it as a whole."""

    start: EmissionStart
    expected_sample: int
    problem: str | None
    faults: ChannelFaults


class Emissions:
    """Fires buzzers and judges what the microphones heard.

    A channel that shows the same fault twice in a row is at fault itself, so the emission counts and is not repeated.

    Parameters
    ----------
    recording : Recording
    description : RigDescription
    """

    def __init__(self, recording: Recording, description: RigDescription) -> None:
        self._recording, self._description = recording, description
        self._waveform = description.signal.waveform()
        self._limits = description.capture
        self._known: ChannelFaults = frozenset()

    def fire(self, pose: int, buzzer: int, repeat: int) -> ChannelFaults | None:
        """Fire one buzzer until its emission is good, and store every attempt.

        Returns
        -------
        frozenset of (column, "silent" or "clipped"), what was wrong with single channels; None when no attempt was
        good.

        Raises
        ------
        DeviceError, InterruptedCaptureError
        """
        seen = self._known
        for retries_left in range(self._limits.retries, -1, -1):
            shot = self._shoot(pose, buzzer)
            new_faults = shot.faults - seen
            accepted = shot.problem is None and not (new_faults and retries_left)
            self._store(shot, pose, buzzer, repeat, accepted)
            if accepted:
                self._known = shot.faults
                return shot.faults
            seen |= shot.faults
            self._complain(buzzer, shot.problem or self._in_words(new_faults), retries_left)
        return None

    def _shoot(self, pose: int, buzzer: int) -> Shot:
        recording, status = self._recording, self._recording.status
        status.state, losses = State.FIRING, recording.losses
        start = recording.rig.trigger.play(buzzer, self._waveform)
        recording.record(self._waveform.duration_s + self._description.signal.gap_s, pose)
        expected_sample = recording.sample_at(start.host_time_s)
        if expected_sample is not None:
            recording.record_until(expected_sample + self._samples(self._waveform.duration_s + self._reach_s()), pose)
        status.state = State.CHECKING
        if expected_sample is None or recording.losses > losses:
            return Shot(start, _UNKNOWN_SAMPLE, "audio was lost while it sounded", frozenset())
        check = self._check(expected_sample)
        return Shot(start, expected_sample, check.problem(), check.channel_faults())

    def _check(self, expected_sample: int) -> EmissionCheck:
        before = self._samples(self._description.signal.gap_s)
        after = self._samples(self._waveform.duration_s + self._reach_s())
        first, samples = self._recording.samples(expected_sample - before, expected_sample + after)
        rate_hz = self._description.audio.sample_rate_hz
        samples = samples[:, : len(self._description.audio.microphone_channels())]  # the sync output is no microphone
        return check_emission(samples, expected_sample - first, self._waveform, self._limits, rate_hz)

    def _store(self, shot: Shot, pose: int, buzzer: int, repeat: int, accepted: bool) -> None:
        self._recording.writer.append_emission(
            pose=pose,
            buzzer=buzzer,
            repeat=repeat,
            waveform=self._waveform.label(),
            board_time_s=shot.start.board_time_s,
            host_time_s=shot.start.host_time_s,
            expected_sample=shot.expected_sample,
            accepted=accepted,
        )
        self._recording.flush()

    def _complain(self, buzzer: int, what: str, retries_left: int) -> None:
        place = f"{self._recording.status.pose_label()}, buzzer {buzzer}"
        if retries_left:
            self._recording.say("warning", f"{place}: {what}; firing it again")
            return
        remedy = "check its cable and plug" if what == "not heard" else "keep the room quiet and nothing else playing"
        self._recording.say(
            "warning", f"{place}: {what}, {self._limits.retries + 1} times: {remedy}; going on without it"
        )

    def _in_words(self, faults: ChannelFaults) -> str:
        channels = self._recording.status.channels
        return ", ".join(f"channel {channels[column]} {kind}" for column, kind in sorted(faults))

    def _reach_s(self) -> float:
        """Return how far after its expected onset an emission is looked for."""
        return max(self._description.signal.gap_s / 2, self._limits.onset_tolerance_s)

    def _samples(self, duration_s: float) -> int:
        return round(duration_s * self._description.audio.sample_rate_hz)
