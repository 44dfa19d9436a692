"""TDOAs of sound whose waveform is not known: GCC-PHAT of all pairs at once, with what it needs in a room.

Source: C. Knapp and G. Carter, IEEE TASSP 24 (1976) 320, doi:10.1109/TASSP.1976.1162830. Plain PHAT lets every bin
shout, those without signal too. Here a bin counts only where there is more than noise, weak ones are not raised to full
height, and neighbouring bins are summed: that keeps only lags near zero, and tells how coherent a pair is there.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.ndimage import uniform_filter1d

from calib.matched import CONVERTER_END
from calib.peaks import refine_peaks
from calib.tdoa import MAGNITUDE_FLOOR

FloatArray = NDArray[np.float64]

N_CANDIDATES = 4
OVERSAMPLING = 2  # between these the interpolation goes on
LAG_SPAN = 8  # summed bins keep lags up to so many times the admissible ones, those nearly whole
SIGNAL_TO_NOISE = 1.0
SMOOTHING_SUMS = 15
MIN_SCORE = 0.2  # of the best candidate of the pair


@dataclass(frozen=True)
class Candidates:
    """Peaks of the correlation of every pair, the highest first.

    Parameters
    ----------
    lags : (n, n_pairs, N_CANDIDATES) array
        In samples, arrival at j minus arrival at i; NaN where there is no such peak.
    scores : array, same shape
        Height of the peak; 1 is a lone sound without noise.
    std : (n, n_pairs) array
        Standard deviation of a lag in samples by the coherence of the pair.
    """

    lags: FloatArray
    scores: FloatArray
    std: FloatArray


class PairCorrelator:
    """Correlates all pairs of channels of windows.

    Parameters
    ----------
    n_samples : int
        Length of a window.
    noise_power : (n_channels, n_samples // 2 + 1) array or None
        Mean square of a window's spectrum where there is only noise; None: every bin counts.
    max_lag_samples : float
    """

    def __init__(self, n_samples: int, noise_power: FloatArray | None, max_lag_samples: float) -> None:
        self._n_samples, self._noise = n_samples, noise_power
        self._reach = int(np.ceil(max_lag_samples))
        self._n_summed = max(1, n_samples // (LAG_SPAN * 2 * self._reach)) // 2 * 2 + 1  # odd: sums have a middle bin
        self._n_lags = next_fast_len(OVERSAMPLING * n_samples // self._n_summed + 2, real=True) // 2 * 2
        self._lag_step = n_samples / self._n_summed / self._n_lags

    def pairs(self, n_channels: int) -> NDArray[np.int32]:
        """Return the pairs (n_pairs, 2) of columns."""
        return np.array(list(combinations(range(n_channels), 2)), dtype=np.int32)

    def candidates(self, samples: NDArray[np.float32]) -> Candidates:
        """Find the peaks of all pairs in windows (n, n_channels, n_samples)."""
        crosses, first = self._summed_crosses(samples)
        pairs = self.pairs(samples.shape[1])
        of_pairs = crosses[:, :, pairs[:, 1], pairs[:, 0]].transpose(0, 2, 1)
        powers = np.real(np.diagonal(crosses, axis1=2, axis2=3)).transpose(0, 2, 1)
        coherence = np.abs(of_pairs) ** 2 / np.maximum(powers[:, pairs[:, 0]] * powers[:, pairs[:, 1]], 1e-30)
        coherence = np.clip((coherence - 1 / self._n_summed) / max(1 - 1 / self._n_summed, 1e-9), 0.0, 0.999)
        coherence = uniform_filter1d(coherence, SMOOTHING_SUMS, axis=2)
        lags, heights = self._peaks(self._correlation(of_pairs * coherence, first))
        whole = np.sum(np.sqrt(powers[:, pairs[:, 0]] * powers[:, pairs[:, 1]]) * coherence, axis=2)
        scores = np.clip(heights / np.maximum(whole, 1e-30)[..., None], 0.0, 0.9999)
        return Candidates(lags, scores, self._std(coherence, scores[..., 0], first))

    def with_first(self, samples: NDArray[np.float32]) -> tuple[FloatArray, FloatArray]:
        """Return lags (n_lags,) in samples, and every channel's correlation (n_channels, n_lags) with the first."""
        crosses, first = self._summed_crosses(samples[None])
        correlation = self._correlation(crosses[:, :, :, 0].transpose(0, 2, 1), first)[0]
        middle = correlation.shape[1] // 2
        return (np.arange(correlation.shape[1]) - middle) * self._lag_step, correlation

    def _summed_crosses(self, samples: NDArray[np.float32]) -> tuple[NDArray[np.complex64], int]:
        """Return cross-spectra (n, n_sums, n_channels, n_channels) of neighbouring bins, and the first's number."""
        spectra = rfft(samples, axis=2)
        power = np.abs(spectra) ** 2
        usable = self._usable_bins(power)
        bins = np.flatnonzero(usable)
        begin, end = (int(bins[0]), int(bins[-1])) if len(bins) else (self._n_summed, self._n_summed)
        half = self._n_summed // 2
        first = max(1, -(-begin // self._n_summed))  # sums are around multiples of their length
        last = max(first, min(end, spectra.shape[2] - 1 - half) // self._n_summed)
        chosen = slice(first * self._n_summed - half, last * self._n_summed + half + 1)
        floor = MAGNITUDE_FLOOR * np.sqrt(power.max(axis=2, keepdims=True))
        levelled = spectra[:, :, chosen] / np.maximum(np.sqrt(power[:, :, chosen]), np.maximum(floor, 1e-30))
        levelled *= usable[chosen]
        blocks = levelled.reshape(*samples.shape[:2], -1, self._n_summed).transpose(0, 2, 1, 3)
        return blocks @ np.conj(blocks).transpose(0, 1, 3, 2), first

    def _usable_bins(self, power: NDArray[np.float32]) -> NDArray[np.bool_]:
        whole = np.arange(power.shape[2]) < 2 * CONVERTER_END * power.shape[2]
        if self._noise is None:
            return np.asarray(whole)
        signal = uniform_filter1d(power.mean(axis=0, dtype=float) / self._noise, 31, axis=1).max(axis=0) - 1
        return np.asarray(whole & (signal > SIGNAL_TO_NOISE))

    def _correlation(self, crosses: NDArray[np.complex64], first: int) -> FloatArray:
        """Return correlations (n, n_pairs, n_lags) at lags around zero, `lag_step` samples apart."""
        spectrum = np.zeros((*crosses.shape[:2], self._n_lags // 2 + 1), dtype=np.complex64)
        spectrum[:, :, first : first + crosses.shape[2]] = crosses
        correlation = irfft(spectrum, self._n_lags, axis=2) * (self._n_lags / 2)
        edge = min(int(self._reach / self._lag_step) + 64, self._n_lags // 2 - 1)
        return np.concatenate([correlation[..., -edge:], correlation[..., : edge + 1]], axis=2)

    def _peaks(self, correlation: FloatArray) -> tuple[FloatArray, FloatArray]:
        middle = correlation.shape[2] // 2
        inside = np.abs(np.arange(correlation.shape[2]) - middle) <= self._reach / self._lag_step
        rises = (correlation > np.roll(correlation, 1, 2)) & (correlation >= np.roll(correlation, -1, 2)) & inside
        heights = np.where(rises, correlation, -np.inf)
        highest = np.argpartition(heights, -N_CANDIDATES, axis=2)[..., -N_CANDIDATES:]
        order = np.argsort(-np.take_along_axis(heights, highest, axis=2), axis=2)
        highest = np.take_along_axis(highest, order, axis=2)
        places, values = zip(*(refine_peaks(correlation, highest[..., k]) for k in range(N_CANDIDATES)), strict=True)
        lags, scores = np.stack(places, axis=2), np.stack(values, axis=2)
        found = np.isfinite(np.take_along_axis(heights, highest, axis=2)) & (scores > MIN_SCORE * scores[..., :1])
        return np.where(found, (lags - middle) * self._lag_step, np.nan), np.where(found, scores, 0.0)

    def _std(self, weights: FloatArray, scores: FloatArray, first: int) -> FloatArray:
        """Return the standard deviation (n, n_pairs) of the lags in samples, from how coherent pairs are as a whole."""
        angular = 2 * np.pi * self._n_summed * (first + np.arange(weights.shape[2])) / self._n_samples
        information = 2 * self._n_summed * np.sum(angular**2 * weights, axis=2) * scores**2 / (1 - scores**2)
        return np.asarray(1 / np.sqrt(np.maximum(information, 1e-30)))
