"""A container: an HDF5 file that nobody vouches for, of which only plain datasets behind hard links are ever read."""

from __future__ import annotations

import ctypes
import math
import os
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Self

import h5py
import numpy as np
from numpy.typing import DTypeLike, NDArray

from rigs.errors import DamagedSessionError, SessionError, reason
from rigs.session.damaged import DamagedFile

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_WRITE_FLAGS = 0b101  # superblock 3: open for writing, open for SWMR writing
_READ_ATTEMPTS = 25  # HDF5 waits twice as long after each, from 1 ns on: 30 ms; its default of 100 hangs on damage
_MAX_OBJECTS = 1000
_MAX_CHUNK_BYTES = 2**24
_MAX_READ_BYTES = 2**30
_MAX_TEXT_BYTES = 4096


class Container:
    """A checked HDF5 file; make one with `open`.

    Links that are not hard links, virtual datasets, external storage, filters, object types and sizes that the file
    cannot hold are refused wherever they are, before anything behind them is touched.
    """

    def __init__(self, file: h5py.File, path: Path, n_bytes: Callable[[], int]) -> None:
        self.path = path
        self._file = file
        self._datasets = dict(_datasets(file, path, n_bytes))

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a file for reading.

        Raises
        ------
        SessionError
            Missing, empty, not HDF5, damaged, or with content that is never followed.
        """
        growing = _is_growing(path)
        try:
            file = _open_growing(path) if growing else h5py.File(path, "r")
        except (OSError, RuntimeError, ValueError) as error:
            raise DamagedSessionError(
                f"{path}: HDF5 cannot open it, it is damaged or cut short ({reason(error)})"
            ) from error
        return cls._checked(file, path, lambda: path.stat().st_size)

    @classmethod
    def open_damaged(cls, path: Path) -> Self:
        """Open a file that `open` may refuse: cut off, or left as its killed writer left it.

        Raises
        ------
        SessionError
            Missing, empty, not HDF5, or so damaged that not even its names can be read.
        """
        _is_growing(path)
        try:
            view = DamagedFile(path)
            file = h5py.File(view, "r")
        except (OSError, RuntimeError, ValueError) as error:
            raise SessionError(f"{path}: HDF5 cannot open it, not even in part ({reason(error)})") from error
        return cls._checked(file, path, lambda: view.most_bytes)

    @classmethod
    def _checked(cls, file: h5py.File, path: Path, n_bytes: Callable[[], int]) -> Self:
        try:
            with reading(path):
                return cls(file, path, n_bytes)
        except BaseException:
            file.close()
            raise

    def close(self) -> None:
        """Let the file go; safe to call twice."""
        self._file.close()

    def __contains__(self, name: str) -> bool:
        return name in self._datasets

    def dataset(self, name: str, dtype: DTypeLike, shape: tuple[int | None, ...]) -> h5py.Dataset:
        """Return a dataset of this type and shape (None: any length).

        Raises
        ------
        SessionError
            Missing, or of another type or shape.
        """
        if name not in self._datasets:
            raise DamagedSessionError(
                f"{self.path}: the dataset {name} is missing: not a session file, or a damaged one"
            )
        dataset = self._datasets[name]
        if dataset.dtype != np.dtype(dtype):
            raise SessionError(f"{self.path}: {name} is of type {_short(dataset.dtype)}, not {_short(np.dtype(dtype))}")
        fits = len(dataset.shape) == len(shape) and all(
            wanted in (None, found) for wanted, found in zip(shape, dataset.shape, strict=True)
        )
        if not fits:
            wanted = ", ".join("any" if length is None else str(length) for length in shape)
            raise SessionError(f"{self.path}: {name} is of shape {dataset.shape}, not ({wanted})")
        return dataset

    def read(self, name: str, dtype: DTypeLike, shape: tuple[int | None, ...]) -> NDArray[Any]:
        """Return the whole content of such a dataset; raises SessionError as `dataset` does."""
        dataset = self.dataset(name, dtype, shape)
        if math.prod(dataset.shape) * dataset.dtype.itemsize > _MAX_READ_BYTES:
            raise SessionError(f"{self.path}: {name} is larger than 1 GiB, which no session needs")
        with reading(self.path):
            return np.asarray(dataset[()])

    def crc32(self, name: str) -> int:
        """Return the CRC-32 of all bytes of a dataset; raises SessionError as `read` does."""
        dataset = self._datasets[name]
        return zlib.crc32(self.read(name, dataset.dtype, dataset.shape).tobytes())

    def attribute(self, owner: str, name: str) -> str | float | int | None:
        """Return a scalar attribute (text or number) of the root "/", a group or a dataset; None where there is none.

        Raises
        ------
        SessionError
            Not a scalar, or neither text of fixed length nor a number.
        """
        with reading(self.path):
            attributes = self._file[owner].attrs
            if name not in attributes:
                return None
            kind = attributes.get_id(name)
            if kind.shape != () or kind.dtype.kind not in "Siuf" or kind.dtype.itemsize > _MAX_TEXT_BYTES:
                raise SessionError(f"{self.path}: the attribute {name} of {owner} is neither short text nor a number")
            value = attributes[name]
            return bytes(value).decode(errors="replace") if kind.dtype.kind == "S" else value.item()


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn whatever HDF5 says about a damaged file into a SessionError."""
    try:
        yield
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError) as error:
        raise DamagedSessionError(f"{path}: damaged or cut short, it cannot be read ({reason(error)})") from error


def _is_growing(path: Path) -> bool:
    """Look at the first bytes: is this HDF5, and still marked as being written? Then only SWMR mode opens it."""
    if not path.exists():
        raise SessionError(f"{path}: no such file: name a session file, such as s1.h5")
    if not path.is_file():
        raise SessionError(f"{path}: not a file: name a session file, such as s1.h5")
    try:
        with path.open("rb") as stream:
            head = stream.read(12)
    except OSError as error:
        raise SessionError(f"{path}: cannot be read ({reason(error)})") from error
    if not head:
        raise SessionError(f"{path}: empty (0 bytes): the recording never began, or the copy failed")
    if len(head) < 12 or head[:8] != _SIGNATURE:
        raise SessionError(f"{path}: not an HDF5 file, so not a session: name a file of rig-capture")
    return head[8] == 3 and bool(head[11] & _WRITE_FLAGS)


def _open_growing(path: Path) -> h5py.File:
    access = h5py.h5p.create(h5py.h5p.FILE_ACCESS)
    with suppress(OSError, AttributeError):  # h5py lacks this call; it links the library that has it
        set_attempts = ctypes.CDLL(h5py.h5p.__file__).H5Pset_metadata_read_attempts
        set_attempts(ctypes.c_int64(access.id), ctypes.c_uint(_READ_ATTEMPTS))
    return h5py.File(h5py.h5f.open(os.fsencode(path), h5py.h5f.ACC_RDONLY | h5py.h5f.ACC_SWMR_READ, access))


def _datasets(file: h5py.File, path: Path, n_bytes: Callable[[], int]) -> Iterator[tuple[str, h5py.Dataset]]:
    pending = [("", file)]
    n_objects = 0
    while pending:
        prefix, group = pending.pop()
        for name in group:
            n_objects += 1
            if n_objects > _MAX_OBJECTS:  # hard links may form a ring
                raise SessionError(f"{path}: holds more than {_MAX_OBJECTS} objects, so not a session")
            _refuse_link(group, name, f"{path}: {prefix + name!r}")
            item = group[name]
            if isinstance(item, h5py.Group):
                pending.append((f"{prefix}{name}/", item))
            elif isinstance(item, h5py.Dataset):
                _refuse_unusual(item, f"{path}: {prefix + name!r}", n_bytes)
                yield f"{prefix}{name}", item


def _refuse_link(group: h5py.Group, name: str, where: str) -> None:
    encoded = name.encode("utf-8", "surrogateescape")
    if group.id.links.get_info(encoded).type != h5py.h5l.TYPE_HARD:
        raise SessionError(f"{where} is a soft or external link, which a session never has; not followed")


def _refuse_unusual(dataset: h5py.Dataset, where: str, n_bytes: Callable[[], int]) -> None:
    storage = dataset.id.get_create_plist()
    if storage.get_layout() == h5py.h5d.VIRTUAL or storage.get_external_count():
        raise SessionError(f"{where} keeps its content in other files, which a session never does; not followed")
    if storage.get_nfilters():
        raise SessionError(f"{where} is filtered or compressed, which a session never is")
    if dataset.dtype.hasobject:
        raise SessionError(f"{where} holds objects of variable length, which a session never does; not read")
    shape, file_bytes = dataset.shape, n_bytes()  # in this order: the file may be growing
    if shape is None or math.prod(shape) * dataset.dtype.itemsize > file_bytes:
        raise DamagedSessionError(f"{where} claims the shape {shape}, more than a file of {file_bytes} bytes can hold")
    if dataset.chunks and math.prod(dataset.chunks) * dataset.dtype.itemsize > _MAX_CHUNK_BYTES:
        raise SessionError(f"{where} is in chunks of {dataset.chunks}, larger than any session has")


def _short(dtype: np.dtype[Any]) -> str:
    return f"a record of ({', '.join(dtype.names)})" if dtype.names else str(dtype)
