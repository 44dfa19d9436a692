"""The losses of sound: where some is missing and how much, told once where one loss follows another."""

from __future__ import annotations

import math
from collections.abc import Callable

_AT_ONCE_S = 1.0  # losses that follow so soon have one cause


class Losses:
    """Counts how often sound was lost, and tells the operator.

    Parameters
    ----------
    say : callable
        Tells the operator and the log: level and text.

    Attributes
    ----------
    n : int
        How often so far.
    """

    def __init__(self, say: Callable[[str, str], None]) -> None:
        self._say = say
        self.n = 0
        self._last_s = -math.inf  # where in the recording
        self._n_more, self._more_s = 0, 0.0

    def note(self, time_s: float, missing_s: float, why: str) -> None:
        """Take note of a loss, and tell of it unless it follows another at once.

        Parameters
        ----------
        time_s : float
            Where in the recording.
        missing_s : float
            How much is missing there; 0 where nobody knows.
        why : str
        """
        self.n += 1
        follows, self._last_s = time_s - self._last_s < _AT_ONCE_S, time_s
        if follows:
            self._n_more, self._more_s = self._n_more + 1, self._more_s + missing_s
        else:
            self._say("warning", f"{_in_words(missing_s)} missing at {time_s:.1f} s of the recording: {why}")

    def pass_over(self, time_s: float) -> None:
        """Tell of those that followed the last that was told, once there are no more of them."""
        if self._n_more and time_s - self._last_s >= _AT_ONCE_S:
            times = "once more" if self._n_more == 1 else f"{self._n_more} times more"
            self._say("warning", f"{_in_words(self._more_s)} missing until {self._last_s:.1f} s, lost {times}")
            self._n_more, self._more_s = 0, 0.0


def _in_words(missing_s: float) -> str:
    if missing_s < 0.001:
        return "some sound"
    return f"{missing_s:.1f} s of sound" if missing_s >= 0.1 else f"{1e3 * missing_s:.0f} ms of sound"
