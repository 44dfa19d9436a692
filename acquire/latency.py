"""The latency of the audio path: how much later a sound is found in the recording than the clocks say."""

from __future__ import annotations

from collections import deque

import numpy as np

WIDE_WINDOW_S = (-0.05, 0.4)  # USB and sound servers: tens to hundreds of milliseconds
_KEPT = 25  # emissions; a slow change is followed
_FIRST_STD_S = 0.003  # the way of the sound differs from pose to pose
_AGREE_S = 0.01  # two emissions that tell of the same latency; of two random ones in the window 1 in 22 do


class Latency:
    """Learnt from the first emission that is heard, confirmed by the next, then the median of the last ones.

    It holds all that is constant: buffers of the sound device and its server, the board's own delay, and the typical
    way of the sound.

    Parameters
    ----------
    tolerance_s : float
        How far an onset may be from where the latency lets it be expected.

    Attributes
    ----------
    changes : int
        How often what was known turned out to be wrong so far.
    """

    def __init__(self, tolerance_s: float) -> None:
        self._tolerance_s = tolerance_s
        self._offsets_s: deque[float] = deque(maxlen=_KEPT)
        self._witness_s: float | None = None  # what one more emission would confirm
        self.changes = 0

    @property
    def is_known(self) -> bool:
        """An emission was heard since the audio path was last changed."""
        return bool(self._offsets_s)

    @property
    def is_confirmed(self) -> bool:
        """Two emissions agree on it: a single one may have been another sound."""
        return len(self._offsets_s) > 1

    @property
    def value_s(self) -> float:
        """What is known of it; 0 before the first emission."""
        return float(np.median(self._offsets_s)) if self._offsets_s else 0.0

    @property
    def std_s(self) -> float:
        """The standard deviation of a single emission's latency about `value_s`."""
        if len(self._offsets_s) < 3:
            return _FIRST_STD_S
        return float(np.std(self._offsets_s, ddof=1))

    def window_s(self) -> tuple[float, float]:
        """Return (first, last): where an onset is looked for, relative to where the clocks put it."""
        if not self.is_known:
            return WIDE_WINDOW_S
        return self.value_s - self._tolerance_s, self.value_s + self._tolerance_s

    def learn(self, offset_s: float) -> bool:
        """Take in how much later than the clocks say an emission was heard, and tell whether it is believed.

        One that contradicts what is known is not, but when the next tells the same, what was known is forgotten.
        """
        agrees = self._witness_s is not None and abs(offset_s - self._witness_s) <= _AGREE_S
        if self.is_known and abs(offset_s - self.value_s) > self._tolerance_s:
            if not agrees:
                self._witness_s = offset_s
                return False
            self._offsets_s.clear()
            self.changes += 1
        if not self.is_known and agrees and self._witness_s is not None:
            self._offsets_s.append(self._witness_s)
        self._offsets_s.append(offset_s)
        self._witness_s = None
        return True

    def forget(self) -> None:
        """Learn it anew, as the audio path may be another one now; the next emission confirms it if it is not."""
        if self.is_known:
            self._witness_s = self.value_s
        self._offsets_s.clear()
