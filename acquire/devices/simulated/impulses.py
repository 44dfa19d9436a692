"""Impulses between the samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import i0

FloatArray = NDArray[np.float64]
HALF_WIDTH_SAMPLES = 32
_KAISER_BETA = 10.0  # 100 dB: delays true to a few nanoseconds up to 0.45 of the sample rate


def band_limited_impulses(position_samples: FloatArray, weight: FloatArray, n_samples: int) -> FloatArray:
    """Sum band-limited impulses at fractional places (Kaiser-windowed sinc).

    Parameters
    ----------
    position_samples : (n_rows, n_impulses) array
        From HALF_WIDTH_SAMPLES to n_samples - HALF_WIDTH_SAMPLES - 1; others are left out.
    weight : (n_rows, n_impulses) array
    n_samples : int

    Returns
    -------
    (n_rows, n_samples) array
    """
    rows = np.broadcast_to(np.arange(len(position_samples))[:, None], position_samples.shape)
    inside = (position_samples >= HALF_WIDTH_SAMPLES) & (position_samples < n_samples - HALF_WIDTH_SAMPLES)
    position, height = position_samples[inside], weight[inside]
    whole = np.floor(position).astype(int)
    tap = np.arange(-HALF_WIDTH_SAMPLES + 1, HALF_WIDTH_SAMPLES + 1)
    distance = tap - (position - whole)[:, None]
    window = i0(_KAISER_BETA * np.sqrt(1 - (distance / HALF_WIDTH_SAMPLES) ** 2)) / i0(_KAISER_BETA)
    place = (rows[inside] * n_samples + whole)[:, None] + tap
    values = np.sinc(distance) * window * height[:, None]
    total = np.bincount(place.ravel(), values.ravel(), minlength=len(position_samples) * n_samples)
    return np.asarray(total.reshape(len(position_samples), n_samples))
