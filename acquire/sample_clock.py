"""The sample clock: which sample of the recording was taken at which moment of the host's clock.

A block's stamp comes late, by however long the callback was held up, and hardly ever early: sound servers hand over
some blocks before they are due. So the line from samples to host time runs along the early edge of the stamps, and
neither a late nor an early one moves it; only when a whole second of them is off, samples were lost or a clock jumped.
"""

from __future__ import annotations

import math
from array import array
from collections import deque
from statistics import median
from typing import NamedTuple

import numpy as np

from acquire.devices.base import ClockFit
from acquire.stamp_line import FloatArray, StampLine, line_along

WINDOW_S = 60.0  # long enough to tell the rate to a few ppm, short enough that a crystal keeps it
JUMP_S = 0.005  # a lasting shift beyond this is no jitter
_BIN_S = 0.5  # of each such stretch the earliest stamp but one counts
_FEW = 4  # of so few stamps the earliest counts
_DOUBT_S = 1.0  # so long must blocks be off before it counts as a step; a backlog is worked off sooner
_BIG_JUMP_S = 0.05  # early by more than this, the clock has jumped; by less, a sound server may be in advance
_EARLY_DOUBT_S = 3.0  # so long must blocks be early by less
_START_UP_S = 3.0  # the first stamps may all be late
_SETTLED_BINS = 3  # so many bins, and as many before them, must agree: as long as the start-up
_SETTLED_S = 0.001  # then they move less in an emission than the way of the sound differs from pose to pose
_RESOLUTION_S = 20e-6


class _Stamp(NamedTuple):
    sample: int
    host_s: float
    late_s: float


class SampleClock:
    """Relates samples to host time by a line along the stamps of the last minute's audio blocks.

    Parameters
    ----------
    sample_rate_hz : float
        The nominal one.
    """

    def __init__(self, sample_rate_hz: float) -> None:
        self._sample_rate_hz = sample_rate_hz
        self._longest: ClockFit | None = None
        self._begin()

    def restart(self) -> None:
        """Forget all stamps: samples were lost, so what they said holds no longer."""
        self._longest = self.longest_fit()
        self._begin()

    def _begin(self) -> None:
        self._samples, self._hosts_s = array("d"), array("d")  # the stamp that counts of each bin
        self._bin: list[tuple[float, int, float]] = []  # the two earliest stamps of the present bin: how late, stamp
        self._bin_end, self._n_in_bin = -math.inf, 0
        self._n_blocks, self._sum_late_s = 0, 0.0
        self._line: StampLine | None = None
        self._recent: deque[_Stamp] = deque()

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
        late_s = host_time_s - self._host_s(first_sample) if self._samples else 0.0
        self._remember(_Stamp(first_sample, host_time_s, late_s))
        step_s = self._step_s()
        if step_s is None:
            self._sum_late_s += max(late_s, 0.0)
            if late_s >= -JUMP_S or self._lasts_s() < _START_UP_S:
                self._take(first_sample, host_time_s)
            return None
        since = [stamp for stamp in self._last(_DOUBT_S) if stamp.late_s * math.copysign(1, step_s) > JUMP_S]
        is_new = step_s < 0 and self._lasts_s() < _START_UP_S + _DOUBT_S
        self.restart()
        for stamp in since:
            self._take(stamp.sample, stamp.host_s)
        return None if is_new else step_s

    @property
    def is_in_doubt(self) -> bool:
        """Blocks come late or early, and it is not yet clear whether samples were lost."""
        return any(abs(stamp.late_s) > self._jump_s() for stamp in list(self._recent)[-2:])

    @property
    def is_settled(self) -> bool:
        """The stamps keep step with the samples and with the line: for 3 s, but for single ones.

        While a driver's or a sound server's buffers still fill or empty, stamps drift against the samples.
        """
        if len(self._samples) <= 2 * _SETTLED_BINS:
            return False
        bins = slice(-1 - 2 * _SETTLED_BINS, -1)  # the last one is not complete
        samples, hosts_s = np.array(self._samples[bins]), np.array(self._hosts_s[bins])
        line = self._needed_line()
        off_s = hosts_s - line.host_s0 - (samples - line.sample0) * (1 + line.slope) / self._sample_rate_hz
        before_s, after_s = median(off_s[:_SETTLED_BINS]), median(off_s[_SETTLED_BINS:])
        tolerance_s = _SETTLED_S + line.spread_s
        return bool(abs(after_s - before_s) <= tolerance_s and abs(after_s) <= tolerance_s)

    def sample_at(self, host_time_s: float) -> float | None:
        """Return the row of the recording, with its fraction, taken at a host time; None before the first block."""
        if not self._samples:
            return None
        line = self._needed_line()
        return line.sample0 + (host_time_s - line.host_s0) * self._sample_rate_hz / (1 + line.slope)

    def fit(self) -> ClockFit | None:
        """Return the line along the last minute's stamps; None before the first block."""
        return self._as_fit(self._needed_line(), self._window()[1]) if self._samples else None

    def longest_fit(self) -> ClockFit | None:
        """Return the line along all stamps of the longest stretch without a break; None before the first block."""
        if not self._samples:
            return self._longest
        samples, hosts_s = np.frombuffer(self._samples), np.frombuffer(self._hosts_s)
        whole = self._as_fit(line_along(samples, hosts_s, self._sample_rate_hz, self._noise_s()), hosts_s)
        return whole if self._longest is None or whole.n_readings >= self._longest.n_readings else self._longest

    def _remember(self, stamp: _Stamp) -> None:
        self._recent.append(stamp)
        while len(self._recent) > 1 and self._age_s(self._recent[1]) >= _EARLY_DOUBT_S:
            self._recent.popleft()

    def _age_s(self, stamp: _Stamp) -> float:
        """Return how long ago a stamp was, as the samples tell it: the host's clock may have jumped."""
        return (self._recent[-1].sample - stamp.sample) / self._sample_rate_hz

    def _last(self, duration_s: float) -> list[_Stamp]:
        """Return the stamps of so long a time until now; none where fewer are known."""
        if self._age_s(self._recent[0]) < duration_s:
            return []
        return [stamp for stamp in self._recent if self._age_s(stamp) <= duration_s]

    def _step_s(self) -> float | None:
        """Return by how much blocks are late for a second, all but one, or early for some time, most of them."""
        last = self._last(_DOUBT_S)
        jump_s = self._jump_s()
        if len(last) < _FEW or abs(last[-1].late_s) <= jump_s:
            return None
        lates_s = sorted(stamp.late_s for stamp in last)
        came_at_once = last[-1].host_s - last[0].host_s < _DOUBT_S / 2  # a backlog that was worked off
        if (lates_s[1] > jump_s and not came_at_once) or median(lates_s) < -_BIG_JUMP_S:
            return _low_quartile(lates_s)
        lately_s = sorted(stamp.late_s for stamp in self._last(_EARLY_DOUBT_S))
        return _low_quartile(lately_s) if lately_s and median(lately_s) < -jump_s else None

    def _jump_s(self) -> float:
        """Return how far blocks must be off: further than those of this device are anyway."""
        return JUMP_S + (self._needed_line().spread_s if self._samples else 0.0)

    def _lasts_s(self) -> float:
        return len(self._samples) * _BIN_S

    def _take(self, first_sample: int, host_time_s: float) -> None:
        self._n_blocks += 1
        if first_sample >= self._bin_end:
            self._bin_end = first_sample + _BIN_S * self._sample_rate_hz
            self._bin, self._n_in_bin = [], 0
            self._samples.append(first_sample)
            self._hosts_s.append(host_time_s)
        self._n_in_bin += 1
        late_s = host_time_s - first_sample / self._sample_rate_hz
        self._bin = sorted([*self._bin, (late_s, first_sample, host_time_s)])[:2]
        _, sample, host_s = self._bin[-1 if self._n_in_bin >= _FEW else 0]
        if self._n_in_bin == 1 or sample != self._samples[-1]:
            self._samples[-1], self._hosts_s[-1] = sample, host_s
            self._line = None

    def _host_s(self, sample: float) -> float:
        line = self._needed_line()
        return line.host_s0 + (sample - line.sample0) * (1 + line.slope) / self._sample_rate_hz

    def _window(self) -> tuple[FloatArray, FloatArray]:
        n_bins = round(WINDOW_S / _BIN_S)
        return np.array(self._samples[-n_bins:]), np.array(self._hosts_s[-n_bins:])

    def _needed_line(self) -> StampLine:
        if self._line is None:
            self._line = line_along(*self._window(), self._sample_rate_hz, self._noise_s())
        return self._line

    def _noise_s(self) -> float:
        """Return how late the earliest of a bin's blocks typically is: the mean lateness over the number of blocks."""
        return _RESOLUTION_S + self._sum_late_s * len(self._samples) / self._n_blocks**2

    def _as_fit(self, line: StampLine, hosts_s: FloatArray) -> ClockFit:
        rate_hz = self._sample_rate_hz / (1 + line.slope)
        return ClockFit(
            float(hosts_s[0]), line.host_s0, line.sample0, rate_hz, line.slope_std, line.std_s, len(hosts_s)
        )


def _low_quartile(ascending: list[float]) -> float:
    return ascending[len(ascending) // 4]
