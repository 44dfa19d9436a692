"""The sample clock: which sample of the recording was taken at which moment of the host's clock."""

from __future__ import annotations

from collections import deque

import numpy as np

WINDOW_S = 5.0  # long enough to average jitter, short enough that 100 ppm of drift stay under 0.3 ms
JUMP_S = 0.005  # a lasting shift beyond this is no jitter
_RECENT = 3  # blocks that must agree before a shift counts
_SETTLED = 5  # blocks needed before a shift can be told


class SampleClock:
    """Relates host time to samples by the median over recent audio blocks, whose single stamps jitter.

    Parameters
    ----------
    sample_rate_hz : float
    """

    def __init__(self, sample_rate_hz: float) -> None:
        self._sample_rate_hz = sample_rate_hz
        self._stamps_s: deque[tuple[float, float]] = deque()  # host time, and the same for sample 0 if none was lost

    def add(self, first_sample: int, host_time_s: float) -> bool:
        """Take the stamp of a block; True when the stamps say that samples before it were lost.

        Parameters
        ----------
        first_sample : int
            Row of the recording where the block begins.
        host_time_s : float
            When that sample was taken, as the host reckons.
        """
        self._stamps_s.append((host_time_s, host_time_s - first_sample / self._sample_rate_hz))
        while host_time_s - self._stamps_s[0][0] > WINDOW_S:
            self._stamps_s.popleft()
        return self._has_jumped()

    def restart(self) -> None:
        """Forget all stamps: samples were lost, so what they said holds no longer."""
        self._stamps_s.clear()

    def sample_at(self, host_time_s: float) -> int | None:
        """Return the row of the recording that was taken at a host time, None before the first block."""
        if not self._stamps_s:
            return None
        origin_s = float(np.median([origin for _, origin in self._stamps_s]))
        return round((host_time_s - origin_s) * self._sample_rate_hz)

    def _has_jumped(self) -> bool:
        origins_s = np.array([origin for _, origin in self._stamps_s])
        older, recent = origins_s[:-_RECENT], origins_s[-_RECENT:]
        if len(older) < _SETTLED:
            return False
        shift_s = recent - np.median(older)
        late, early = bool(shift_s.min() > JUMP_S), bool(shift_s.max() < -JUMP_S)
        if late or early:  # early: the first stamps came late, nothing is missing
            self._stamps_s = deque(list(self._stamps_s)[-_RECENT:])
        return late
