"""The host's clock, and a virtual one for the simulated rig."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import wait as wait_until_done
from threading import Thread
from typing import TypeVar

_GLANCE_S = 0.05
T = TypeVar("T")


class MonotonicClock:
    """The host's monotonic clock."""

    def now_s(self) -> float:
        """Return the time in seconds."""
        return time.monotonic()

    def sleep_s(self, duration_s: float) -> None:
        """Let time pass; a duration below zero counts as none."""
        time.sleep(max(0.0, duration_s))

    def wait_for(self, call: Callable[[], T], meanwhile: Callable[[], None]) -> T:
        """Return what a call returns that may take long, or raise what it raises; `meanwhile` is called until then.

        The call runs in a thread of its own. Where `meanwhile` raises, it is left behind, as nobody can end it.
        """
        outcome: Future[T] = Future()
        Thread(target=_carry_out, args=(call, outcome), name="waiting for a device", daemon=True).start()
        while not wait_until_done([outcome], _GLANCE_S).done:
            meanwhile()
        return outcome.result()


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

    def wait_for(self, call: Callable[[], T], meanwhile: Callable[[], None]) -> T:
        """Return what a call returns: whatever it does takes no time but what it sleeps on this clock."""
        return call()


def _carry_out(call: Callable[[], T], outcome: Future[T]) -> None:
    try:
        outcome.set_result(call())
    except BaseException as error:  # noqa: BLE001 - whoever waits raises it
        outcome.set_exception(error)
