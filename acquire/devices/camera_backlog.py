"""The backlog of a camera: pictures that waited somewhere on their way, and so are older than the moment they came in.

A picture that had to be waited for is new; one that was there at once may be old. How old at most, their number tells:
with every picture the camera goes on by an interval. A pause is no waiting: a network that held pictures back, too,
lets nothing come and then many at once.
"""

from __future__ import annotations

import sys
import time
from collections import deque
from pathlib import Path
from statistics import median

_FAIR_SHARE = 0.3  # of the interval between two pictures: who slept so long for one, slept for the camera
_PAUSE = 3.0  # intervals without a picture
_WAITS, _OF = 2, 3  # so many of the last pictures must have been waited for: a thread sleeps for other reasons, too
_KNOWN = 31  # intervals
_SCHEDULER = Path("/proc/thread-self/schedstat")  # Linux: nanoseconds on a core, and nanoseconds in the queue for one


class Backlog:
    """Judges which pictures of a live camera are new, by how long they were waited for.

    Parameters
    ----------
    interval_s : float
        Between two pictures, until it is known better.
    """

    def __init__(self, interval_s: float) -> None:
        self._nominal_s = interval_s
        self._intervals_s: deque[float] = deque(maxlen=_KNOWN)
        self._waited: deque[bool] = deque(maxlen=_OF)
        self._came_s = -float("inf")
        self._age_s = float("inf")  # at most, of the last picture; what was stored up at the start is unknown

    def is_new(self, came_s: float, slept_s: float) -> bool:
        """Take note of a picture, and tell whether it is younger than an interval or so.

        Parameters
        ----------
        came_s : float
            Host monotonic time at which it was there.
        slept_s : float
            How long its reader slept for it, as `Sleep` measures.
        """
        gone_s, self._came_s = came_s - self._came_s, came_s
        if slept_s > gone_s / 2:
            self._intervals_s.append(gone_s)
        interval_s = median(self._intervals_s) if self._intervals_s else self._nominal_s
        self._age_s = max(0.0, self._age_s + gone_s - interval_s)
        if gone_s > _PAUSE * interval_s:
            self._waited.clear()
        else:
            self._waited.append(slept_s > _FAIR_SHARE * interval_s)
        if self._waited and self._waited[-1] and sum(self._waited) >= _WAITS:
            self._age_s = 0.0
        return self._age_s <= interval_s


class Sleep:
    """Measures how long this thread has slept; where Linux tells, waiting for a core that others use is no sleep."""

    def __init__(self) -> None:
        self._knows_queue = sys.platform == "linux" and _SCHEDULER.exists()
        self._awake_s = self._so_far_s()
        self._since_s = time.monotonic()

    def slept_s(self) -> float:
        """Return how long it has slept since this was made."""
        return time.monotonic() - self._since_s - (self._so_far_s() - self._awake_s)

    def _so_far_s(self) -> float:
        if not self._knows_queue:
            return time.thread_time()
        running_ns, queued_ns, _ = _SCHEDULER.read_text().split()
        return 1e-9 * (int(running_ns) + int(queued_ns))
