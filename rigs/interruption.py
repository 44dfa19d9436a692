"""Ctrl-C that is not lost.

An exception out of a signal handler is lost where it strikes in a destructor or in a weak reference's callback, and
HDF5's objects have them by the thousand. So the handler only notes it, and the work asks between its steps.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def interrupted_between_steps() -> Iterator[Callable[[], None]]:
    """Hand out a function that raises KeyboardInterrupt if Ctrl-C was pressed; the second Ctrl-C does so at once.

    Where somebody else looks after signals, or in another thread, it changes nothing.
    """
    pressed = False

    def note(_number: int, _frame: FrameType | None) -> None:
        nonlocal pressed
        pressed = True
        signal.signal(signal.SIGINT, signal.default_int_handler)

    def check() -> None:
        if pressed:
            raise KeyboardInterrupt

    default = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if not (default and threading.current_thread() is threading.main_thread()):
        yield check
        return
    signal.signal(signal.SIGINT, note)
    try:
        yield check
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    check()
