"""A wreck: what can still be read of a session that was cut off or damaged, from HDF5's index, the journal, or both."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

import h5py
import numpy as np
from numpy.typing import NDArray

from rigs.description import RigDescription
from rigs.errors import SessionError
from rigs.session import layers, layout
from rigs.session.checksums import misfits
from rigs.session.container import Container, reading
from rigs.session.journal import Journal, is_being_recorded, journal_path, read_journal
from rigs.session.layers import Header
from rigs.session.validation import Judge, Table

_T = TypeVar("_T")
_MAX_PIECE_BYTES = 2**28  # no block of audio and no picture is larger
_STREAMS: dict[str, tuple[str, tuple[int | None, ...]]] = {
    layout.TIME_DATA: ("<f4", (None, None)),
    layout.CAMERA_STREAM: ("u1", (None,)),
}


@dataclass(frozen=True)
class Layers:
    """What a session was made with, as far as it is known, and its rig description, parsed."""

    header: Header
    description: RigDescription


class Wreck:
    """A session file in whatever state, open for reading; make one with `open`.

    Attributes
    ----------
    header : Header
        As the file was made.
    description : RigDescription
    tables : dict of str to structured array
        Every table, by its name in `rigs.session.layout`; whether its sound and pictures are good, `samples` and
        `png` tell.
    remarks : list of str
        What is missing.
    """

    def __init__(self, path: Path, container: Container | None, journal: Journal | None, known: Layers) -> None:
        self.path, self.header, self.description = path, known.header, known.description
        self.remarks: list[str] = []
        self._container, self._journal = container, journal
        self.n_channels = len(self.description.audio.recorded_channels())
        self._streams = {name: self._stream(name) for name in _STREAMS}
        if container is not None:
            with suppress(SessionError):
                self.remarks += misfits(container)
        self._read_tables(Judge(str(path), complete=False, remarks=self.remarks))

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a session file, however damaged; it is not changed.

        Raises
        ------
        SessionError
            Foreign, still being recorded, or so damaged that not even its rig description is known.
        """
        if path.is_dir():
            raise SessionError(f"{path}: a folder: name a session file, such as s1.h5")
        if is_being_recorded(path):
            raise SessionError(f"{path}: another program still records into it: wait until that has ended")
        journal, container = read_journal(journal_path(path)), None
        try:
            container = Container.open_damaged(path)
            journal = _matching(journal, container)
            known = _layers(container)
        except SessionError as error:
            if journal is None:
                if container is not None:
                    container.close()
                raise SessionError(f"{error}; and no journal is beside it, so nothing can be recovered") from error
            known = _layers_of_journal(journal, path)
        return cls(path, container, journal, known)

    def samples(self, block: np.void) -> NDArray[np.float32] | None:
        """Return the samples (n, n_channels) of a block; None where they are damaged or lost."""
        return self._piece(layout.TIME_DATA, int(block["first_sample"]), int(block["n_samples"]), int(block["crc32"]))

    def png(self, frame: np.void) -> NDArray[np.uint8] | None:
        """Return the PNG bytes (n,) of a frame; None where they are damaged or lost."""
        return self._piece(layout.CAMERA_STREAM, int(frame["offset"]), int(frame["length"]), int(frame["crc32"]))

    def close(self) -> None:
        """Let the file go; safe to call twice."""
        if self._container is not None:
            self._container.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self.close()

    def _read_tables(self, judge: Judge) -> None:
        self.tables = {name: self._table(name) for name in layout.TABLES}
        blocks, frames = self.tables[layout.AUDIO_BLOCKS], self.tables[layout.CAMERA_FRAMES]
        row_bytes = 4 * self.n_channels
        blocks = judge.blocks(blocks, int(np.maximum(blocks["n_samples"], 0).sum(dtype=np.int64)))
        blocks = self._sane(layout.AUDIO_BLOCKS, blocks, blocks["n_samples"].astype(np.int64) * row_bytes)
        frames = judge.frames(self._sane(layout.CAMERA_FRAMES, frames, frames["length"]), 2**62)
        poses = judge.poses(self.tables[layout.POSES])
        emissions = judge.emissions(self.tables[layout.EMISSIONS], poses, self.description)
        log = self.tables[layout.LOG]
        self.tables |= {
            layout.AUDIO_BLOCKS: blocks,
            layout.CAMERA_FRAMES: frames,
            layout.POSES: poses,
            layout.EMISSIONS: emissions,
            layout.ONSETS: _as_long(self.tables[layout.ONSETS], len(emissions)),
            layout.LOG: log[log["level"] != b""],
        }

    def _table(self, name: str) -> Table:
        """Return the journal's rows and those that HDF5 has beyond; the journal's alone where the two disagree."""
        indexed = self._indexed_table(name)
        if self._journal is None:
            return indexed
        kept = self._journal.tables[name]
        agree = len(indexed) >= len(kept) and indexed[: len(kept)].tobytes() == kept.tobytes()
        return indexed if agree else kept

    def _indexed_table(self, name: str) -> Table:
        """Return what HDF5 can read of a table: its rows up to the first damaged chunk."""
        rows = np.empty(0, layout.TABLES[name])
        if self._container is None or (name in layout.OPTIONAL_TABLES and name not in self._container):
            return rows
        try:
            dataset = self._container.dataset(name, layout.TABLES[name], (None,))
            step = dataset.chunks[0] if dataset.chunks else max(len(dataset), 1)
            for first in range(0, len(dataset), step):
                with reading(self.path):
                    rows = np.concatenate([rows, dataset[first : first + step]])
        except SessionError:
            if self._journal is None:
                self.remarks.append(f"{name} is damaged: {len(rows)} of its rows are readable")
        return rows

    def _sane(self, name: str, rows: Table, n_bytes: NDArray[np.int64]) -> Table:
        """Return the rows before the first that points to nothing, or to more than there ever is."""
        bad = np.flatnonzero((n_bytes <= 0) | (n_bytes > _MAX_PIECE_BYTES))
        if not len(bad):
            return rows
        self.remarks.append(f"{name} is damaged: {bad[0]} of its {len(rows)} rows make sense")
        return rows[: bad[0]]

    def _stream(self, name: str) -> h5py.Dataset | None:
        if self._container is None:
            return None
        with suppress(SessionError):
            return self._container.dataset(name, *_STREAMS[name])
        return None

    def _piece(self, stream: str, first: int, n: int, crc32: int) -> NDArray[Any] | None:
        """Return rows of a stream, found by HDF5's index or by the journal, whichever fits the checksum."""
        for read in (self._indexed, self._journalled):
            rows = read(stream, first, n)
            if rows is not None and len(rows) == n and zlib.crc32(np.ascontiguousarray(rows).data) == crc32:
                return rows
        return None

    def _indexed(self, name: str, first: int, n: int) -> NDArray[Any] | None:
        dataset = self._streams[name]
        if dataset is None or first + n > len(dataset):
            return None
        with suppress(SessionError), reading(self.path):
            return np.asarray(dataset[first : first + n])
        return None

    def _journalled(self, name: str, first: int, n: int) -> NDArray[Any] | None:
        if self._journal is None:
            return None
        dtype, row_shape = np.dtype(_STREAMS[name][0]), (self.n_channels,) if name == layout.TIME_DATA else ()
        row_bytes = dtype.itemsize * int(np.prod(row_shape, dtype=int))
        chunk_rows, places = self._journal.chunk_rows(name), self._journal.chunks[name]
        content = bytearray()
        with suppress(OSError), self.path.open("rb") as file:
            while n > 0 and first // chunk_rows < len(places):
                chunk, row = divmod(first, chunk_rows)
                n_here = min(n, chunk_rows - row)
                file.seek(int(places[chunk]) + row * row_bytes)
                content += file.read(n_here * row_bytes)
                first, n = first + n_here, n - n_here
        if n or len(content) % row_bytes:
            return None
        return np.frombuffer(bytes(content), dtype).reshape(-1, *row_shape)


def _matching(journal: Journal | None, container: Container) -> Journal | None:
    """Return the journal if it is this file's; one that was left by another is none."""
    file_id = None
    with suppress(SessionError):
        file_id = container.attribute("/", "file_id")
    return journal if journal and file_id in (None, journal.text("file_id")) else None


def _layers(container: Container) -> Layers:
    name, created_utc = layers.read_identity(container)
    text, _ = layers.read_description(container)
    description = layers.parse(text, container.path)
    channels = description.audio.recorded_channels()
    judge = Judge(str(container.path), complete=False)
    rate_hz = judge.sample_rate(_or_none(lambda: container.attribute(layout.TIME_DATA, "sample_freq")), description)
    header = Header(
        name,
        text,
        _or_none(lambda: layers.read_versions(container)) or {},
        rate_hz,
        _or_none(lambda: layers.read_truth(container, description)),
        _or_none(lambda: layers.read_corners(container, description, None, judge)),
        _or_none(lambda: layers.read_tdoas(container, channels, None, judge)),
        created_utc,
        file_id=str(container.attribute("/", "file_id") or ""),
    )
    return Layers(header, description)


def _layers_of_journal(journal: Journal, path: Path) -> Layers:
    try:
        header = layers.header_from_journal(journal.header)
    except (KeyError, ValueError, TypeError) as error:
        raise SessionError(f"{journal_path(path)}: not the journal of a session") from error
    return Layers(header, layers.parse(header.description_text, path))


def _or_none(read: Callable[[], _T]) -> _T | None:
    try:
        return read()
    except SessionError:
        return None


def _as_long(onsets: Table, n_emissions: int) -> Table:
    """Return a row per emission: those beyond are left out, missing ones are not numbers."""
    missing = np.full(max(n_emissions - len(onsets), 0), np.nan, dtype=onsets.dtype)
    return np.concatenate([onsets[:n_emissions], missing])
