"""Linear algebra on one thread.

The solve multiplies many small matrices. A library that shares each of them out among the cores spends its time waiting
for the slowest, on a busy machine ten times as long as the products take.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

P = ParamSpec("P")
R = TypeVar("R")


def on_one_thread(action: Callable[P, R]) -> Callable[P, R]:
    """Return the function, its linear algebra on one thread while it runs."""

    @wraps(action)
    def alone(*args: P.args, **kwargs: P.kwargs) -> R:
        with threadpool_limits(limits=1, user_api="blas"):
            return action(*args, **kwargs)

    return alone
