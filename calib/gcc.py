"""TDOAs of sound whose waveform is not known: GCC-PHAT of all pairs at once, with what it needs in a room.

Source: C. Knapp and G. Carter, IEEE TASSP 24 (1976) 320, doi:10.1109/TASSP.1976.1162830. Plain PHAT lets every bin
shout, those without signal too. Here a bin counts only where there is more than noise, weak ones are not raised to full
height, and neighbouring bins are summed: that keeps only lags near zero, and tells how coherent a pair is there.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.ndimage import uniform_filter1d

from calib.matched import CONVERTER_END
from calib.peaks import REACH, refine_peaks

FloatArray = NDArray[np.float64]

N_CANDIDATES = 4
MAGNITUDE_FLOOR = 0.05  # of the strongest bin
LAG_SPAN = 2  # summed bins keep lags up to so many times the admissible ones, those to nine tenths
SIGNAL_TO_NOISE = 1.0
SMOOTHING_SUMS, SMOOTHING_BINS = 15, 31
MIN_SCORE = 0.2  # of the best candidate of the pair
LEAST_POWER = 1e-30  # keeps divisions finite


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

    def some(self, rows: slice | NDArray[np.bool_]) -> Candidates:
        """Return those of some windows."""
        return Candidates(*(getattr(self, one.name)[rows] for one in fields(self)))


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
        self._n_samples = n_samples
        self._per_noise = None if noise_power is None else (1 / (noise_power * len(noise_power))).astype(np.float32)
        self._reach = int(np.ceil(max_lag_samples))
        self._n_summed = max(1, n_samples // (LAG_SPAN * 2 * self._reach)) // 2 * 2 + 1  # odd: sums have a middle bin
        self._n_lags = next_fast_len(n_samples // self._n_summed + 2, real=True)
        self._lag_step = n_samples / self._n_summed / self._n_lags

    def pairs(self, n_channels: int) -> NDArray[np.int32]:
        """Return the pairs (n_pairs, 2) of columns."""
        return np.array(list(combinations(range(n_channels), 2)), dtype=np.int32)

    def candidates(self, samples: NDArray[np.float32]) -> Candidates:
        """Find the peaks of all pairs in windows (n, n_channels, n_samples)."""
        products, first = self._summed_products(samples)
        powers = np.ascontiguousarray(np.diagonal(products, axis1=2, axis2=3).real)
        weights = self._coherence(products, powers)
        first_of, second_of = self.pairs(samples.shape[1]).T
        crosses = products[:, :, second_of, first_of] * weights[..., None]  # peaks lie where the second is later
        lags, heights = self._peaks(self._correlation(crosses, first))
        whole = np.einsum("nsp,ns->np", np.sqrt(powers[:, :, first_of] * powers[:, :, second_of]), weights)
        scores = np.clip(heights / np.maximum(whole, LEAST_POWER)[..., None], 0.0, 0.9999)
        return Candidates(lags, scores, self._std(weights, scores[..., 0], first))

    def with_first(self, samples: NDArray[np.float32]) -> tuple[FloatArray, FloatArray]:
        """Return lags (n_lags,) in samples, and every channel's correlation (n_channels, n_lags) with the first."""
        products, first = self._summed_products(samples[None])
        correlation = self._correlation(products[..., 0], first)[0]
        middle = correlation.shape[1] // 2
        return (np.arange(correlation.shape[1]) - middle) * self._lag_step, correlation

    def _summed_products(self, samples: NDArray[np.float32]) -> tuple[NDArray[np.complex64], int]:
        """Return levelled X_j conj(X_i), summed (n, n_sums, n_channels, n_channels), and the number of the first sum.

        The bins of a sum are a matrix (n_channels, n_summed), and its product with itself holds all pairs.
        """
        levelled, first = self._levelled(samples)
        bins = np.ascontiguousarray(levelled.reshape(*samples.shape[:2], -1, self._n_summed).transpose(0, 2, 1, 3))
        return bins @ np.conj(bins.transpose(0, 1, 3, 2)), first

    def _levelled(self, samples: NDArray[np.float32]) -> tuple[NDArray[np.complex64], int]:
        """Return levelled spectra (n, n_channels, n_sums * n_summed), and the number of the first sum."""
        spectra = rfft(samples, axis=2)
        magnitude = np.abs(spectra)
        usable = self._usable_bins(magnitude)
        bins = np.flatnonzero(usable.any(axis=0))
        begin, end = (int(bins[0]), int(bins[-1])) if len(bins) else (self._n_summed, self._n_summed)
        half = self._n_summed // 2
        first = max(1, -(-begin // self._n_summed))  # sums are around multiples of their length
        last = max(first, min(end, spectra.shape[2] - 1 - half) // self._n_summed)
        chosen = slice(first * self._n_summed - half, last * self._n_summed + half + 1)
        floor = np.maximum(MAGNITUDE_FLOOR * magnitude.max(axis=2, keepdims=True), np.float32(LEAST_POWER))
        gain = usable[:, None, chosen] / np.maximum(magnitude[:, :, chosen], floor)
        return spectra[:, :, chosen] * gain, first

    def _coherence(self, products: NDArray[np.complex64], powers: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return how coherent (n, n_sums) the channels are, over all pairs and neighbouring sums, without its bias."""
        magnitude = np.abs(products)
        own = np.einsum("nsc,nsc->ns", powers, powers)
        common = np.einsum("nsij,nsij->ns", magnitude, magnitude) - own
        possible = np.sum(powers, axis=2) ** 2 - own
        common, possible = (uniform_filter1d(value, SMOOTHING_SUMS, axis=1) for value in (common, possible))
        coherence = common / np.maximum(possible, LEAST_POWER)
        unbiased = (coherence - 1 / self._n_summed) / (1 - 0.999 / self._n_summed)
        return np.asarray(np.clip(unbiased, 0, 0.999), dtype=np.float32)

    def _usable_bins(self, magnitude: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Tell which bins (n, n_bins) of each window hold more signal than noise."""
        n, _, n_bins = magnitude.shape
        whole = np.arange(n_bins) < 2 * CONVERTER_END * n_bins
        if self._per_noise is None:
            return np.broadcast_to(whole, (n, n_bins))
        power = np.einsum("ncb,ncb,cb->nb", magnitude, magnitude, self._per_noise)
        return np.asarray(whole & (uniform_filter1d(power, SMOOTHING_BINS, axis=1) > 1 + SIGNAL_TO_NOISE))

    def _correlation(self, crosses: NDArray[np.complex64], first: int) -> NDArray[np.float32]:
        """Return correlations (n, n_pairs, n_lags) at lags around zero, `lag_step` samples apart."""
        n, n_sums, n_pairs = crosses.shape
        spectrum = np.zeros((n, n_pairs, self._n_lags // 2 + 1), dtype=np.complex64)
        spectrum[:, :, first : first + n_sums] = crosses.transpose(0, 2, 1)
        correlation = irfft(spectrum, self._n_lags, axis=2, norm="forward") / 2
        edge = min(int(self._reach / self._lag_step) + REACH, self._n_lags // 2 - 1)
        return np.concatenate([correlation[..., -edge:], correlation[..., : edge + 1]], axis=2)

    def _peaks(self, correlation: NDArray[np.float32]) -> tuple[FloatArray, FloatArray]:
        """Return lags in samples and heights (n, n_pairs, N_CANDIDATES) of the highest peaks."""
        middle = correlation.shape[2] // 2
        reach = int(self._reach / self._lag_step)
        near = correlation[..., middle - reach - 1 : middle + reach + 2]
        places, found = _highest_peaks(near.reshape(-1, near.shape[2]))
        places = places.reshape(*correlation.shape[:2], N_CANDIDATES) + middle - reach
        found = found.reshape(places.shape)
        place, value = refine_peaks(correlation[:, :, None], places, reach=1)
        scores = np.where(found, value, 0.0)
        found &= scores >= MIN_SCORE * scores[..., :1]
        return np.where(found, (place - middle) * self._lag_step, np.nan), np.where(found, scores, 0.0)

    def _std(self, weights: NDArray[np.float32], scores: FloatArray, first: int) -> FloatArray:
        """Return the standard deviation (n, n_pairs) of the lags in samples, from how coherent pairs are as a whole."""
        angular = 2 * np.pi * self._n_summed * (first + np.arange(weights.shape[1])) / self._n_samples
        information = 2 * self._n_summed * (weights @ angular**2)[:, None] * scores**2 / (1 - scores**2)
        return np.asarray(1 / np.sqrt(np.maximum(information, 1e-30)))


def joined(parts: list[Candidates]) -> Candidates:
    """Put the candidates of some windows after those of others."""
    return Candidates(*(np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(Candidates)))


def _highest_peaks(rows: NDArray[np.float32]) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return the places (n, N_CANDIDATES) of the highest peaks of rows (n, n_lags + 2), less one, and if there are."""
    inner = rows[:, 1:-1]
    heights = np.where((inner > rows[:, :-2]) & (inner >= rows[:, 2:]), inner, -np.inf)
    every = np.arange(len(rows))
    places, found = np.zeros((len(rows), N_CANDIDATES), dtype=np.intp), np.zeros((len(rows), N_CANDIDATES), dtype=bool)
    for number in range(N_CANDIDATES):
        highest = places[:, number] = np.argmax(heights, axis=1)
        found[:, number] = np.isfinite(heights[every, highest])
        heights[every, highest] = -np.inf
    return places, found
