"""The emissions of a pose: a buzzer is fired, what was heard is checked, and a bad one is fired again."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from acquire.checks import EmissionCheck, check_emission, find_onset
from acquire.clocks import Prediction
from acquire.devices.base import EmissionStart
from acquire.errors import DeviceLostError, DeviceRestartedError, losing
from acquire.latency import WIDE_WINDOW_S
from acquire.reconnection import Reconnection
from acquire.recording import Recording
from acquire.soundtrack import VOID
from acquire.status import State
from rigs.description import RigDescription

ChannelFaults = frozenset[tuple[int, str]]
_UNKNOWN_SAMPLE = -1


@dataclass(frozen=True)
class Onset:
    """Where an emission was expected and found in the recording.

    Parameters
    ----------
    predicted_sample, measured_sample : float
        Rows with their fraction, NaN where unknown.
    predicted_std_s : float
        Standard deviation of the prediction.
    latency_s : float
        A part of the prediction; NaN where it is not known yet.
    """

    predicted_sample: float = math.nan
    predicted_std_s: float = math.nan
    measured_sample: float = math.nan
    latency_s: float = math.nan


@dataclass(frozen=True)
class Shot:
    """One emission: when it began, what is wrong with it as a whole, and where it is in the recording."""

    start: EmissionStart
    problem: str | None
    faults: ChannelFaults = frozenset()
    onset: Onset = Onset()

    def expected_sample(self) -> int:
        """Return the row of the recording where it should begin."""
        sample = self.onset.predicted_sample
        return _UNKNOWN_SAMPLE if math.isnan(sample) else round(sample)


class Emissions:
    """Fires buzzers and judges what the microphones heard.

    A channel that shows the same fault twice in a row is at fault itself, so the emission counts and is not repeated.

    Parameters
    ----------
    recording : Recording
    description : RigDescription
    reconnection : Reconnection
        Opens a board again that has restarted.
    """

    def __init__(self, recording: Recording, description: RigDescription, reconnection: Reconnection) -> None:
        self._recording, self._description, self._reconnection = recording, description, reconnection
        self._clocks, self._trigger = recording.clocks, recording.rig.trigger
        self._waveform = description.signal.waveform()
        self._limits = description.capture
        self._rate_hz = description.audio.sample_rate_hz
        self._n_microphones = len(description.audio.microphone_channels())
        self._known: ChannelFaults = frozenset()

    def fire(self, pose: int, buzzer: int, repeat: int) -> ChannelFaults | None:
        """Fire one buzzer until its emission is good, and store every attempt.

        Returns
        -------
        frozenset of (column, "silent" or "clipped"), what was wrong with single channels; None when no attempt was
        good.

        Raises
        ------
        DeviceLostError, DeviceError, FirmwareError, DiskShortError, InterruptedCaptureError
        """
        seen = self._known
        for retries_left in range(self._limits.retries, -1, -1):
            shot = self._shoot(buzzer)
            new_faults = shot.faults - seen
            accepted = shot.problem is None and not (new_faults and retries_left)
            self._store(shot, pose, buzzer, repeat, accepted)
            if accepted:
                self._known = shot.faults
                return shot.faults
            seen |= shot.faults
            self._complain(buzzer, shot.problem or self._in_words(new_faults), retries_left)
        return None

    def _shoot(self, buzzer: int) -> Shot:
        recording, status = self._recording, self._recording.status
        status.state, losses = State.FIRING, recording.sound.losses.n
        start = self._started(buzzer)
        recording.record(self._waveform.duration_s + self._description.signal.gap_s)
        has_restarted = self._has_restarted()
        prediction = self._clocks.predict(start)
        if prediction is not None:
            self._wait_for(prediction, self._clocks.latency.window_s()[1])
        status.state = State.CHECKING
        if prediction is None or recording.sound.losses.n > losses:
            return Shot(start, "audio was lost while it sounded")
        if has_restarted:
            return Shot(start, "the board restarted while it sounded")
        return self._judged(start, prediction)

    def _started(self, buzzer: int) -> EmissionStart:
        while True:
            try:
                with losing("trigger"):
                    return self._recording.attend("trigger", lambda: self._trigger.play(buzzer, self._waveform))
            except DeviceRestartedError as error:
                self._reconnection.restore(DeviceLostError(str(error), "trigger"))

    def _has_restarted(self) -> bool:
        """Read the board's clock; where the board has restarted, nobody knows what it has played."""
        try:
            with losing("trigger"):
                pings = self._recording.attend("trigger", self._trigger.read_clock)
        except DeviceRestartedError as error:
            self._reconnection.restore(DeviceLostError(str(error), "trigger"))
            return True
        self._clocks.store(pings, self._trigger.clock_fit())
        return False

    def _wait_for(self, prediction: Prediction, last_s: float) -> None:
        """Record until the emission is in, even if it comes so much later than the clocks say."""
        wanted_s = last_s + self._waveform.duration_s + self._reach_s()
        self._recording.record_until(round(prediction.sample) + self._samples(wanted_s))

    def _judged(self, start: EmissionStart, prediction: Prediction) -> Shot:
        latency = self._clocks.latency
        if latency.is_known:
            known_s = latency.value_s
            check, offset_s = self._heard_at(prediction, known_s)
            onset = self._onset(prediction, known_s, offset_s)
            if check.problem() is None and latency.learn(offset_s):
                return Shot(start, None, check.channel_faults(), replace(onset, latency_s=known_s))
        return self._found(start, prediction)

    def _found(self, start: EmissionStart, prediction: Prediction) -> Shot:
        """Judge an emission that was not heard where expected, or of which nobody knows where to expect it."""
        latency = self._clocks.latency
        self._wait_for(prediction, WIDE_WINDOW_S[1])
        known_s = latency.value_s if latency.is_known else None
        found_s = self._found_s(prediction)
        if found_s is None:
            found_s = known_s or 0.0
        check, offset_s = self._heard_at(prediction, found_s)
        problem = check.problem() or self._doubt(offset_s, known_s)
        expected_s = found_s if problem is None or known_s is None else known_s
        onset = self._onset(prediction, expected_s, offset_s)
        return Shot(start, problem, check.channel_faults(), onset)

    def _doubt(self, offset_s: float, known_s: float | None) -> str | None:
        """Say why an emission heard at another moment than expected does not count; None where it tells the latency."""
        if self._clocks.latency.learn(offset_s):
            self._recording.say("info", f"latency of the audio: {1e3 * offset_s:.0f} ms, with the way of the sound")
            return None
        assert known_s is not None  # the first one is believed
        return f"heard {abs(offset_s - known_s) * 1e3:.0f} ms too {'late' if offset_s > known_s else 'early'}"

    def _heard_at(self, prediction: Prediction, latency_s: float) -> tuple[EmissionCheck, float]:
        """Return what was heard about a latency after the clocks' moment, and how long after it; NaN if not at all."""
        expected_sample = round(prediction.sample + latency_s * self._rate_hz)
        check = self._check(expected_sample)
        return check, (expected_sample - prediction.sample) / self._rate_hz + check.late_s()

    def _onset(self, prediction: Prediction, latency_s: float, offset_s: float) -> Onset:
        return Onset(
            predicted_sample=prediction.sample + latency_s * self._rate_hz,
            predicted_std_s=math.hypot(prediction.std_s, self._clocks.latency.std_s),
            measured_sample=prediction.sample + offset_s * self._rate_hz,
        )

    def _found_s(self, prediction: Prediction) -> float | None:
        """Return how much later than the clocks say the emission is heard, wherever it is; None where it is not."""
        first_s, last_s = WIDE_WINDOW_S
        first_sample = round(prediction.sample) + self._samples(first_s)
        end_sample = round(prediction.sample) + self._samples(last_s + self._waveform.duration_s)
        first_sample, samples = self._heard(first_sample, end_sample)
        onset = find_onset(samples, self._waveform, self._rate_hz)
        return None if onset is None else (first_sample + onset - prediction.sample) / self._rate_hz

    def _check(self, expected_sample: int) -> EmissionCheck:
        before = self._samples(self._description.signal.gap_s)
        after = self._samples(self._waveform.duration_s + self._reach_s())
        first, samples = self._heard(expected_sample - before, expected_sample + after)
        return check_emission(samples, expected_sample - first, self._waveform, self._limits, self._rate_hz)

    def _heard(self, first_sample: int, end_sample: int) -> tuple[int, NDArray[np.float32]]:
        """Return what the microphones heard, and the row where it begins; the sync output is no microphone."""
        first_sample, samples = self._recording.sound.samples(first_sample, end_sample)
        return first_sample, samples[:, : self._n_microphones]

    def _store(self, shot: Shot, pose: int, buzzer: int, repeat: int, accepted: bool) -> None:
        self._recording.writer.append_emission(
            pose=pose,
            buzzer=buzzer,
            repeat=repeat,
            waveform=self._waveform.label(),
            board_time_s=shot.start.board_time_s,
            host_time_s=shot.start.host_time_s,
            expected_sample=shot.expected_sample(),
            accepted=accepted,
            **asdict(shot.onset),
        )
        self._recording.flush()

    def _complain(self, buzzer: int, what: str, retries_left: int) -> None:
        place = f"{self._recording.status.pose_label()}, buzzer {buzzer}"
        if retries_left:
            self._recording.say("warning", f"{place}: {what}; firing it again")
            return
        remedy = "check its cable and plug" if what == "not heard" else "keep the room quiet and nothing else playing"
        remedy = VOID if self._recording.sound.is_void else remedy
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
        return round(duration_s * self._rate_hz)
