"""A device's own clock."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Oscillator:
    """A clock that started counting at some moment and runs a little fast or slow.

    Parameters
    ----------
    origin_s : float
        Host time at which it read zero.
    rate : float
        Its seconds per second of the host.
    """

    origin_s: float
    rate: float

    def reading_s(self, host_s: float) -> float:
        """Return what it reads at a host time."""
        return (host_s - self.origin_s) * self.rate

    def host_s(self, reading_s: float) -> float:
        """Return the host time at which it reads this."""
        return self.origin_s + reading_s / self.rate
