"""The writer of a session file: what a capture appends to it, and when that is flushed."""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from rigs.errors import SessionError
from rigs.session import layout, picture
from rigs.session.growing_file import GrowingFile
from rigs.session.layers import Header
from rigs.session.layout import MeasuredTdoas, Truth
from rigs.session.publication import Publication, refuse_existing

_FLUSH_INTERVAL_S = 0.25


class SessionWriter:
    """Appends a recording to a new session file; make one with `create`, use it from one thread.

    Whatever was flushed survives a crash of this program, and half a second later a power loss too: a thread syncs the
    file and a journal beside it. The writer flushes by itself after every quarter of a second of audio. `close` marks
    the session complete and deletes the journal; leaving a `with` block by an exception closes the file without that
    mark; it still reads.
    """

    def __init__(self, publication: Publication, header: Header, n_channels: int) -> None:
        self._publication, self._n_channels = publication, n_channels
        self._file = GrowingFile(publication.path, publication.hidden, header, n_channels)
        self._next_flags = 0
        self._flush_interval_samples = round(_FLUSH_INTERVAL_S * header.sample_rate_hz)
        self._n_flushed_samples = 0

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
        refuse_existing(Path(path))
        writer = cls.begin(Path(path), header, n_channels)
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
        publication = Publication(path)
        try:
            return cls(publication, header, n_channels)
        except BaseException:
            publication.discard()
            raise

    def publish(self) -> None:
        """Give the session its name; raises TargetExistsError where something has it."""
        self._publication.publish()

    def replace(self, *, keep: bool) -> Path | None:
        """Put the session in the place of an older one of its name once all is on the disk.

        Returns the other name under which the older one is kept, where `keep` asks for it.
        """
        self.flush()
        self._file.settle()
        return self._publication.replace(keep=keep)

    def discard(self) -> None:
        """Delete a session that was never published."""
        self._file.let_go()
        self._publication.discard()

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
                f"{self._publication.path}: audio of shape {samples.shape} does not fit a session of "
                f"{self._n_channels} channels"
            )
        rows = np.ascontiguousarray(samples, dtype="<f4")
        flags, self._next_flags = flags | self._next_flags, 0
        first = self._file.append_rows(layout.TIME_DATA, rows)
        self._file.append_record(
            layout.AUDIO_BLOCKS, first, len(rows), host_time_s, adc_time_s, flags, zlib.crc32(rows.data)
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
        offset = self._file.append_rows(layout.CAMERA_STREAM, png)
        return self._file.append_record(layout.CAMERA_FRAMES, offset, len(png), host_time_s, pose, zlib.crc32(png.data))

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
        self._file.append_record(layout.ONSETS, predicted_sample, predicted_std_s, measured_sample, latency_s)
        self._file.append_record(
            layout.EMISSIONS, pose, buzzer, repeat, label, board_time_s, host_time_s, expected_sample, bool(accepted)
        )

    def append_ping(self, *, earliest_host_time_s: float, latest_host_time_s: float, board_time_s: float) -> None:
        """Append a reading of the trigger board's clock; the fields are those of `layout.PING`."""
        self._file.append_record(layout.PINGS, earliest_host_time_s, latest_host_time_s, board_time_s)

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
        self._file.append_record(
            layout.CLOCK_FITS, clock, since_host_time_s, host_time_s, reading, rate, rate_std, std_s, n_readings
        )

    def append_pose(self, *, pose: int, start_host_time_s: float, end_host_time_s: float, accepted: bool) -> None:
        """Append a board position that is done with; the fields are those of `layout.POSE`."""
        self._file.append_record(layout.POSES, pose, start_host_time_s, end_host_time_s, bool(accepted))

    def append_log(self, host_time_s: float, level: str, text: str) -> None:
        """Append a log line; text of more than 240 bytes is cut, level ("info", "warning", "error") at 8 bytes."""
        line = layout.LOG_LINE
        self._file.append_record(
            layout.LOG, host_time_s, _cut(level, line["level"].itemsize), _cut(text, line["text"].itemsize)
        )

    def extend(self, tables: Mapping[str, NDArray[np.void]]) -> None:
        """Append rows of another session's tables, by name, as they are."""
        for name, rows in tables.items():
            self._file.extend(name, rows)

    @property
    def n_samples(self) -> int:
        """Samples appended so far, per channel."""
        return self._file.n_rows(layout.TIME_DATA)

    @property
    def n_frames(self) -> int:
        """Pictures appended so far."""
        return self._file.n_rows(layout.CAMERA_FRAMES)

    def flush(self) -> None:
        """Hand everything to the operating system: from here on it survives a crash of this program.

        Raises
        ------
        SessionError
            The file cannot be written.
        """
        self._file.flush()
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
            if not self._publication.is_done:
                self.discard()

    def _close(self, state: int) -> None:
        if not self._file.is_open:
            return
        self._file.close(state)
        self._publication.drop_journal()


def _cut(text: str, n_bytes: int) -> bytes:
    return text.encode(errors="replace")[:n_bytes].decode(errors="ignore").encode()
