"""The growing file: the HDF5 file of a session, laid out first, then only appended to, and its journal beside it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from rigs.errors import SessionError, SessionWriteError, TargetError, reason
from rigs.session import layers, layout
from rigs.session.checksums import Checksums
from rigs.session.durability import Durability
from rigs.session.growing import GrowingStream, GrowingTable
from rigs.session.journal import Arrays, chunk_rows_name, create_journal, journal_path, record
from rigs.session.layers import Header

_LIBVER = ("v110", "v110")  # the oldest that knows SWMR; PyTables and MATLAB cannot read "latest"


class GrowingFile:
    """Streams and tables that grow, in memory until flushed, and on the disk soon after that.

    Once the disk has refused, the file is closed as it was last flushed, and every later call says so.

    Parameters
    ----------
    path : Path
        What messages call the file.
    hidden : Path
        Where it is made.
    header : Header
    n_channels : int
        Columns of `time_data`.

    Raises
    ------
    TargetError, SessionWriteError
        It cannot be made, or not be written.
    """

    def __init__(self, path: Path, hidden: Path, header: Header, n_channels: int) -> None:
        self._path = path
        self._failure: SessionWriteError | None = None
        self._file = _create(path, hidden)
        try:
            with _writing(path):
                layers.write_header(self._file, header)
                self._lay_out(header, n_channels)
                self._durability = self._begin_to_grow(hidden, header)
        except BaseException:
            _abandon(self._file)
            raise

    @property
    def is_open(self) -> bool:
        """Whether anything can be added."""
        return bool(self._file)

    def n_rows(self, name: str) -> int:
        """Return how many rows of a stream or table were appended so far."""
        return (self._streams.get(name) or self._tables[name]).n_rows

    def append_rows(self, stream: str, rows: NDArray[Any]) -> int:
        """Append rows (n, ...) to a stream, and return the index of the first; raises SessionError."""
        with self._changing():
            return self._streams[stream].append(rows)

    def append_record(self, table: str, *fields: object) -> int:
        """Append a record to a table, its fields as in `layout`, and return its index; raises SessionError."""
        with self._changing():
            return self._tables[table].append(*fields)

    def extend(self, table: str, rows: NDArray[np.void]) -> None:
        """Append records (n,) to a table; raises SessionError."""
        with self._changing():
            self._tables[table].extend(rows)

    def flush(self) -> None:
        """Hand everything to the operating system, the journal's record last; raises SessionError."""
        with self._changing():
            news: Arrays = {name: stream.flush() for name, stream in self._streams.items()}
            news |= {name: table.flush() for name, table in self._tables.items()}
            if news := {name: rows for name, rows in news.items() if len(rows)}:
                self._durability.submit(record(news))

    def settle(self) -> None:
        """Wait until all that was flushed is on the disk; raises SessionError."""
        with self._changing():
            self._durability.settle()

    def close(self, state: int) -> None:
        """Flush, give every table its checksum, set the state, and close the file; raises SessionError."""
        self.flush()
        with self._changing():
            self._durability.finish()
            self._checksums.finish(self._tables.values())
            self._state[0] = state
            self._file.flush()
            self._file.close()
            self._durability.close()

    def let_go(self) -> None:
        """Close the file in whatever state; it is to be deleted."""
        with suppress(OSError, RuntimeError):
            self._file.close()
        with suppress(OSError):
            self._durability.close()

    def _lay_out(self, header: Header, n_channels: int) -> None:
        """Make every dataset: once the file grows, none can be made."""
        streams = (
            GrowingStream(self._file, layout.TIME_DATA, "<f4", (n_channels,)),
            GrowingStream(self._file, layout.CAMERA_STREAM, np.uint8),
        )
        self._streams = {stream.name: stream for stream in streams}
        self._tables = {name: GrowingTable(self._file, name, dtype) for name, dtype in layout.TABLES.items()}
        self._file[layout.TIME_DATA].attrs.create("sample_freq", float(header.sample_rate_hz))
        self._state = self._file.create_dataset(layout.STATE, data=np.array([layout.STATE_OPEN], dtype=np.uint8))
        self._checksums = Checksums(self._file, layers.fixed_names(header))

    def _begin_to_grow(self, hidden: Path, header: Header) -> Durability:
        """Turn to SWMR mode, see the empty session onto the disk, and begin its journal."""
        self._file.swmr_mode = True
        descriptor = self._file.id.get_vfd_handle()
        os.fsync(descriptor)
        places = {chunk_rows_name(name): np.array([stream.chunk_rows]) for name, stream in self._streams.items()}
        return Durability(descriptor, create_journal(journal_path(hidden), layers.journal_header(header) | places))

    @contextmanager
    def _changing(self) -> Iterator[None]:
        if self._failure is not None:
            raise self._failure
        if not self._file:
            raise SessionError(f"{self._path}: this session is closed; nothing can be added to it")
        try:
            with _writing(self._path):
                yield
        except SessionWriteError as failure:
            self._failure = failure
            _abandon(self._file)
            with suppress(OSError):
                self._durability.close()
            raise


def _create(path: Path, hidden: Path) -> h5py.File:
    try:
        return h5py.File(hidden, "x", libver=_LIBVER)
    except (OSError, ValueError) as error:
        raise TargetError(f"{path}: cannot be made ({reason(error)}): choose another folder") from error


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, RuntimeError) as error:
        raise SessionWriteError(
            f"{path}: cannot be written ({reason(error)}): free some space or use another disk; "
            "what was flushed before is kept"
        ) from error


def _abandon(file: h5py.File) -> None:
    """Leave the file on the disk as it was last flushed; HDF5 crashes when it cannot write what it still holds."""
    with suppress(OSError, RuntimeError, ValueError):
        nowhere = os.open(os.devnull, os.O_RDWR)
        os.dup2(nowhere, file.id.get_vfd_handle())
        os.close(nowhere)
        file.close()
