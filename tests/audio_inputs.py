"""Audio inputs for tests: a sound device of eight inputs that plays known sounds, simulated and behind PortAudio."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from simulated import make_description
from virtual_bench.pulse import PulseServer, pulse_server

from acquire.clock import MonotonicClock
from acquire.devices.audio_portaudio import PortAudioInput
from acquire.devices.base import AudioBlock, AudioInput, Clock
from acquire.devices.choose import choose_devices
from rigs.description import Audio

RATE_HZ = 48000
PULSE = {"driver": "portaudio", "device": {"name": "pulse"}}


@dataclass
class Source:
    """A sound device under test.

    Parameters
    ----------
    audio : AudioInput
        Not opened yet.
    sound : callable
        Makes each channel hear a click, later than the first one by what `delays_samples` says.
    take_away : callable
        Unplugs the device.
    """

    audio: AudioInput
    clock: Clock
    sound: Callable[[], None]
    take_away: Callable[[], None]

    def record(self, duration_s: float) -> list[AudioBlock]:
        """Return what comes in, asked for ten times a second as the capture does."""
        blocks = []
        end_s = self.clock.now_s() + duration_s
        while self.clock.now_s() < end_s:
            self.clock.sleep_s(0.1)
            blocks += self.audio.read()
        return blocks


@contextmanager
def pulse_source(channels: tuple[int, ...] = tuple(range(1, 9))) -> Iterator[tuple[Source, PulseServer]]:
    """Give a source on a private PulseAudio, and the server."""
    with pulse_server() as server, pytest.MonkeyPatch.context() as patch:
        for name, text in server.environment.items():
            patch.setenv(name, text)
        audio = PortAudioInput(Audio.model_validate(PULSE | {"channels": channels}))
        try:
            yield Source(audio, MonotonicClock(), lambda: server.play(clicks()) and None, server.kill), server
        finally:
            audio.close()


def simulated_source(monkeypatch: pytest.MonkeyPatch, channels: tuple[int, ...] = tuple(range(1, 9))) -> Source:
    """Return a source in the simulated room; its microphones hear the same clicks in place of a buzzer."""
    from acquire.devices.simulated.sound import SoundField

    def heard(_field: SoundField, _emission: object, start_sample: float) -> tuple[int, NDArray[np.float32]]:
        return round(start_sample), clicks()[:, np.array(channels) - 1]

    monkeypatch.setattr(SoundField, "heard", heard)
    faults = [{"kind": "audio_lost", "pose": 1}]
    description = make_description(audio={"channels": channels}, simulation={"faults": faults, "snr_db": 60})
    rig = choose_devices(description)
    rig.trigger.open()
    sound = lambda: rig.trigger.play(1, description.signal.waveform()) and None  # noqa: E731
    return Source(rig.audio, rig.clock, sound, lambda: rig.operator.ask_for_pose(1))


def clicks() -> NDArray[np.float32]:
    """Return half a second (n, 8) with a click on each input, 7 samples later from each to the next."""
    sound = np.zeros((RATE_HZ // 2, 8), dtype=np.float32)
    sound[RATE_HZ // 4 + 7 * np.arange(8), np.arange(8)] = 0.5
    return sound


def counted(n_samples: int) -> NDArray[np.float32]:
    """Return sound (n_samples, 8) in which each sample tells its number, exactly: see `lost_samples`."""
    return np.repeat((np.arange(1, n_samples + 1, dtype=np.float32) / 2**22)[:, None], 8, axis=1)


def lost_samples(samples: NDArray[np.float32]) -> int:
    """Return how many samples of `counted` are missing from (n, 8); there must be some, in order.

    A player that a busy machine holds up leaves silence in place of as many samples or fewer: that is no loss.
    """
    number = np.asarray(np.rint(samples[:, 0].astype(float) * 2**22), dtype=np.int64)
    rows = np.flatnonzero(number)
    assert len(rows) > 5 * RATE_HZ, "most of the sound was not recorded"
    steps = np.diff(number[rows])
    assert (steps > 0).all(), "samples came twice"
    return int(np.maximum(steps - np.diff(rows), 0).sum())


def wait_until(holds: Callable[[], bool], timeout_s: float = 20.0) -> None:
    """Wait until something holds; fail when it does not in time."""
    end_s = time.monotonic() + timeout_s
    while not holds():
        assert time.monotonic() < end_s, "it did not happen in time"
        time.sleep(0.02)
