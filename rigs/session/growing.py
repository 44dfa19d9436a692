"""A growing dataset: rows are appended, and are safe from a crash once flushed."""

from __future__ import annotations

import zlib
from typing import Any

import h5py
import numpy as np
from numpy.typing import DTypeLike, NDArray

_TABLE_CHUNK_BYTES = 2**14
_STREAM_CHUNK_BYTES = 2**18


class GrowingStream:
    """A long dataset whose rows go straight to HDF5, which gathers them into chunks.

    Parameters
    ----------
    file : h5py.File
        Not in SWMR mode yet.
    name : str
        Of the dataset that is made.
    dtype : numpy dtype
    row_shape : tuple of int
        Shape of one row.
    """

    def __init__(self, file: h5py.File, name: str, dtype: DTypeLike, row_shape: tuple[int, ...] = ()) -> None:
        self.name = name
        self.dataset = _create(file, name, np.dtype(dtype), row_shape, _STREAM_CHUNK_BYTES)
        self.n_rows = 0
        self.chunk_rows: int = self.dataset.chunks[0]
        self._n_located = 0

    def append(self, rows: NDArray[Any]) -> int:
        """Append rows (n, *row_shape) and return the index of the first."""
        first = self.n_rows
        self.dataset.resize(first + len(rows), axis=0)
        self.dataset[first:] = rows
        self.n_rows = first + len(rows)
        return first

    def flush(self) -> NDArray[np.int64]:
        """Hand all rows to the operating system, and return where in the file the new chunks (n,) begin."""
        self.dataset.flush()
        n_chunks = -(-self.n_rows // self.chunk_rows)
        rest = (0,) * (self.dataset.ndim - 1)
        places = [
            self.dataset.id.get_chunk_info_by_coord((chunk * self.chunk_rows, *rest)).byte_offset
            for chunk in range(self._n_located, n_chunks)
        ]
        self._n_located = n_chunks
        return np.array(places, dtype=np.int64)


class GrowingTable:
    """A dataset of records, kept in memory until flushed: a record never reaches the file before what it points to.

    Parameters
    ----------
    file : h5py.File
        Not in SWMR mode yet.
    name : str
        Of the dataset that is made.
    dtype : numpy dtype
        Of a record.
    """

    def __init__(self, file: h5py.File, name: str, dtype: np.dtype[np.void]) -> None:
        self.name = name
        self._dataset = _create(file, name, dtype, (), _TABLE_CHUNK_BYTES)
        self._dtype = dtype
        self._pending: list[NDArray[np.void]] = []
        self.n_rows = self.crc32 = 0  # the checksum is that of what was flushed

    def append(self, *fields: object) -> int:
        """Append one record, its fields in the order of the dtype, and return its index."""
        self._pending.append(np.array([fields], dtype=self._dtype))
        self.n_rows += 1
        return self.n_rows - 1

    def extend(self, rows: NDArray[np.void]) -> None:
        """Append records (n,) as they are."""
        if len(rows):
            self._pending.append(rows)
            self.n_rows += len(rows)

    def flush(self) -> NDArray[np.void]:
        """Write the records that wait, hand them to the operating system, and return them."""
        if not self._pending:
            return np.empty(0, dtype=self._dtype)
        rows = np.concatenate(self._pending)
        self._dataset.resize(self.n_rows, axis=0)
        self._dataset[self.n_rows - len(rows) :] = rows
        self._dataset.flush()
        self._pending.clear()
        self.crc32 = zlib.crc32(rows.tobytes(), self.crc32)
        return rows


def _create(
    file: h5py.File, name: str, dtype: np.dtype[Any], row_shape: tuple[int, ...], chunk_bytes: int
) -> h5py.Dataset:
    row_bytes = dtype.itemsize * int(np.prod(row_shape, dtype=int))
    rows = max(1, chunk_bytes // row_bytes)
    return file.create_dataset(
        name, shape=(0, *row_shape), maxshape=(None, *row_shape), chunks=(rows, *row_shape), dtype=dtype
    )
