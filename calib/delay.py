"""Delays by parts of a sample."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def delay_factors(delay_samples: FloatArray, n_samples: int) -> NDArray[np.complex64]:
    """Return what delays the real spectra of stretches of `n_samples` when multiplied with them.

    Parameters
    ----------
    delay_samples : (...) array
    n_samples : int

    Returns
    -------
    (..., n_samples // 2 + 1) array
        Single precision is enough once whole turns are taken off.
    """
    turns = delay_samples[..., None] * (np.arange(n_samples // 2 + 1) / n_samples)
    angle = (-2 * np.pi * (turns - np.rint(turns))).astype(np.float32)
    factors = np.empty(angle.shape, dtype=np.complex64)
    factors.real, factors.imag = np.cos(angle), np.sin(angle)
    return factors
