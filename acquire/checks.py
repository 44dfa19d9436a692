"""The check of an emission: was it heard, on which channels, when, and undistorted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import fft, ifft, next_fast_len

from rigs.description import Capture
from rigs.waveform import Waveform

FloatArray = NDArray[np.float64]

_HEARD_RATIO = 10.0  # matched filter's peak over its lower quartile; noise alone stays under 6
_STRONG = 0.5  # the onset is the first moment this strong: an echo may be stronger than the direct sound, not twice
_STRONG_TONE = 0.15  # the echoes of a tone add up
_TONE_TEMPLATE_S = 0.01  # a whole tone's correlation rises too slowly to have an onset
_SILENCE = 1e-10


@dataclass(frozen=True)
class EmissionCheck:
    """What the channels heard of one emission.

    Parameters
    ----------
    level_dbfs : (n_channels,) array
        RMS while the emission should sound, in dB of full scale.
    onset_s : (n_channels,) array
        When it was heard, relative to when it was expected; NaN where it was not heard.
    clipped : (n_channels,) array of bool
    onset_tolerance_s : float
        How far the onset may be off.
    """

    level_dbfs: FloatArray
    onset_s: FloatArray
    clipped: NDArray[np.bool_]
    onset_tolerance_s: float

    def silent(self) -> NDArray[np.bool_]:
        """Return which channels (n_channels,) did not hear it."""
        return np.isnan(self.onset_s)

    def late_s(self) -> float:
        """Return how much later than expected the channels heard it, their median; NaN where none did."""
        return float("nan") if self.silent().all() else float(np.nanmedian(self.onset_s))

    def problem(self) -> str | None:
        """Say what is wrong with the emission as a whole; None when most channels heard it where expected."""
        if 2 * np.count_nonzero(self.silent()) >= len(self.onset_s):
            return "not heard"
        late_s = self.late_s()
        if abs(late_s) > self.onset_tolerance_s:
            return f"heard {abs(late_s) * 1e3:.0f} ms too {'late' if late_s > 0 else 'early'}"
        return None

    def channel_faults(self) -> frozenset[tuple[int, str]]:
        """Return (column, "silent" or "clipped") of each channel at fault."""
        silent = {(int(column), "silent") for column in np.flatnonzero(self.silent())}
        clipped = {(int(column), "clipped") for column in np.flatnonzero(self.clipped)}
        return frozenset(silent | clipped)


def find_onset(samples: NDArray[np.float32], waveform: Waveform, sample_rate_hz: float) -> float | None:
    """Return the row of samples (n_samples, n_channels) where most channels first hear an emission, wherever it is.

    None where they do not, or not all of it.
    """
    onset_samples = _onsets(samples, 0, waveform, sample_rate_hz)
    if 2 * np.count_nonzero(np.isnan(onset_samples)) >= len(onset_samples):
        return None
    return float(np.nanmedian(onset_samples))


def check_emission(
    samples: NDArray[np.float32], expected_sample: int, waveform: Waveform, limits: Capture, sample_rate_hz: float
) -> EmissionCheck:
    """Check one emission on all channels.

    Parameters
    ----------
    samples : (n_samples, n_channels) array
        The recording around the emission and the silence before it, in whose first half the last one may still ring.
    expected_sample : int
        Row of `samples` where the emission should begin.
    waveform : Waveform
    limits : Capture
        What makes an emission good: `min_level_dbfs`, `clip_level`, `onset_tolerance_s`.
    sample_rate_hz : float
    """
    duration_samples = round(waveform.duration_s * sample_rate_hz)
    tolerance_samples = round(limits.onset_tolerance_s * sample_rate_hz)
    begin, end = max(expected_sample, 0), max(expected_sample + duration_samples, 0)
    around = samples[max(begin - tolerance_samples, 0) : end + tolerance_samples]
    level_dbfs = _rms_dbfs(samples[begin:end])
    onset_samples = _onsets(samples, begin // 2, waveform, sample_rate_hz)
    heard = np.isfinite(onset_samples) & (level_dbfs >= limits.min_level_dbfs)
    return EmissionCheck(
        level_dbfs,
        np.where(heard, (onset_samples - expected_sample) / sample_rate_hz, np.nan),
        np.any(np.abs(around) >= limits.clip_level, axis=0),
        limits.onset_tolerance_s,
    )


def _rms_dbfs(samples: NDArray[np.float32]) -> FloatArray:
    power = np.sum(samples.astype(float) ** 2, axis=0) / max(len(samples), 1)
    return np.asarray(10 * np.log10(np.maximum(power, _SILENCE**2)))


def _onsets(samples: NDArray[np.float32], begin: int, waveform: Waveform, sample_rate_hz: float) -> FloatArray:
    """Return the row (n_channels,) from `begin` on where each channel first hears the wave, NaN where it does not."""
    envelope = _matched_filter(samples, waveform, sample_rate_hz)
    if len(envelope) <= begin:
        return np.full(samples.shape[1], np.nan)
    peak, floor = envelope[begin:].max(axis=0), np.quantile(envelope, 0.25, axis=0)
    least = _HEARD_RATIO * np.maximum(floor, _SILENCE)
    strong = (_STRONG_TONE if waveform.kind == "tone" else _STRONG) * peak
    first_strong = begin + np.argmax(envelope[begin:] >= np.maximum(strong, least), axis=0)
    return np.where(peak > least, first_strong, np.nan)


def _matched_filter(samples: NDArray[np.float32], waveform: Waveform, sample_rate_hz: float) -> FloatArray:
    """Return the envelope (n_lags, n_channels) of the correlation with the wave, at lags that hold all of it."""
    template = waveform.sampled(sample_rate_hz)
    n_lags = max(len(samples) - len(template) + 1, 0)
    if waveform.kind == "tone":
        template = template[: round(_TONE_TEMPLATE_S * sample_rate_hz)]
    n_fft = next_fast_len(len(samples) + len(template))
    sound, wave = (fft(np.asarray(part, dtype=np.float32), n_fft) for part in (samples.T, template))
    sound *= np.conj(wave)  # in single precision: half the time and memory, and plenty for a check
    sound[:, n_fft // 2 :] = 0.0  # positive frequencies only: the magnitude is the envelope
    return np.asarray(2 * np.abs(ifft(sound, overwrite_x=True)[:, :n_lags]).T)
