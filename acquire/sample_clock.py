"""The sample clock: which sample of the recording was taken at which moment of the host's clock.

A block's stamp comes late, by however long the callback was held up, and never early. So the line from samples to host
time runs along the earliest stamps: the line under all of them that is nearest to them on the whole (the linear program
of Moon, Skelly and Towsley, "Estimation and removal of clock skew from network delay measurements", 1999).
"""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquire.devices.base import ClockFit

FloatArray = NDArray[np.float64]

WINDOW_S = 60.0  # long enough to tell the rate to a few ppm, short enough that a crystal keeps it
JUMP_S = 0.005  # a lasting shift beyond this is no jitter
_BIN_S = 0.5  # of each such stretch the earliest stamp counts
_DOUBT_S = 1.0  # so long must every block be late before samples count as lost; a backlog is worked off sooner
_START_UP_S = 3.0  # the first stamps may all be late
_RATE_STD = 100e-6  # what a crystal may be off: holds the rate while the stamps span little time
_RATE_LIMIT = 1e-3
_RESOLUTION_S = 20e-6


@dataclass(frozen=True)
class _Line:
    """host_s = host_s0 + (sample - sample0) * (1 + slope) / nominal rate, and how far the earliest stamps lie above."""

    sample0: float
    host_s0: float
    slope: float
    slope_std: float
    std_s: float


class SampleClock:
    """Relates samples to host time by a line under the stamps of the last minute's audio blocks.

    Parameters
    ----------
    sample_rate_hz : float
        The nominal one.
    """

    def __init__(self, sample_rate_hz: float) -> None:
        self._sample_rate_hz = sample_rate_hz
        self._longest: ClockFit | None = None
        self.restart()

    def restart(self) -> None:
        """Forget all stamps: samples were lost, so what they said holds no longer."""
        self._longest = self.longest_fit() if hasattr(self, "_samples") else None
        self._samples, self._hosts_s = array("d"), array("d")  # the earliest stamp of each bin
        self._n_blocks, self._sum_late_s = 0, 0.0
        self._bin_end_s = -math.inf
        self._line: _Line | None = None
        self._late_since: tuple[float, int] | None = None

    def add(self, first_sample: int, host_time_s: float) -> float | None:
        """Take the stamp of a block.

        Parameters
        ----------
        first_sample : int
            Row of the recording where the block begins.
        host_time_s : float
            When that sample was taken, as the host reckons.

        Returns
        -------
        float or None
            For how long (s) samples are missing before this block, or within the last second before it; negative
            where there are more than the time allows, so that the host's clock has jumped; None when all is well.
        """
        step_s = self._step_s(first_sample, host_time_s)
        if step_s is not None:
            is_new = step_s < 0 and host_time_s - self._hosts_s[0] < _START_UP_S
            self.restart()
            step_s = None if is_new else step_s
        self._take(first_sample, host_time_s)
        return step_s

    @property
    def is_in_doubt(self) -> bool:
        """Blocks come late, and it is not yet clear whether samples were lost."""
        return self._late_since is not None

    def sample_at(self, host_time_s: float) -> float | None:
        """Return the row of the recording, with its fraction, taken at a host time; None before the first block."""
        if not self._samples:
            return None
        line = self._needed_line()
        return line.sample0 + (host_time_s - line.host_s0) * self._sample_rate_hz / (1 + line.slope)

    def fit(self) -> ClockFit | None:
        """Return the line under the last minute's stamps; None before the first block."""
        return self._as_fit(self._needed_line(), self._window()[1]) if self._samples else None

    def longest_fit(self) -> ClockFit | None:
        """Return the line under all stamps of the longest stretch without a break; None before the first block."""
        if not self._samples:
            return self._longest
        samples, hosts_s = np.frombuffer(self._samples), np.frombuffer(self._hosts_s)
        whole = self._as_fit(_line_under(samples, hosts_s, self._sample_rate_hz, self._noise_s()), hosts_s)
        return whole if self._longest is None or whole.n_readings >= self._longest.n_readings else self._longest

    def _step_s(self, first_sample: int, host_time_s: float) -> float | None:
        expected_s = self._host_s(first_sample)
        if expected_s is None:
            return None
        late_s = host_time_s - expected_s
        self._sum_late_s += max(late_s, 0.0)
        if late_s <= JUMP_S:
            self._late_since = None
            return late_s if late_s < -JUMP_S else None
        since_s, n_late = self._late_since or (host_time_s, 0)
        self._late_since = (since_s, n_late + 1)
        return late_s if host_time_s - since_s >= _DOUBT_S and n_late >= 3 else None

    def _take(self, first_sample: int, host_time_s: float) -> None:
        self._n_blocks += 1
        if host_time_s >= self._bin_end_s:
            self._bin_end_s = host_time_s + _BIN_S
            self._samples.append(first_sample)
            self._hosts_s.append(host_time_s)
            self._line = None
        elif self._lateness_s(first_sample, host_time_s) < self._lateness_s(self._samples[-1], self._hosts_s[-1]):
            self._samples[-1], self._hosts_s[-1] = first_sample, host_time_s
            self._line = None

    def _lateness_s(self, sample: float, host_s: float) -> float:
        return host_s - sample / self._sample_rate_hz

    def _host_s(self, sample: float) -> float | None:
        if not self._samples:
            return None
        line = self._needed_line()
        return line.host_s0 + (sample - line.sample0) * (1 + line.slope) / self._sample_rate_hz

    def _window(self) -> tuple[FloatArray, FloatArray]:
        n_bins = round(WINDOW_S / _BIN_S)
        return np.array(self._samples[-n_bins:]), np.array(self._hosts_s[-n_bins:])

    def _needed_line(self) -> _Line:
        if self._line is None:
            self._line = _line_under(*self._window(), self._sample_rate_hz, self._noise_s())
        return self._line

    def _noise_s(self) -> float:
        """Return how late the earliest of a bin's blocks typically is: the mean lateness over the number of blocks."""
        return _RESOLUTION_S + self._sum_late_s * len(self._samples) / self._n_blocks**2

    def _as_fit(self, line: _Line, hosts_s: FloatArray) -> ClockFit:
        rate_hz = self._sample_rate_hz / (1 + line.slope)
        return ClockFit(
            float(hosts_s[0]), line.host_s0, line.sample0, rate_hz, line.slope_std, line.std_s, len(hosts_s)
        )


def _line_under(samples: FloatArray, hosts_s: FloatArray, sample_rate_hz: float, noise_s: float) -> _Line:
    """Return the line under the stamps (n,) that is nearest to them on the whole.

    Its rate is held near the nominal one, and its uncertainty is that of `noise_s` (s) at least: few stamps show none.
    """
    time_s = (samples - samples[0]) / sample_rate_hz
    ahead_s = hosts_s - hosts_s[0] - time_s
    centre_s = float(time_s.mean())
    slope = _slope_under(time_s, ahead_s, centre_s)
    noise_s = max(noise_s, float(np.std(ahead_s - slope * time_s)))
    slope_std = noise_s / math.sqrt(float(np.sum((time_s - centre_s) ** 2)) + (noise_s / _RATE_STD) ** 2)
    slope *= 1 - (slope_std / _RATE_STD) ** 2
    slope = min(max(slope, -_RATE_LIMIT), _RATE_LIMIT)
    above_s = ahead_s - slope * time_s
    floor_s = float(above_s.min())
    std_s = max(noise_s, float(np.sqrt(np.mean((above_s - floor_s) ** 2))))
    host_s0 = float(hosts_s[0]) + centre_s + floor_s + slope * centre_s
    return _Line(float(samples[0]) + centre_s * sample_rate_hz, host_s0, slope, slope_std, std_s)


def _slope_under(time_s: FloatArray, ahead_s: FloatArray, centre_s: float) -> float:
    """Return the slope of the lower convex hull's edge at `centre_s`, which solves the linear program."""
    hull: list[tuple[float, float]] = []
    for point in zip(time_s.tolist(), ahead_s.tolist(), strict=True):
        while len(hull) > 1 and _turns_down(hull[-2], hull[-1], point):
            hull.pop()
        hull.append(point)
    if len(hull) < 2:
        return 0.0
    right = next((k for k in range(1, len(hull)) if hull[k][0] >= centre_s), len(hull) - 1)
    (x0, y0), (x1, y1) = hull[right - 1], hull[right]
    return (y1 - y0) / (x1 - x0)


def _turns_down(first: tuple[float, float], middle: tuple[float, float], last: tuple[float, float]) -> bool:
    return (middle[0] - first[0]) * (last[1] - first[1]) <= (last[0] - first[0]) * (middle[1] - first[1])
