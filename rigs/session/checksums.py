"""Checksums of the tables and of what does not grow: made when a session is closed, compared when it is verified."""

from __future__ import annotations

import zlib
from collections.abc import Iterable

import h5py
import numpy as np

from rigs.session import layout
from rigs.session.container import Container
from rigs.session.growing import GrowingTable

_UNKNOWN = -1


class Checksums:
    """The dataset of checksums in a file that is being written.

    Parameters
    ----------
    file : h5py.File
        Not in SWMR mode yet; every dataset that does not grow is in it.
    fixed : iterable of str
        The names of those.
    """

    def __init__(self, file: h5py.File, fixed: Iterable[str]) -> None:
        rows = [(name.encode(), len(file[name]), zlib.crc32(file[name][()].tobytes())) for name in fixed]
        rows += [(name.encode(), _UNKNOWN, 0) for name in layout.TABLES]
        self._rows = np.array(rows, dtype=layout.CHECKSUM)
        self._dataset = file.create_dataset(layout.CHECKSUMS, data=self._rows)

    def finish(self, tables: Iterable[GrowingTable]) -> None:
        """Write the checksums of all that grew, which grows no more."""
        for table in tables:
            row = self._rows["name"] == table.name.encode()
            self._rows["n_rows"][row], self._rows["crc32"][row] = table.n_rows, table.crc32
        self._dataset[...] = self._rows


def misfits(container: Container) -> list[str]:
    """Say which tables and layers of a session do not fit their checksums; tables have one once it was closed."""
    if layout.CHECKSUMS not in container:
        return []
    rows = container.read(layout.CHECKSUMS, layout.CHECKSUM, (None,))
    bad = []
    for name, n_rows, crc32 in rows:
        known = name.decode(errors="replace")
        if n_rows != _UNKNOWN and (known not in container or container.crc32(known) != crc32):
            bad.append(f"{known} is damaged: its checksum does not fit")
    return bad
