"""The hold-ups: what kept the capture from storing sound, so that a warning names it."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum

from acquire.devices.base import Clock


class Cause(StrEnum):
    """What sound may have to wait for; devices are none of them, as nothing waits for their answers."""

    DISK = "the disk"
    PICTURES = "the search for the board in a picture"
    COMPUTER = "this computer, which was busy or stood still"


REMEDIES = {
    Cause.DISK: "record to another disk, or close programs that write to this one",
    Cause.PICTURES: "close other programs, or choose a smaller camera.size_px",
    Cause.COMPUTER: "close other programs",
}


class HoldUps:
    """Adds up how long each cause took since sound was stored last.

    Parameters
    ----------
    clock : Clock
    worked_s : callable, optional
        How long this program has worked so far; while it works on nothing, the computer holds it up.
    """

    def __init__(self, clock: Clock, worked_s: Callable[[], float] = time.process_time) -> None:
        self._clock, self._worked_s = clock, worked_s
        self._spent_s: dict[Cause, float] = defaultdict(float)
        self._since_s = clock.now_s()

    @contextmanager
    def during(self, cause: Cause) -> Iterator[None]:
        """Count the time of a block for a cause."""
        now_s = self._worked_s if cause is Cause.PICTURES else self._clock.now_s
        began_s = now_s()
        try:
            yield
        finally:
            self._spent_s[cause] += now_s() - began_s

    def blame(self) -> Cause:
        """Return what took most of the time since the last call; the computer, where none of the others did."""
        lasted_s, self._since_s = self._clock.now_s() - self._since_s, self._clock.now_s()
        spent_s, self._spent_s = self._spent_s, defaultdict(float)
        worst = max(spent_s, key=spent_s.__getitem__, default=Cause.COMPUTER)
        return worst if spent_s[worst] > lasted_s / 2 else Cause.COMPUTER
