"""TDOAs of one emission by GCC-PHAT with sub-sample peaks.

Source: C. Knapp and G. Carter, IEEE TASSP 24 (1976) 320, doi:10.1109/TASSP.1976.1162830, with what PHAT needs to be
sound: a band mask (bins without signal say nothing) and a floor under the magnitude (weak bins must not shout).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

FloatArray = NDArray[np.float64]

UPSAMPLING = 16  # a parabola through samples of the correlation itself would be biased
MAGNITUDE_FLOOR = 0.05  # of the strongest bin


@dataclass(frozen=True)
class Whitening:
    """Which bins count, and how far each is levelled.

    Parameters
    ----------
    band_hz : (float, float)
        Bins outside are left out.
    sample_rate_hz : float
    floor : float
        Bins weaker than this share of the strongest are not raised to full weight.
    """

    band_hz: tuple[float, float]
    sample_rate_hz: float
    floor: float = MAGNITUDE_FLOOR


def gcc_phat(
    segments: FloatArray, pairs: NDArray[np.int32], whitening: Whitening, max_lag_samples: float
) -> FloatArray:
    """Find the lag of each pair of segments.

    Parameters
    ----------
    segments : (n_channels, n_samples) array
        The same stretch of time of each channel.
    pairs : (n_pairs, 2) integer array
        Rows (i, j).
    whitening : Whitening
    max_lag_samples : float
        Lags beyond are not looked at.

    Returns
    -------
    (n_pairs,) array of lags in samples, arrival at j minus arrival at i; NaN where the highest point is at the edge.
    """
    spectra = _levelled_spectra(segments, whitening)
    n_fft = 2 * (spectra.shape[1] - 1)
    # j times conjugate of i: the peak lies where j is later than i
    crosses = spectra[pairs[:, 1]] * np.conj(spectra[pairs[:, 0]])
    correlations = irfft(crosses, n=n_fft * UPSAMPLING, axis=1)
    reach = min(int(np.ceil(max_lag_samples * UPSAMPLING)), n_fft * UPSAMPLING // 2 - 1)
    lags = np.arange(-reach, reach + 1)
    return np.asarray(_peak_places(correlations[:, lags]) / UPSAMPLING - reach / UPSAMPLING)


def _levelled_spectra(segments: FloatArray, whitening: Whitening) -> FloatArray:
    n_fft = next_fast_len(2 * segments.shape[1], real=True)
    n_fft += n_fft % 2
    spectra = rfft(segments, n=n_fft, axis=1)
    frequencies_hz = np.fft.rfftfreq(n_fft, 1 / whitening.sample_rate_hz)
    spectra[:, (frequencies_hz < whitening.band_hz[0]) | (frequencies_hz > whitening.band_hz[1])] = 0.0
    magnitudes = np.abs(spectra)
    floors = np.maximum(whitening.floor * magnitudes.max(axis=1, keepdims=True), np.finfo(float).tiny)
    return np.asarray(spectra / np.maximum(magnitudes, floors))


def _peak_places(correlations: FloatArray) -> FloatArray:
    """Return where each row is highest, refined by the parabola through three samples; NaN at an edge."""
    rows = np.arange(len(correlations))
    highest = np.argmax(correlations, axis=1)
    peaks = np.clip(highest, 1, correlations.shape[1] - 2)
    before, at, after = (correlations[rows, peaks + offset] for offset in (-1, 0, 1))
    curvature = before - 2 * at + after
    shift = np.where(curvature < 0, 0.5 * (before - after) / np.where(curvature < 0, curvature, 1.0), 0.0)
    return np.where(highest == peaks, peaks + np.clip(shift, -1.0, 1.0), np.nan)
