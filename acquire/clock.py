"""The host's clock, and a virtual one for the simulated rig."""

from __future__ import annotations

import time


class MonotonicClock:
    """The host's monotonic clock."""

    def now_s(self) -> float:
        """Return the time in seconds."""
        return time.monotonic()

    def sleep_s(self, duration_s: float) -> None:
        """Let time pass; a duration below zero counts as none."""
        time.sleep(max(0.0, duration_s))


class VirtualClock:
    """A clock that moves only when somebody sleeps on it.

    Parameters
    ----------
    start_s : float
        Its first time in seconds.
    """

    def __init__(self, start_s: float = 1000.0) -> None:
        self._now_s = start_s

    def now_s(self) -> float:
        """Return the time in seconds."""
        return self._now_s

    def sleep_s(self, duration_s: float) -> None:
        """Move the clock on, at once; a duration below zero counts as none."""
        self._now_s += max(0.0, duration_s)
