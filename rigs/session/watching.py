"""Watching a session grow: opened again and again, until its writer has closed it or is gone."""

from __future__ import annotations

import time
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path

from rigs.errors import SessionError
from rigs.session.journal import is_being_recorded
from rigs.session.reader import Session

POLL_S = 0.5
QUIET_S = 3.0  # without a writer and without growth: some file systems know no locks
_PATIENCE_S, _PAUSE_S = 5.0, 0.1


class Growth(StrEnum):
    """Where a session stands."""

    GROWING = "growing"
    CLOSED = "closed"
    CUT_OFF = "cut off"


def watch(path: Path, poll_s: float = POLL_S) -> Iterator[tuple[Session, Growth]]:
    """Open a session as it grows, and a last time when it no longer does; each is good until the next is asked for.

    Raises
    ------
    SessionError
        Missing, or damaged.
    """
    state, since_s = (-1, -1), time.monotonic()
    while True:
        recorded = is_being_recorded(path)  # asked first: a session that is then still open has lost its writer
        with _opened(path) as session:
            if session.complete:
                yield session, Growth.CLOSED
                return
            now = (path.stat().st_size, session.n_samples)
            if recorded or now != state:
                state, since_s = now, time.monotonic()
            if time.monotonic() - since_s > QUIET_S:
                yield session, Growth.CUT_OFF
                return
            yield session, Growth.GROWING
        time.sleep(poll_s)


def _opened(path: Path) -> Session:
    """Open a session, again where its writer was in the middle of a change."""
    until_s = time.monotonic() + _PATIENCE_S
    while True:
        try:
            return Session.open(path)
        except SessionError:
            if not path.exists() or time.monotonic() > until_s:
                raise
        time.sleep(_PAUSE_S if is_being_recorded(path) else _PATIENCE_S / 10)
