"""The line along the early edge of stamps: most come late, by up to a tenth of a second, and now and then one early.

It is the line of a low quantile (Koenker and Bassett, "Regression quantiles", 1978): three quarters of the stamps may
be late at the same time, and nearly a quarter early, before it moves by more than their noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_QUANTILE = 0.25
_MANY = 12  # of these, two or three that are off do not make the spread
_RATE_STD = 100e-6  # what a crystal may be off: holds the rate while the stamps span little time
_RATE_LIMIT = 1e-3
_HALVINGS = 16  # down to 0.015 ppm


@dataclass(frozen=True)
class StampLine:
    """host_s = host_s0 + (sample - sample0) * (1 + slope) / nominal rate, and how far the stamps lie off it.

    `spread_s` is how much later than the line three quarters of the stamps are at most; 0 while there are few.
    """

    sample0: float
    host_s0: float
    slope: float
    slope_std: float
    std_s: float
    spread_s: float


def line_along(samples: FloatArray, hosts_s: FloatArray, sample_rate_hz: float, noise_s: float) -> StampLine:
    """Return the line along the early edge of stamps.

    Its rate is held near the nominal one, and its uncertainty is that of `noise_s` at least: few stamps show none.

    Parameters
    ----------
    samples, hosts_s : (n,) float arrays
        Rows of the recording, and the host times (s) at which they were taken as the stamps say.
    sample_rate_hz : float
        The nominal one.
    noise_s : float
        Standard deviation (s) of one stamp's lateness.
    """
    time_s = (samples - samples[0]) / sample_rate_hz
    ahead_s = hosts_s - hosts_s[0] - time_s
    centre_s = float(time_s.mean())
    about_s = time_s - centre_s
    slope = _slope_along(about_s, ahead_s)
    noise_s = max(noise_s, float(np.std(ahead_s - slope * about_s)))
    slope_std = noise_s / math.sqrt(float(np.sum(about_s**2)) + (noise_s / _RATE_STD) ** 2)
    slope *= 1 - (slope_std / _RATE_STD) ** 2
    off_s = ahead_s - slope * about_s
    edge_s = float(off_s[_edge(off_s)])
    std_s = max(noise_s, float(np.sqrt(np.mean((off_s - edge_s) ** 2))))
    host_s0 = float(hosts_s[0]) + centre_s + edge_s
    spread_s = float(np.quantile(off_s, 1 - _QUANTILE)) - edge_s if len(off_s) >= _MANY else 0.0
    return StampLine(float(samples[0]) + centre_s * sample_rate_hz, host_s0, slope, slope_std, std_s, spread_s)


def _edge(off_s: FloatArray) -> int:
    """Return which of the stamps has the low quantile of all."""
    k = int(_QUANTILE * (len(off_s) - 1))
    return int(np.argpartition(off_s, k)[k])


def _slope_along(about_s: FloatArray, ahead_s: FloatArray) -> float:
    """Return the slope of the quantile's line: where the loss, convex in the slope, turns from falling to rising."""
    low, high = -_RATE_LIMIT, _RATE_LIMIT
    for _ in range(_HALVINGS):
        slope = (low + high) / 2
        off_s = ahead_s - slope * about_s
        edge = _edge(off_s)
        weights = np.where(off_s < off_s[edge], _QUANTILE - 1, _QUANTILE)
        weights[edge] -= weights.sum()
        low, high = (slope, high) if weights @ about_s > 0 else (low, slope)
    return (low + high) / 2
