"""The journal: beside a session that is being recorded, all it takes to find everything again without HDF5's index.

HDF5 changes its index in place, so a crash can tear it. The journal is only ever added to, each record with a checksum.
"""

from __future__ import annotations

import json
import os
import struct
import sys
import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from rigs.session import layout

if sys.platform != "win32":  # which has no such locks, so nothing tells a living writer from a killed one
    import fcntl

Arrays = dict[str, NDArray[Any]]
_FRAME = struct.Struct("<4sII")  # magic, bytes, CRC-32 of what follows
_MAGIC = b"RIGJ"
_MAX_RECORD_BYTES = 2**28


def journal_path(session: Path) -> Path:
    """Return where the journal of a session file is: beside the file itself, where `session` is a link to it."""
    session = session.resolve() if session.is_symlink() else session
    return session.with_name(f"{session.name}.journal")


def chunk_rows_name(stream: str) -> str:
    """Return the name in the header under which the rows per chunk of a stream stand."""
    return f"{stream}/chunk_rows"


def record(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return the bytes of one record."""
    described = [[name, "" if array.dtype.names else array.dtype.str, array.shape] for name, array in arrays.items()]
    head = json.dumps(described).encode()
    content = b"".join(np.ascontiguousarray(array).tobytes() for array in arrays.values())
    payload = len(head).to_bytes(4, "little") + head + content
    return _FRAME.pack(_MAGIC, len(payload), zlib.crc32(payload)) + payload


def create_journal(path: Path, header: Mapping[str, NDArray[Any]]) -> BinaryIO:
    """Begin a journal, locked for as long as it is open, and see it onto the disk.

    Raises
    ------
    OSError
        There is one already, or it cannot be written.
    """
    stream = path.open("xb", buffering=0)
    try:
        if sys.platform != "win32":
            with suppress(OSError):  # some network file systems know no locks
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        stream.write(record(header))
        os.fsync(stream.fileno())
    except BaseException:
        stream.close()
        path.unlink(missing_ok=True)
        raise
    return stream


def is_being_recorded(session: Path) -> bool:
    """Tell whether a living program holds the journal of a session file."""
    if sys.platform == "win32":
        return False
    with suppress(FileNotFoundError), journal_path(session).open("rb") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            return False
    return False


@dataclass
class Journal:
    """What a journal says.

    Parameters
    ----------
    header : dict of str to array
        What does not grow.
    tables : dict of str to structured array
        Every table, as far as it reached the disk.
    chunks : dict of str to (n,) int64 array
        Where in the session file each chunk of a stream begins.
    """

    header: Arrays
    tables: dict[str, NDArray[np.void]] = field(default_factory=dict)
    chunks: dict[str, NDArray[np.int64]] = field(default_factory=dict)

    def text(self, name: str) -> str:
        """Return a text of the header."""
        return self.header[name].tobytes().decode(errors="replace")

    def chunk_rows(self, stream: str) -> int:
        """Return how many rows of a stream a chunk holds."""
        return int(self.header[chunk_rows_name(stream)][0])


def read_journal(path: Path) -> Journal | None:
    """Read a journal as far as it is whole; None where there is none, or not even its header is whole."""
    try:
        with path.open("rb") as stream:
            records = list(_records(stream))
    except OSError:
        return None
    needed = {"file_id", chunk_rows_name(layout.TIME_DATA), chunk_rows_name(layout.CAMERA_STREAM)}
    if not records or not needed <= records[0].keys():
        return None
    tables: dict[str, list[NDArray[Any]]] = {name: [np.empty(0, dtype)] for name, dtype in layout.TABLES.items()}
    chunks: dict[str, list[NDArray[Any]]] = {
        name: [np.empty(0, np.int64)] for name in (layout.TIME_DATA, layout.CAMERA_STREAM)
    }
    for each in records[1:]:
        for parts in (tables, chunks):
            for name, arrays in parts.items():
                if name in each and each[name].dtype == arrays[0].dtype and each[name].ndim == 1:
                    arrays.append(each[name])
    return Journal(
        records[0],
        {name: np.concatenate(rows) for name, rows in tables.items()},
        {name: np.concatenate(places) for name, places in chunks.items()},
    )


def _records(stream: BinaryIO) -> Iterator[Arrays]:
    while len(head := stream.read(_FRAME.size)) == _FRAME.size:
        magic, n_bytes, crc32 = _FRAME.unpack(head)
        if magic != _MAGIC or n_bytes > _MAX_RECORD_BYTES:
            return
        payload = stream.read(n_bytes)
        if len(payload) != n_bytes or zlib.crc32(payload) != crc32:
            return
        try:
            arrays = _arrays(payload)
        except (ValueError, TypeError, KeyError):  # foreign, whatever its checksum
            return
        yield arrays


def _arrays(payload: bytes) -> Arrays:
    """Return the arrays of a record; those of records ("") have the dtype of the table of their name."""
    place = 4 + int.from_bytes(payload[:4], "little")
    arrays = {}
    for name, kind, shape in json.loads(payload[4:place]):
        dtype = np.dtype(kind) if kind else layout.TABLES[name]
        n = int(np.prod(shape, dtype=np.int64))
        arrays[name] = np.frombuffer(payload, dtype, n, place).reshape(shape)
        place += n * dtype.itemsize
    return arrays
