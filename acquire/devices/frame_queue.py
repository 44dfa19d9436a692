"""The queue of a camera's frames: in a steady rhythm, whether or not anybody has time for them."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from acquire.devices.base import Frame, Rhythm

_MOST_BYTES = 64e6  # a dozen seconds of gray frames of 1280 x 720 at 5 per second


class FrameQueue:
    """Holds the first frame of each interval until it is taken; filled and emptied in different threads.

    An interval begins a quarter early, so that a camera which is as fast as the rhythm hits every one.

    Parameters
    ----------
    rhythm : Rhythm
    most_bytes : float
        Of all frames that wait; a frame that finds no room is counted as missing.
    """

    def __init__(self, rhythm: Rhythm, most_bytes: float = _MOST_BYTES) -> None:
        self._interval_s, self._most_bytes = rhythm.interval_s, most_bytes
        self._due_s = rhythm.since_s + 0.75 * rhythm.interval_s
        self._frames: deque[Frame] = deque()
        self._n_missing = 0

    def is_due(self, time_s: float) -> bool:
        """Tell whether a frame of this time is wanted."""
        return time_s >= self._due_s

    def put(self, frame: Frame) -> None:
        """Queue a frame that is due, and count in it those that were due before it and never came."""
        n_late = self._n_late(frame.host_time_s)
        self._due_s += (n_late + 1) * self._interval_s
        self._n_missing += n_late
        if len(self._frames) * frame.image.nbytes >= self._most_bytes:
            self._n_missing += 1
            return
        self._frames.append(replace(frame, n_missing=self._n_missing))
        self._n_missing = 0

    def take(self) -> list[Frame]:
        """Return the frames that wait, in order, and hold them no longer."""
        return [self._frames.popleft() for _ in range(len(self._frames))]

    def n_missing_at(self, time_s: float) -> int:
        """Return how many are missing at the end, after the last that was queued."""
        return self._n_missing + self._n_late(time_s)

    def _n_late(self, time_s: float) -> int:
        return max(0, int((time_s - self._due_s) / self._interval_s))
