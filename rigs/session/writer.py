"""The writer of a session file: everything is laid out first, then appended to in SWMR mode."""

from __future__ import annotations

import math
import os
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Self

import h5py
import numpy as np
from numpy.typing import NDArray

from rigs.errors import SessionError, SessionWriteError, TargetError, reason
from rigs.session import layers, layout, picture, publication
from rigs.session.checksums import Checksums
from rigs.session.durability import Durability
from rigs.session.growing import GrowingStream, GrowingTable
from rigs.session.journal import Arrays, chunk_rows_name, create_journal, journal_path, record
from rigs.session.layers import Header
from rigs.session.layout import MeasuredTdoas, Truth

_LIBVER = ("v110", "v110")  # the oldest that knows SWMR; PyTables and MATLAB cannot read "latest"
_FLUSH_INTERVAL_S = 0.25


class SessionWriter:
    """Appends a recording to a new session file; make one with `create`, use it from one thread.

    Whatever was flushed survives a crash of this program, and a second later a power loss too: a thread syncs the file
    and a journal beside it. The writer flushes by itself after every quarter of a second of audio. `close` marks the
    session complete and deletes the journal; leaving a `with` block by an exception closes the file without that mark;
    it still reads.
    """

    def __init__(self, file: h5py.File, path: Path, hidden: Path, header: Header, n_channels: int) -> None:
        self._file, self._path, self._hidden, self._n_channels = file, path, hidden, n_channels
        self._is_published = False
        self._next_flags = 0
        self._failure: SessionWriteError | None = None  # once the disk refused, every later call says so
        self._flush_interval_samples = round(_FLUSH_INTERVAL_S * header.sample_rate_hz)
        self._n_flushed_samples = 0
        self._time_data = GrowingStream(file, layout.TIME_DATA, "<f4", (n_channels,))
        self._time_data.dataset.attrs.create("sample_freq", float(header.sample_rate_hz))
        self._pictures = GrowingStream(file, layout.CAMERA_STREAM, np.uint8)
        self._tables = {name: GrowingTable(file, name, dtype) for name, dtype in layout.TABLES.items()}
        self._state = file.create_dataset(layout.STATE, data=np.array([layout.STATE_OPEN], dtype=np.uint8))
        self._checksums = Checksums(file, layers.fixed_names(header))
        file.swmr_mode = True
        descriptor = file.id.get_vfd_handle()
        os.fsync(descriptor)
        places = {chunk_rows_name(each.name): np.array([each.chunk_rows]) for each in (self._time_data, self._pictures)}
        journal = create_journal(journal_path(hidden), layers.journal_header(header) | places)
        self._durability = Durability(descriptor, journal)

    @classmethod
    def create(
        cls,
        path: Path,
        *,
        name: str,
        description_text: str,
        n_channels: int,
        sample_rate_hz: float,
        versions: Mapping[str, str],
        truth: Truth | None = None,
        corners_px: NDArray[np.float64] | None = None,
        tdoas: MeasuredTdoas | None = None,
    ) -> Self:
        """Make a new session file, ready to be appended to; nothing is ever written over.

        Parameters
        ----------
        path : Path
        name : str
            Of the session.
        description_text : str
            The rig description's YAML, word for word.
        n_channels : int
            Columns of `time_data`, as in `Audio.recorded_channels`.
        sample_rate_hz : float
        versions : mapping of str to str
            Of software, firmware and drivers.
        truth : Truth, optional
        corners_px : (n_poses, n_corners, 2) array, optional
            Measured corners in pixels, NaN where not found; a row per row of the table of poses.
        tdoas : MeasuredTdoas, optional
            A row per row of the table of emissions.

        Raises
        ------
        TargetExistsError
            There is something at `path`.
        SessionError
            The folder is missing, or the file cannot be written.
        """
        header = Header(name, description_text, versions, float(sample_rate_hz), truth, corners_px, tdoas)
        publication.refuse_existing(Path(path))
        writer = cls.begin(path, header, n_channels)
        try:
            writer.publish()
        except BaseException:
            writer.discard()
            raise
        return writer

    @classmethod
    def begin(cls, path: Path, header: Header, n_channels: int) -> Self:
        """Make a new session under a hidden name beside `path`, to be published or discarded.

        Raises
        ------
        SessionError
            The folder is missing, or the file cannot be written.
        TargetExistsError
            Another program makes this very session.
        """
        path = Path(path)
        hidden = publication.prepare(path)
        file = _create_file(path, hidden)
        try:
            with _writing(path):
                layers.write_header(file, header)
                return cls(file, path, hidden, header, n_channels)
        except BaseException:
            _abandon(file)
            publication.discard(hidden)
            raise

    def publish(self) -> None:
        """Give the session its name; raises TargetExistsError where something has it."""
        publication.publish(self._hidden, self._path)
        self._is_published = True

    def replace(self, *, keep: bool) -> Path | None:
        """Put the session in the place of an older one of its name once all is on the disk.

        Returns the other name under which the older one is kept, where `keep` asks for it.
        """
        self.flush()
        with self._appending():
            self._durability.settle()
        kept = publication.replace(self._hidden, self._path, keep=keep)
        self._is_published = True
        return kept

    def discard(self) -> None:
        """Delete a session that was never published."""
        with suppress(OSError, RuntimeError):
            self._file.close()
        with suppress(OSError):
            self._durability.close()
        publication.discard(self._hidden)

    def mark_resumed(self) -> None:
        """Flag the next block of audio: a later run begins there."""
        self._next_flags |= layout.FLAG_RESUMED

    def append_audio(
        self, samples: NDArray[np.float32], *, host_time_s: float, adc_time_s: float, flags: int = 0
    ) -> int:
        """Append consecutive samples (n, n_channels), full scale = 1, and return the row of the first.

        Parameters
        ----------
        samples : (n, n_channels) float32 array
        host_time_s : float
            Host monotonic time of the first sample.
        adc_time_s : float
            The driver's own time of it, NaN where it has none.
        flags : int
            `layout.FLAG_*`.

        Raises
        ------
        SessionError
            Another number of channels, or the file cannot be written.
        """
        if samples.ndim != 2 or samples.shape[1] != self._n_channels:
            raise SessionError(
                f"{self._path}: audio of shape {samples.shape} does not fit a session of {self._n_channels} channels"
            )
        rows = np.ascontiguousarray(samples, dtype="<f4")
        flags, self._next_flags = flags | self._next_flags, 0
        with self._appending():
            first = self._time_data.append(rows)
            self._tables[layout.AUDIO_BLOCKS].append(
                first, len(rows), host_time_s, adc_time_s, flags, zlib.crc32(rows.data)
            )
        if self.n_samples - self._n_flushed_samples >= self._flush_interval_samples:
            self.flush()
        return first

    def append_frame(self, image: NDArray[np.uint8], *, host_time_s: float, pose: int) -> int:
        """Append a picture (height, width) or (height, width, 3) of bytes, losslessly, and return its index.

        Raises
        ------
        SessionError
            Not such a picture, or the file cannot be written.
        """
        return self.append_png(picture.encode(image), host_time_s=host_time_s, pose=pose)

    def append_png(self, png: NDArray[np.uint8], *, host_time_s: float, pose: int) -> int:
        """Append a picture that is PNG bytes (n,) already, and return its index."""
        with self._appending():
            offset = self._pictures.append(png)
            return self._tables[layout.CAMERA_FRAMES].append(offset, len(png), host_time_s, pose, zlib.crc32(png.data))

    def append_emission(
        self,
        *,
        pose: int,
        buzzer: int,
        repeat: int,
        waveform: str,
        board_time_s: float,
        host_time_s: float,
        expected_sample: int,
        accepted: bool,
        predicted_sample: float = math.nan,
        predicted_std_s: float = math.nan,
        measured_sample: float = math.nan,
        latency_s: float = math.nan,
    ) -> None:
        """Append what was played; the fields are those of `layout.EMISSION` and `layout.ONSET`."""
        label = _cut(waveform, layout.EMISSION["waveform"].itemsize)
        with self._appending():
            self._tables[layout.ONSETS].append(predicted_sample, predicted_std_s, measured_sample, latency_s)
            self._tables[layout.EMISSIONS].append(
                pose, buzzer, repeat, label, board_time_s, host_time_s, expected_sample, bool(accepted)
            )

    def append_ping(self, *, earliest_host_time_s: float, latest_host_time_s: float, board_time_s: float) -> None:
        """Append a reading of the trigger board's clock; the fields are those of `layout.PING`."""
        with self._appending():
            self._tables[layout.PINGS].append(earliest_host_time_s, latest_host_time_s, board_time_s)

    def append_clock_fit(
        self,
        *,
        clock: bytes,
        since_host_time_s: float,
        host_time_s: float,
        reading: float,
        rate: float,
        rate_std: float,
        std_s: float,
        n_readings: int,
    ) -> None:
        """Append a line from a device's clock to the host's; the fields are those of `layout.CLOCK_FIT`."""
        with self._appending():
            self._tables[layout.CLOCK_FITS].append(
                clock, since_host_time_s, host_time_s, reading, rate, rate_std, std_s, n_readings
            )

    def append_pose(self, *, pose: int, start_host_time_s: float, end_host_time_s: float, accepted: bool) -> None:
        """Append a board position that is done with; the fields are those of `layout.POSE`."""
        with self._appending():
            self._tables[layout.POSES].append(pose, start_host_time_s, end_host_time_s, bool(accepted))

    def append_log(self, host_time_s: float, level: str, text: str) -> None:
        """Append a log line; text of more than 240 bytes is cut, level ("info", "warning", "error") at 8 bytes."""
        line = layout.LOG_LINE
        with self._appending():
            self._tables[layout.LOG].append(
                host_time_s, _cut(level, line["level"].itemsize), _cut(text, line["text"].itemsize)
            )

    def extend(self, tables: Mapping[str, NDArray[np.void]]) -> None:
        """Append rows of another session's tables, by name, as they are."""
        with self._appending():
            for name, rows in tables.items():
                self._tables[name].extend(rows)

    @property
    def n_samples(self) -> int:
        """Samples appended so far, per channel."""
        return self._time_data.n_rows

    @property
    def n_frames(self) -> int:
        """Pictures appended so far."""
        return self._tables[layout.CAMERA_FRAMES].n_rows

    def flush(self) -> None:
        """Hand everything to the operating system: from here on it survives a crash of this program.

        Raises
        ------
        SessionError
            The file cannot be written.
        """
        with self._appending():
            news: Arrays = {stream.name: stream.flush() for stream in (self._time_data, self._pictures)}
            news |= {name: table.flush() for name, table in self._tables.items()}
            if news := {name: rows for name, rows in news.items() if len(rows)}:
                self._durability.submit(record(news))
        self._n_flushed_samples = self.n_samples

    def close(self) -> None:
        """Flush, mark the session complete, and close the file; safe to call twice.

        Raises
        ------
        SessionError
            The file cannot be written; it is closed all the same, as it was last flushed.
        """
        self._close(layout.STATE_CLOSED)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        if error is None:
            self.close()
        else:
            with suppress(SessionError):  # the error under way says more
                self._close(layout.STATE_OPEN)
            if not self._is_published:
                self.discard()

    def _close(self, state: int) -> None:
        if not self._file:
            return
        self.flush()
        with self._appending():
            self._durability.finish()
            self._checksums.finish(self._tables.values())
            self._state[0] = state
            self._file.flush()
            self._file.close()
            self._durability.close()
            here = self._path if self._is_published else self._hidden
            journal_path(here).unlink(missing_ok=True)  # all is on the disk, in a closed file
            publication.sync_folder(here.parent)

    @contextmanager
    def _appending(self) -> Iterator[None]:
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


def _create_file(path: Path, hidden: Path) -> h5py.File:
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


def _cut(text: str, n_bytes: int) -> bytes:
    return text.encode(errors="replace")[:n_bytes].decode(errors="ignore").encode()
