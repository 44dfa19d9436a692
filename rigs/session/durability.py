"""Durability: what was flushed is brought onto the disk by a thread of its own, so that a slow disk holds up nobody."""

from __future__ import annotations

import os
import time
from threading import Condition, Thread
from typing import BinaryIO

SYNC_INTERVAL_S = 0.4  # with the writer's interval between flushes, and 0.12 s for each of two syncs, under 1 s
_sync = getattr(os, "fdatasync", os.fsync)  # macOS and Windows have fsync only


class Durability:
    """Writes the journal, and syncs session file and journal, in this order, at most every `SYNC_INTERVAL_S`.

    A journal that is ahead of the session file does no harm: what it speaks of has checksums.

    Parameters
    ----------
    file_descriptor : int
        Of the session file, as HDF5 writes it; a duplicate is kept, so that it may be closed.
    journal : file
        Open for writing, unbuffered; closed in the end.
    """

    def __init__(self, file_descriptor: int, journal: BinaryIO) -> None:
        self._file = os.dup(file_descriptor)
        self._journal = journal
        self._is_behind = self._is_syncing = self._closing = False
        self._failure: OSError | None = None
        self._changed = Condition()
        self._thread = Thread(target=self._run, name="session sync", daemon=True)
        self._thread.start()

    def submit(self, record: bytes) -> None:
        """Write the journal's record of what was just flushed, to be synced soon.

        Raises
        ------
        OSError
            The disk refused before.
        """
        with self._changed:
            if self._failure is not None:
                raise self._failure
        rest = memoryview(record)
        while rest:
            rest = rest[os.write(self._journal.fileno(), rest) :]
        with self._changed:
            self._is_behind = True
            self._changed.notify_all()

    def settle(self) -> None:
        """Wait until all that was submitted is on the disk. Raises OSError where the disk refused."""
        with self._changed:
            self._changed.wait_for(lambda: self._failure or not (self._is_behind or self._is_syncing))
            if self._failure is not None:
                raise self._failure

    def finish(self) -> None:
        """Wait until everything is on the disk; the session file may still change, and `close` syncs it once more.

        Raises
        ------
        OSError
            The disk refused.
        """
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join()
        if self._failure is not None:
            raise self._failure

    def close(self) -> None:
        """Bring the session file onto the disk as it now is, and let both files go; safe to call twice.

        Raises
        ------
        OSError
            The disk refused.
        """
        try:
            self.finish()
            if not self._journal.closed:
                os.fsync(self._file)
        finally:
            if not self._journal.closed:
                os.close(self._file)
                self._journal.close()

    def _run(self) -> None:
        while self._has_more():
            began_s = time.monotonic()
            try:
                _sync(self._file)
                _sync(self._journal.fileno())
            except OSError as error:
                with self._changed:
                    self._failure = error
                    self._changed.notify_all()
                return
            with self._changed:
                self._is_syncing = False
                self._changed.notify_all()
            self._pause(SYNC_INTERVAL_S - (time.monotonic() - began_s))

    def _has_more(self) -> bool:
        """Wait until there is something to sync; False when there is nothing and there never will be."""
        with self._changed:
            self._changed.wait_for(lambda: self._is_behind or self._closing)
            self._is_syncing, self._is_behind = self._is_behind, False
            return self._is_syncing

    def _pause(self, duration_s: float) -> None:
        with self._changed:
            self._changed.wait_for(lambda: self._closing, timeout=max(duration_s, 0.0))
