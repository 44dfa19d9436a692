"""The simulated sound device: all microphones, sampled together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from acquire.devices.base import AudioBlock
from acquire.devices.simulated.draws import draws
from acquire.devices.simulated.flaws import flawed_sound
from acquire.devices.simulated.oscillator import Oscillator
from acquire.devices.simulated.sound import SoundField
from acquire.devices.simulated.stage import Stage
from acquire.errors import DeviceError
from rigs.session.layout import FLAG_OVERFLOW

BLOCK_SAMPLES = 1024
_RATE_ERROR = 40e-6
_STAMP_JITTER_S = 0.001
_GAIN_SPREAD_DB = 2.0
_LOUD_GAIN = 200.0
_LOST_SAMPLES = 2000
_SKIPPED_SAMPLES = 12000


class SimulatedMicrophones:
    """Records a stage in whole blocks, as far as the virtual clock has come."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        scene = stage.scene
        self._channels = scene.description.audio.recorded_channels()
        rng = draws(scene.seed, "sound device")
        self._oscillator = Oscillator(stage.clock.now_s() - rng.uniform(10, 1000), 1 + _RATE_ERROR * rng.uniform(-1, 1))
        self._gain = 10 ** (rng.uniform(-_GAIN_SPREAD_DB, _GAIN_SPREAD_DB, len(self._channels)) / 20)
        self._sample_rate_hz = scene.description.audio.sample_rate_hz
        self._field = SoundField(scene, self._sample_rate_hz * self._oscillator.rate)
        self._noise = self._field.rms_at_1m * 10 ** (-scene.description.simulation.snr_db / 20)
        self._start_s: float | None = None
        self._next_sample = 0
        self._n_rendered = 0
        self._ringing: list[tuple[int, NDArray[np.float32]]] = []
        self._has_overflowed = self._has_jumped = False

    def open(self) -> str:
        """Start recording and return the driver's name and version. Raises DeviceError while it is unplugged."""
        if self._stage.is_out("audio_lost"):
            raise DeviceError("audio: there is no simulated sound device: plug it in")
        self._start_s = self._stage.clock.now_s()
        self._next_sample, self._ringing = 0, []
        self._n_rendered = len(self._stage.emissions)
        return "simulated-audio 1.0"

    def read(self) -> list[AudioBlock]:
        """Return the whole blocks that came in since the last call, in order.

        Raises
        ------
        DeviceError
            The device is not open, or lost.
        """
        if self._stage.is_out("audio_lost"):
            self._start_s = None
            raise DeviceError("audio: the simulated sound device is gone: check its cable")
        if self._start_s is None:
            raise DeviceError("audio: the simulated sound device is not open; open it first")
        self._render_new_emissions(self._start_s)
        blocks = []
        while (block := self._next_block(self._start_s)) is not None:
            blocks.append(block)
        return blocks

    def close(self) -> None:
        """Stop recording; safe to call twice."""
        self._start_s = None

    def _sample_at(self, host_s: float, start_s: float) -> float:
        return (host_s - start_s) * self._sample_rate_hz * self._oscillator.rate

    def _render_new_emissions(self, start_s: float) -> None:
        for emission in self._stage.emissions[self._n_rendered :]:
            self._ringing.append(self._field.heard(emission, self._sample_at(emission.start_s, start_s)))
        self._n_rendered = len(self._stage.emissions)

    def _next_block(self, start_s: float) -> AudioBlock | None:
        lost, skipped = self._samples_to_lose(), self._samples_to_skip()
        first = self._next_sample + lost + skipped
        if first + BLOCK_SAMPLES > self._sample_at(self._stage.clock.now_s(), start_s):
            return None
        self._next_sample = first + BLOCK_SAMPLES
        self._has_overflowed |= lost > 0
        self._has_jumped |= skipped > 0
        taken_s = start_s + first / (self._sample_rate_hz * self._oscillator.rate)
        rng = draws(self._stage.scene.seed, "microphone noise", first)
        samples = self._samples(first, rng)
        stamp_s = taken_s + _STAMP_JITTER_S * abs(rng.standard_normal())  # a callback comes late, never early
        return AudioBlock(samples, stamp_s, self._oscillator.reading_s(taken_s), FLAG_OVERFLOW if lost else 0)

    def _samples(self, first: int, rng: np.random.Generator) -> NDArray[np.float32]:
        block = self._noise * rng.standard_normal((BLOCK_SAMPLES, len(self._channels)), dtype=np.float32)
        self._ringing = [(start, sound) for start, sound in self._ringing if start + len(sound) > first]
        for start, sound in self._ringing:
            low, high = max(first, start), min(first + BLOCK_SAMPLES, start + len(sound))
            if low < high:
                block[low - first : high - first] += sound[low - start : high - start]
        block = flawed_sound(block * self._channel_gain(), first, self._stage, rng)
        return np.asarray(np.clip(block, -1.0, 1.0), dtype=np.float32)

    def _channel_gain(self) -> NDArray[np.float64]:
        gain = self._gain.copy()
        for kind, factor in (("loud_channel", _LOUD_GAIN), ("dead_channel", 0.0)):
            for fault in self._stage.faults(kind):
                gain[self._channels.index(fault.channel or self._channels[0])] *= factor
        return gain

    def _samples_to_skip(self) -> int:
        """Lose samples once and say nothing, while a sound of the pose is being recorded (fault clock_jump)."""
        if self._has_jumped or not self._ringing or not self._stage.faults("clock_jump"):
            return 0
        return _SKIPPED_SAMPLES if self._stage.emissions[-1].pose == self._stage.pose else 0

    def _samples_to_lose(self) -> int:
        """Lose samples once, while the first sound of the pose is being recorded (fault audio_overflow)."""
        if self._has_overflowed or not self._ringing or not self._stage.faults("audio_overflow"):
            return 0
        sounds_now = self._stage.emissions[-1].pose == self._stage.pose and self._ringing[-1][0] <= self._next_sample
        return _LOST_SAMPLES if sounds_now else 0
