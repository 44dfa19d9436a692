"""The noise of the channels: hum, and channels that record the same; it can be told without a buzzer."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from acquire.doctor.hearing import Hearing
from acquire.doctor.listening import Sounds
from acquire.doctor.row import Part, Row, State

FloatArray = NDArray[np.float64]
_DOUBLED = 0.98  # correlation of differences; two microphones 1 cm apart stay below 0.9
_HUM_HZ, _HARMONICS, _HUM_DB, _HUM_DBFS = (50.0, 60.0), 8, 10.0, -65.0


def judge_noise(sounds: Sounds, hearing: Hearing) -> Iterator[Row]:
    """Say what can be told of the channels from their noise."""
    yield from _doubled(sounds, hearing)
    yield from _humming(sounds, hearing)


def _doubled(sounds: Sounds, hearing: Hearing) -> Iterator[Row]:
    """Name channels that record the same, noise included."""
    steps = np.diff(sounds.samples.astype(float), axis=0)
    norms = np.linalg.norm(steps, axis=0)
    correlation = steps.T @ steps / np.maximum(np.outer(norms, norms), _tiny(norms))
    for first, second in zip(*np.triu_indices(len(norms), k=1), strict=True):
        r = float(correlation[first, second])
        if abs(r) > _DOUBLED:
            same = "record the same" if r > 0 else "record the same, one of them inverted"
            yield _row(
                f"channels {hearing.channels[first]}, {hearing.channels[second]}",
                State.BAD,
                f"{same} (correlation {r:.3f})",
                "check for one microphone on two inputs, a mono or monitor mix, and audio.channels",
                correlation=r,
            )


def _tiny(norms: FloatArray) -> float:
    return 1e-12 * max(float(norms.max()) ** 2, 1e-30)


def _humming(sounds: Sounds, hearing: Hearing) -> Iterator[Row]:
    quiet = sounds.samples[: sounds.quiet_end].astype(float)
    power = np.abs(np.fft.rfft((quiet - quiet.mean(axis=0)) * np.hanning(len(quiet))[:, None], axis=0)) ** 2
    frequency_hz = np.fft.rfftfreq(len(quiet), 1 / hearing.sample_rate_hz)
    for mains_hz in _HUM_HZ:
        harmonic = np.round(frequency_hz / mains_hz)
        near = (np.abs(frequency_hz - harmonic * mains_hz) < 2.5) & (harmonic >= 1) & (harmonic <= _HARMONICS)
        hum = power[near].sum(axis=0)
        ratio_db = 10 * np.log10(np.maximum(hum, 1e-30) / np.maximum(power[~near].sum(axis=0), 1e-30))
        for column in np.flatnonzero((ratio_db > _HUM_DB) & (hearing.noise_dbfs > _HUM_DBFS)):
            yield _row(
                f"channel {hearing.channels[column]}",
                State.LOOK,
                f"hums at {mains_hz:.0f} Hz ({hearing.noise_dbfs[column]:.0f} dBFS)",
                "check its shield and ground; keep it away from power supplies",
                hum_dbfs=float(hearing.noise_dbfs[column]),
            )


def _row(subject: str, state: State, finding: str, remedy: str, **figures: float) -> Row:
    return Row(Part.SOUND, subject, state, finding, remedy, figures)
