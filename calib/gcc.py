"""TDOAs of sound whose waveform is not known: GCC-PHAT of all pairs at once, with what it needs in a room.

Source: C. Knapp and G. Carter, IEEE TASSP 24 (1976) 320, doi:10.1109/TASSP.1976.1162830. Plain PHAT lets every bin
shout, those without signal too. Here a bin counts only where there is more than noise, weak ones are not raised to full
height, and neighbouring bins are summed: that keeps only lags near zero, and tells how coherent a pair is there.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
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
LAG_SPAN = 4  # summed bins keep lags up to so many times the admissible ones, those to nine tenths
SIGNAL_TO_NOISE = 1.0
WINDOWS_AT_ONCE = 4  # whatever the number of cores, so that the answer is the same
SMOOTHING_SUMS, SMOOTHING_BINS = 15, 31
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
        parts, first = self._levelled(samples)
        pairs = self.pairs(samples.shape[1])
        crosses = _summed_products(parts, pairs)
        powers = np.sum(np.abs(parts) ** 2, axis=0)
        weights = self._coherence(crosses, powers)
        crosses *= weights[:, None]
        lags, heights = self._peaks(self._correlation(crosses, first))
        whole = np.sum(np.sqrt(powers[:, pairs[:, 0]] * powers[:, pairs[:, 1]]) * weights[:, None], axis=2)
        scores = np.clip(heights / np.maximum(whole, 1e-30)[..., None], 0.0, 0.9999)
        return Candidates(lags, scores, self._std(weights, scores[..., 0], first))

    def with_first(self, samples: NDArray[np.float32]) -> tuple[FloatArray, FloatArray]:
        """Return lags (n_lags,) in samples, and every channel's correlation (n_channels, n_lags) with the first."""
        parts, first = self._levelled(samples[None])
        against_first = np.array([[0, column] for column in range(len(samples))], dtype=np.int32)
        correlation = self._correlation(_summed_products(parts, against_first), first)[0]
        middle = correlation.shape[1] // 2
        return (np.arange(correlation.shape[1]) - middle) * self._lag_step, correlation

    def _levelled(self, samples: NDArray[np.float32]) -> tuple[NDArray[np.complex64], int]:
        """Return levelled spectra (n_summed, n, n_channels, n_sums), and the number of the first sum."""
        spectra = rfft(samples, axis=2)
        magnitude = np.sqrt(spectra.real**2 + spectra.imag**2)  # np.abs would take three times as long
        usable = self._usable_bins(magnitude)
        bins = np.flatnonzero(usable)
        begin, end = (int(bins[0]), int(bins[-1])) if len(bins) else (self._n_summed, self._n_summed)
        half = self._n_summed // 2
        first = max(1, -(-begin // self._n_summed))  # sums are around multiples of their length
        last = max(first, min(end, spectra.shape[2] - 1 - half) // self._n_summed)
        chosen = slice(first * self._n_summed - half, last * self._n_summed + half + 1)
        floor = np.maximum(MAGNITUDE_FLOOR * magnitude.max(axis=2, keepdims=True), np.float32(1e-30))
        levelled = spectra[:, :, chosen] * (usable[chosen] / np.maximum(magnitude[:, :, chosen], floor))
        parts = levelled.reshape(*samples.shape[:2], -1, self._n_summed)
        return np.ascontiguousarray(parts.transpose(3, 0, 1, 2)), first

    def _coherence(self, crosses: NDArray[np.complex64], powers: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return how coherent (n, n_sums) the channels are, over all pairs and neighbouring sums, without its bias."""
        common = np.sum(crosses.real**2 + crosses.imag**2, axis=1)
        possible = (np.sum(powers, axis=1) ** 2 - np.sum(powers**2, axis=1)) / 2
        common, possible = (uniform_filter1d(value, SMOOTHING_SUMS, axis=1) for value in (common, possible))
        coherence = common / np.maximum(possible, 1e-30)
        unbiased = (coherence - 1 / self._n_summed) / (1 - 0.999 / self._n_summed)
        return np.asarray(np.clip(unbiased, 0, 0.999), dtype=np.float32)

    def _usable_bins(self, magnitude: NDArray[np.float32]) -> NDArray[np.bool_]:
        whole = np.arange(magnitude.shape[2]) < 2 * CONVERTER_END * magnitude.shape[2]
        if self._noise is None:
            return np.asarray(whole)
        power = np.mean(magnitude**2, axis=0, dtype=float)
        signal = uniform_filter1d((power / self._noise).mean(axis=0), SMOOTHING_BINS) - 1
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
        heights = np.full_like(correlation, -np.inf)
        inner = correlation[..., 1:-1]
        rises = (inner > correlation[..., :-2]) & (inner >= correlation[..., 2:]) & inside[1:-1]
        np.copyto(heights[..., 1:-1], inner, where=rises)
        lags, scores = np.full((2, *correlation.shape[:2], N_CANDIDATES), np.nan)
        for number in range(N_CANDIDATES):
            highest = np.argmax(heights, axis=2)
            found = np.isfinite(np.take_along_axis(heights, highest[..., None], axis=2)[..., 0])
            np.put_along_axis(heights, highest[..., None], -np.inf, axis=2)
            place, value = refine_peaks(correlation, highest, reach=1)
            lags[..., number] = np.where(found, (place - middle) * self._lag_step, np.nan)
            scores[..., number] = np.where(found, value, 0.0)
        low = scores < MIN_SCORE * scores[..., :1]
        return np.where(low, np.nan, lags), np.where(low, 0.0, scores)

    def _std(self, weights: NDArray[np.float32], scores: FloatArray, first: int) -> FloatArray:
        """Return the standard deviation (n, n_pairs) of the lags in samples, from how coherent pairs are as a whole."""
        angular = 2 * np.pi * self._n_summed * (first + np.arange(weights.shape[1])) / self._n_samples
        information = 2 * self._n_summed * (weights @ angular**2)[:, None] * scores**2 / (1 - scores**2)
        return np.asarray(1 / np.sqrt(np.maximum(information, 1e-30)))


def candidates_of(correlator: PairCorrelator, samples: NDArray[np.float32]) -> Candidates:
    """Find the candidates of windows (n, n_channels, n_samples), shared out among the processor's cores."""
    shares = [samples[begin : begin + WINDOWS_AT_ONCE] for begin in range(0, len(samples), WINDOWS_AT_ONCE)]
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # numpy and the FFT let other threads run meanwhile
        parts = list(pool.map(correlator.candidates, shares))
    return Candidates(*(np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(Candidates)))


def _summed_products(parts: NDArray[np.complex64], pairs: NDArray[np.int32]) -> NDArray[np.complex64]:
    """Sum X_j conj(X_i) over the first axis of (n_summed, n, n_channels, n_sums), to (n, n_pairs, n_sums)."""
    _, n, _, n_sums = parts.shape
    total = np.zeros((n, len(pairs), n_sums), dtype=np.complex64)
    groups = [(int(first), np.flatnonzero(pairs[:, 0] == first)) for first in np.unique(pairs[:, 0])]
    for part in parts:
        for first, group in groups:  # of combinations: consecutive pairs, and consecutive channels
            seconds = slice(int(pairs[group[0], 1]), int(pairs[group[-1], 1]) + 1)
            total[:, group[0] : group[-1] + 1] += part[:, seconds] * np.conj(part[:, first : first + 1])
    return total
