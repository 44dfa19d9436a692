"""Peaks of filtered sound: the first strong one, and its place between the samples."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import i0

FloatArray = NDArray[np.float64]

FIRST_PEAK_SHARE = 0.5  # a path this strong, of the strongest, may be the direct one
MIN_HEIGHT = 6.0  # over the noise's standard deviation: chance gives about 4.5
FOOTHILL_MARGIN = 1.3
FOOT_SAMPLES = 24
HALF_WIDTH_SAMPLES = 24
KAISER_BETA = 8.0
GRID_REACH, GRID_PER_SAMPLE = 3, 32
REACH = HALF_WIDTH_SAMPLES + GRID_REACH  # of the interpolation around a peak


def first_strong_peaks(
    envelopes: NDArray[np.float32], foothills: FloatArray, reach_samples: int, noise_rms: FloatArray
) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
    """Find the direct sound: the first peak that is strong and no foothill of a stronger one.

    Parameters
    ----------
    envelopes : (n, n_channels, n_samples) array
    foothills : (n_channels, reach_samples + 1) array
        How high a lone pulse is so many samples before its peak, over the peak.
    reach_samples : int
        How long before the strongest peak the direct sound may be.
    noise_rms : (n_channels,) array

    Returns
    -------
    first : (n, n_channels) integer array
    second : (n, n_channels) array
        The highest envelope elsewhere, beyond its own foothills, over it.
    second_lag : (n, n_channels) array
        How much later that is, in samples.
    """
    strongest = np.argmax(envelopes, axis=2)
    lags = np.arange(-reach_samples - 1, 2)
    places = np.clip(strongest[..., None] + lags, 0, envelopes.shape[2] - 1)
    before = np.take_along_axis(envelopes, places, axis=2)
    top = before[..., -2:-1]
    own = FOOTHILL_MARGIN * foothills[:, ::-1] * top
    least = np.maximum(FIRST_PEAK_SHARE * top, MIN_HEIGHT * noise_rms[:, None])
    middle = before[..., 1:-1]
    rises = (middle > before[..., :-2]) & (middle >= before[..., 2:])
    strong = rises & (middle > np.maximum(own, least))
    strong[..., -1] = True  # if nothing else, the strongest
    first = places[..., 1:-1]
    first = np.take_along_axis(first, np.argmax(strong, axis=2)[..., None], axis=2)
    height = np.take_along_axis(envelopes, first, axis=2)[..., 0]
    elsewhere = envelopes.copy()
    foot = np.clip(first + np.arange(-FOOT_SAMPLES, FOOT_SAMPLES + 1), 0, envelopes.shape[2] - 1)
    np.put_along_axis(elsewhere, foot, 0, axis=2)
    second = np.argmax(elsewhere, axis=2)
    ratio = np.take_along_axis(elsewhere, second[..., None], axis=2)[..., 0] / np.maximum(height, 1e-30)
    return first[..., 0], ratio.astype(float), (second - first[..., 0]).astype(float)


def refine_peaks(
    signals: NDArray[np.floating], places: NDArray[np.intp], reach: int = GRID_REACH
) -> tuple[FloatArray, FloatArray]:
    """Find the extremum of band-limited signals near whole samples.

    The interpolation and its first two derivatives are evaluated on a fine grid; from the highest point of it one
    Newton step leads to the extremum, so nothing of the grid remains (a parabola would leave a bias).

    Parameters
    ----------
    signals : (..., n_samples) array
    places : (...) integer array
    reach : int
        How many samples away it may be.

    Returns
    -------
    place : (...) array, in samples
    value : (...) array, the signal there
    """
    grid, interpolation = _interpolation(reach)
    taps = np.arange(-HALF_WIDTH_SAMPLES - reach, HALF_WIDTH_SAMPLES + reach + 1)
    index = np.clip(places[..., None] + taps, 0, signals.shape[-1] - 1)
    around = np.take_along_axis(signals, index, axis=-1)
    value, slope, curvature = np.split(around @ interpolation, 3, axis=-1)
    best = np.argmax(np.abs(value), axis=-1)[..., None]
    value, slope, curvature = (np.take_along_axis(of, best, axis=-1)[..., 0] for of in (value, slope, curvature))
    step = -slope / np.where(curvature == 0, np.inf, curvature)
    step = np.clip(step, -1 / GRID_PER_SAMPLE, 1 / GRID_PER_SAMPLE)
    return places + grid[best[..., 0]] + step, value + 0.5 * slope * step


@cache
def _interpolation(reach: int) -> tuple[FloatArray, NDArray[np.float32]]:
    """Return a grid around zero in samples, and the matrix (n_taps, 3 n_grid) for value, slope and curvature on it."""
    grid = np.arange(-reach * GRID_PER_SAMPLE, reach * GRID_PER_SAMPLE + 1) / GRID_PER_SAMPLE
    distance = grid - np.arange(-HALF_WIDTH_SAMPLES - reach, HALF_WIDTH_SAMPLES + reach + 1)[:, None]
    step = 1e-3
    here, after, before = (_kernel(distance + shift) for shift in (0.0, step, -step))
    slope, curvature = (after - before) / (2 * step), (after - 2 * here + before) / step**2
    return grid, np.hstack([here, slope, curvature]).astype(np.float32)


def _kernel(distance: FloatArray) -> FloatArray:
    """Kaiser-windowed sinc."""
    inside = np.clip(1 - (distance / HALF_WIDTH_SAMPLES) ** 2, 0.0, None)
    return np.asarray(np.sinc(distance) * i0(KAISER_BETA * np.sqrt(inside)) / i0(KAISER_BETA) * (inside > 0))
