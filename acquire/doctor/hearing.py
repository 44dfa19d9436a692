"""The hearing: how loud each channel hears each buzzer, over which noise, and when."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquire.checks import EmissionCheck, check_emission, find_onset
from acquire.doctor.listening import AFTER_S, Sounds
from rigs.description import RigDescription

FloatArray = NDArray[np.float64]
_BEFORE_S, _EARLY_S = 0.1, 0.05
_SILENCE = 1e-15  # of power
SILENCE_DBFS = -149.0  # digital silence is below
_LOWEST_HZ = 100.0


@dataclass(frozen=True)
class Hearing:
    """What each channel hears of each buzzer; the tables are (n_channels, n_buzzers), NaN where nothing is heard.

    Parameters
    ----------
    channels, buzzers : tuple of int
        The numbers of the device's inputs, and of the trigger board's buzzers.
    level_dbfs : array
        RMS while it sounds, in dB of full scale; where nothing is heard too.
    snr_db : array
        Power in the signal's band over that of the quiet.
    onset_s : array
        When it is first heard, after the board says that it began.
    clipped : array of bool
    noise_dbfs : (n_channels,) array
        RMS of the quiet.
    sample_rate_hz : float
    """

    channels: tuple[int, ...]
    buzzers: tuple[int, ...]
    level_dbfs: FloatArray
    snr_db: FloatArray
    onset_s: FloatArray
    clipped: NDArray[np.bool_]
    noise_dbfs: FloatArray
    sample_rate_hz: float

    def heard(self) -> NDArray[np.bool_]:
        """Return which channel heard which buzzer."""
        return np.isfinite(self.onset_s)


def measure(sounds: Sounds, description: RigDescription) -> Hearing:
    """Measure what was heard of each buzzer, wherever the latency of the audio path has put it."""
    latency_s = _latency_s(sounds, description)
    checks = [_check(sounds, start, latency_s, description) for start in sounds.starts]
    channels, rate_hz = description.audio.microphone_channels(), description.audio.sample_rate_hz
    quiet = sounds.samples[: sounds.quiet_end]
    table = np.empty((len(channels), 0))
    onsets_s = np.column_stack([table, *(check.onset_s + latency_s for check in checks)])
    snrs = [_snr_db(sounds, start + latency_s * rate_hz, description) for start in sounds.starts]
    return Hearing(
        channels,
        tuple(buzzer.id for buzzer in description.board.buzzers)[: len(checks)],
        np.column_stack([table, *(check.level_dbfs for check in checks)]),
        np.where(np.isfinite(onsets_s), np.column_stack([table, *snrs]), np.nan),
        onsets_s,
        np.column_stack([table, *(check.clipped for check in checks)]).astype(bool),
        10 * np.log10(np.maximum(np.mean(quiet.astype(float) ** 2, axis=0), _SILENCE)),
        rate_hz,
    )


def _latency_s(sounds: Sounds, description: RigDescription) -> float:
    """Return how much later than the clocks say emissions are heard (their median), 0 where none is."""
    rate_hz, waveform = description.audio.sample_rate_hz, description.signal.waveform()
    found_s = []
    for start in sounds.starts:
        first, end = (max(round(start + at_s * rate_hz), 0) for at_s in (-_EARLY_S, waveform.duration_s + AFTER_S))
        onset = find_onset(sounds.samples[first:end], waveform, rate_hz)
        found_s += [] if onset is None else [(first + onset - start) / rate_hz]
    return float(np.median(found_s)) if found_s else 0.0


def _check(sounds: Sounds, start: float, latency_s: float, description: RigDescription) -> EmissionCheck:
    rate_hz, waveform = description.audio.sample_rate_hz, description.signal.waveform()
    expected = round(start + latency_s * rate_hz)
    first = max(expected - round(_BEFORE_S * rate_hz), 0)
    end = expected + round((waveform.duration_s + AFTER_S - _BEFORE_S - latency_s) * rate_hz)
    return check_emission(sounds.samples[first:end], expected - first, waveform, description.capture, rate_hz)


def _snr_db(sounds: Sounds, start: float, description: RigDescription) -> FloatArray:
    """Return the signal-to-noise ratio (n_channels,) in the signal's band; both over as many samples."""
    rate_hz, waveform = description.audio.sample_rate_hz, description.signal.waveform()
    n_samples, first = round(waveform.duration_s * rate_hz), max(round(start), 0)
    sound = _band_power(sounds.samples[first : first + n_samples], waveform.band_hz(), rate_hz)
    pieces = [sounds.samples[k : k + n_samples] for k in range(0, sounds.quiet_end - n_samples + 1, n_samples)]
    noise = np.mean([_band_power(piece, waveform.band_hz(), rate_hz) for piece in pieces], axis=0)
    return np.asarray(10 * np.log10(np.maximum(sound - noise, _SILENCE) / np.maximum(noise, _SILENCE)))


def _band_power(samples: NDArray[np.float32], band_hz: tuple[float, float], rate_hz: float) -> FloatArray:
    frequency_hz = np.fft.rfftfreq(len(samples), 1 / rate_hz)
    within = (frequency_hz >= max(band_hz[0], _LOWEST_HZ)) & (frequency_hz <= band_hz[1])
    window = np.hanning(len(samples))[:, None]  # hum must not leak into the band
    return np.asarray(np.sum(np.abs(np.fft.rfft(samples * window, axis=0)[within]) ** 2, axis=0) / len(samples) ** 2)
