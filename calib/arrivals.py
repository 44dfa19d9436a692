"""Where in the sound each emission arrives: a compressed pulse per channel, and its first strong peak.

The emitted waveform is known, so each channel is divided by it (with a floor): 100 ms of sweep become a pulse of a few
tenths of a millisecond per path. The direct path is the first strong one; a gate around it keeps the room out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.signal import hilbert

from calib.tdoa import Whitening
from rigs.waveform import Waveform

FloatArray = NDArray[np.float64]

SPECTRUM_FLOOR = 0.02  # of the template's strongest bin
FIRST_PEAK_SHARE = 0.5  # a path this strong, of the strongest, may be the direct one
MIN_PEAK_RATIO = 6.0  # of the peak over the pulse's root mean square elsewhere: chance gives about 4.5
GATE_BEFORE_S = 0.5e-3
GATE_AFTER_S = 1.0e-3
GATE_TAPER_S = 0.25e-3


@dataclass(frozen=True)
class Arrivals:
    """The direct paths of one emission.

    Parameters
    ----------
    peak_samples : (n_channels,) array
        Where each pulse peaks, in samples of the window; NaN where nothing was heard.
    peak_ratio : (n_channels,) array
        Peak over the root mean square of the rest.
    gated : (n_channels, n_samples) array
        The pulses, silent but for the gate around each peak, on one common time axis.
    """

    peak_samples: FloatArray
    peak_ratio: FloatArray
    gated: FloatArray

    def cut_out(self) -> FloatArray:
        """Return the shortest stretch (n_channels, n) that holds all gates: less to transform, same time axis."""
        loud = np.flatnonzero(self.gated.any(axis=0))
        return self.gated[:, loud[0] : loud[-1] + 1]


class PulseCompressor:
    """Turns an emission window into pulses (made once per waveform and window length)."""

    def __init__(self, waveform: Waveform, sample_rate_hz: float, n_samples: int, max_tdoa_s: float) -> None:
        self.sample_rate_hz = sample_rate_hz
        self.n_samples = n_samples
        self.max_tdoa_samples = max_tdoa_s * sample_rate_hz
        self.whitening = Whitening(_usable_band_hz(waveform), sample_rate_hz)
        template = waveform.sampled(sample_rate_hz)
        self._n_template = len(template)
        self._n_fft = next_fast_len(n_samples + len(template), real=True)
        spectrum = rfft(template, n=self._n_fft)
        power = np.abs(spectrum) ** 2
        frequencies_hz = np.asarray(np.fft.rfftfreq(self._n_fft, 1 / sample_rate_hz), dtype=float)
        in_band = _soft_band(frequencies_hz, self.whitening.band_hz)
        self._inverse = in_band * np.conj(spectrum) / (power + SPECTRUM_FLOOR * power.max())

    def arrivals(self, window: NDArray[np.float32]) -> Arrivals:
        """Find the direct paths in a window (n_samples, n_channels)."""
        pulses = irfft(rfft(window.T.astype(float), n=self._n_fft, axis=1) * self._inverse, n=self._n_fft, axis=1)
        pulses = pulses[:, : self.n_samples]
        envelopes = np.abs(hilbert(pulses, axis=1))
        peaks, ratios = self._first_strong_peaks(envelopes)
        before, after = GATE_BEFORE_S * self.sample_rate_hz, GATE_AFTER_S * self.sample_rate_hz
        whole = (peaks >= before) & (peaks <= self.n_samples - self._n_template - after)
        heard = (ratios > MIN_PEAK_RATIO) & whole  # an emission that the window cuts off may have begun earlier
        gated = np.where(heard[:, None], pulses * self._gates(peaks), 0.0)
        return Arrivals(np.where(heard, peaks, np.nan), ratios, gated)

    def _first_strong_peaks(self, envelopes: FloatArray) -> tuple[FloatArray, FloatArray]:
        strongest = np.argmax(envelopes, axis=1)
        heights = np.take_along_axis(envelopes, strongest[:, None], axis=1)
        earliest = strongest - round(self.max_tdoa_samples)
        samples = np.arange(envelopes.shape[1])
        candidate = (envelopes > FIRST_PEAK_SHARE * heights) & (samples >= earliest[:, None])
        rises = candidate & (envelopes >= np.roll(envelopes, 1, axis=1)) & (envelopes > np.roll(envelopes, -1, axis=1))
        peaks = np.argmax(rises, axis=1)
        noise = np.sqrt(np.mean(envelopes**2, axis=1))
        ratios = np.take_along_axis(envelopes, peaks[:, None], axis=1)[:, 0] / np.maximum(noise, np.finfo(float).tiny)
        return peaks.astype(float), ratios

    def _gates(self, peaks: FloatArray) -> FloatArray:
        """Windows (n_channels, n_samples), flat around each peak with raised-cosine ends."""
        time_s = (np.arange(self.n_samples) - peaks[:, None]) / self.sample_rate_hz
        rise = np.clip((time_s + GATE_BEFORE_S) / GATE_TAPER_S, 0.0, 1.0)
        fall = np.clip((GATE_AFTER_S - time_s) / GATE_TAPER_S, 0.0, 1.0)
        return np.asarray(np.sin(np.pi / 2 * rise) ** 2 * np.sin(np.pi / 2 * fall) ** 2)


def _usable_band_hz(waveform: Waveform) -> tuple[float, float]:
    low_hz, high_hz = waveform.band_hz()
    if waveform.kind == "mls":  # a piezo is deaf at the bottom, and chips carry little near their rate
        return 0.06 * high_hz, 0.9 * high_hz
    if waveform.kind == "tone":
        return 0.8 * low_hz, 1.2 * high_hz
    return low_hz, high_hz


def _soft_band(frequencies_hz: FloatArray, band_hz: tuple[float, float]) -> FloatArray:
    """Weights that rise and fall over a tenth of the band, so that the pulse does not ring."""
    edge_hz = 0.1 * (band_hz[1] - band_hz[0])
    rise = np.clip((frequencies_hz - band_hz[0] + edge_hz / 2) / edge_hz, 0.0, 1.0)
    fall = np.clip((band_hz[1] + edge_hz / 2 - frequencies_hz) / edge_hz, 0.0, 1.0)
    return np.asarray(np.sin(np.pi / 2 * rise) ** 2 * np.sin(np.pi / 2 * fall) ** 2)
