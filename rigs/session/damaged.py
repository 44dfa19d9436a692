"""A damaged file as HDF5 will open it: marked as closed, and as long as it says it is, with zeros where it was cut off.

Nothing is changed on the disk; what `h5clear` would write is only pretended.
"""

from __future__ import annotations

import io
import os
import struct
from pathlib import Path

_SUPERBLOCK = struct.Struct("<8sBBBBQQQQI")  # version 2 and 3, with addresses of 8 bytes
_MASK = 0xFFFFFFFF
_MAX_STRETCH = 1000  # a file that claims to be longer than this many times its size is not believed


class DamagedFile(io.RawIOBase):
    """Reads a damaged HDF5 file; hand it to `h5py.File`.

    Parameters
    ----------
    path : Path

    Attributes
    ----------
    n_bytes : int
        As long as the file pretends to be.
    most_bytes : int
        What it can have held before it was cut off, at most.
    """

    def __init__(self, path: Path) -> None:
        self._stream = path.open("rb")
        self._n_real = os.fstat(self._stream.fileno()).st_size
        self._head, claimed = _repaired(self._stream.read(_SUPERBLOCK.size), self._n_real)
        self.n_bytes = max(claimed, self._n_real)
        self.most_bytes = _MAX_STRETCH * self._n_real
        self._place = 0

    def readable(self) -> bool:
        """Return True."""
        return True

    def seekable(self) -> bool:
        """Return True."""
        return True

    def tell(self) -> int:
        """Return the place of the next read."""
        return self._place

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move the place of the next read."""
        self._place = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._place, os.SEEK_END: self.n_bytes}[whence]
        return self._place

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        """Fill the whole buffer, with zeros where the file holds nothing."""
        view = memoryview(buffer).cast("B")
        self._stream.seek(self._place)
        n_read: int = self._stream.readinto(view)
        view[n_read:] = bytes(len(view) - n_read)
        if self._place < len(self._head):
            patch = self._head[self._place : self._place + len(view)]
            view[: len(patch)] = patch
        self._place += len(view)
        return len(view)

    def close(self) -> None:
        """Let the file go; safe to call twice."""
        self._stream.close()
        super().close()


def _repaired(head: bytes, n_real: int) -> tuple[bytes, int]:
    """Return the superblock without its marks of being written, and the file's length as it says."""
    if len(head) < _SUPERBLOCK.size:
        return head, 0
    signature, version, n_offset, n_length, _, base, extension, end, root, _ = _SUPERBLOCK.unpack(head)
    if version not in (2, 3) or (n_offset, n_length) != (8, 8):
        return head, 0
    end = end if n_real <= end <= _MAX_STRETCH * n_real else n_real
    fields = _SUPERBLOCK.pack(signature, version, n_offset, n_length, 0, base, extension, end, root, 0)[:-4]
    return fields + lookup3(fields).to_bytes(4, "little"), end


def lookup3(content: bytes) -> int:
    """Return the checksum of HDF5's metadata (Bob Jenkins' lookup3, public domain, with zero to begin with)."""
    a = b = c = (0xDEADBEEF + len(content)) & _MASK
    n_whole = max(-(-len(content) // 12) - 1, 0) * 12
    for x, y, z in struct.iter_unpack("<III", content[:n_whole]):
        a, b, c = _mixed((a + x) & _MASK, (b + y) & _MASK, (c + z) & _MASK)
    last: tuple[int, int, int] = struct.unpack("<III", content[n_whole:].ljust(12, b"\0"))
    a, b, c = (a + last[0]) & _MASK, (b + last[1]) & _MASK, (c + last[2]) & _MASK
    c = ((c ^ b) - _turned(b, 14)) & _MASK
    a = ((a ^ c) - _turned(c, 11)) & _MASK
    b = ((b ^ a) - _turned(a, 25)) & _MASK
    c = ((c ^ b) - _turned(b, 16)) & _MASK
    a = ((a ^ c) - _turned(c, 4)) & _MASK
    b = ((b ^ a) - _turned(a, 14)) & _MASK
    return ((c ^ b) - _turned(b, 24)) & _MASK


def _mixed(a: int, b: int, c: int) -> tuple[int, int, int]:
    for bits in (4, 6, 8, 16, 19, 4):
        a = ((a - c) & _MASK) ^ _turned(c, bits)
        c = (c + b) & _MASK
        a, b, c = b, c, a
    return a, b, c


def _turned(value: int, bits: int) -> int:
    return ((value << bits) | (value >> (32 - bits))) & _MASK
