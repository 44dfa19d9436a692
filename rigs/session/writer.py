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

from rigs.errors import SessionError, SessionWriteError, TargetError, TargetExistsError, reason
from rigs.session import layers, layout, picture
from rigs.session.growing import GrowingStream, GrowingTable
from rigs.session.layout import MeasuredTdoas, Truth

_LIBVER = ("v110", "v110")  # the oldest that knows SWMR; PyTables and MATLAB cannot read "latest"
_FLUSH_INTERVAL_S = 1.0


class SessionWriter:
    """Appends a recording to a new session file; make one with `create`, use it from one thread.

    Whatever was flushed survives a crash. The writer flushes by itself after every second of audio. `close` marks the
    session complete; leaving a `with` block by an exception closes the file without that mark; it still reads.
    """

    def __init__(self, file: h5py.File, path: Path, n_channels: int, sample_rate_hz: float) -> None:
        self._file, self._path, self._n_channels = file, path, n_channels
        self._failure: SessionWriteError | None = None  # once the disk refused, every later call says so
        self._flush_interval_samples = round(_FLUSH_INTERVAL_S * sample_rate_hz)
        self._n_flushed_samples = 0
        self._time_data = GrowingStream(file, layout.TIME_DATA, "<f4", (n_channels,))
        self._time_data.dataset.attrs.create("sample_freq", float(sample_rate_hz))
        self._pictures = GrowingStream(file, layout.CAMERA_STREAM, np.uint8)
        self._blocks = GrowingTable(file, layout.AUDIO_BLOCKS, layout.AUDIO_BLOCK)
        self._frames = GrowingTable(file, layout.CAMERA_FRAMES, layout.FRAME)
        self._emissions = GrowingTable(file, layout.EMISSIONS, layout.EMISSION)
        self._onsets = GrowingTable(file, layout.ONSETS, layout.ONSET)
        self._pings = GrowingTable(file, layout.PINGS, layout.PING)
        self._fits = GrowingTable(file, layout.CLOCK_FITS, layout.CLOCK_FIT)
        self._poses = GrowingTable(file, layout.POSES, layout.POSE)
        self._log = GrowingTable(file, layout.LOG, layout.LOG_LINE)
        self._state = file.create_dataset(layout.STATE, data=np.array([layout.STATE_OPEN], dtype=np.uint8))

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
        path = Path(path)
        file = _create_file(path)
        try:
            with _writing(path):
                layers.write_header(file, name, description_text, versions)
                layers.write_measured(file, corners_px, tdoas)
                layers.write_truth(file, truth)
                writer = cls(file, path, n_channels, sample_rate_hz)
                file.swmr_mode = True
        except BaseException:
            _abandon(file)
            path.unlink(missing_ok=True)
            raise
        return writer

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
        with self._appending():
            first = self._time_data.append(rows)
            self._blocks.append(first, len(rows), host_time_s, adc_time_s, flags, zlib.crc32(rows.data))
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
        png = picture.encode(image)
        with self._appending():
            offset = self._pictures.append(png)
            return self._frames.append(offset, len(png), host_time_s, pose, zlib.crc32(png.data))

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
            self._onsets.append(predicted_sample, predicted_std_s, measured_sample, latency_s)
            self._emissions.append(
                pose, buzzer, repeat, label, board_time_s, host_time_s, expected_sample, bool(accepted)
            )

    def append_ping(self, *, earliest_host_time_s: float, latest_host_time_s: float, board_time_s: float) -> None:
        """Append a reading of the trigger board's clock; the fields are those of `layout.PING`."""
        with self._appending():
            self._pings.append(earliest_host_time_s, latest_host_time_s, board_time_s)

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
            self._fits.append(clock, since_host_time_s, host_time_s, reading, rate, rate_std, std_s, n_readings)

    def append_pose(self, *, pose: int, start_host_time_s: float, end_host_time_s: float, accepted: bool) -> None:
        """Append a board position that is done with; the fields are those of `layout.POSE`."""
        with self._appending():
            self._poses.append(pose, start_host_time_s, end_host_time_s, bool(accepted))

    def append_log(self, host_time_s: float, level: str, text: str) -> None:
        """Append a log line; text of more than 240 bytes is cut, level ("info", "warning", "error") at 8 bytes."""
        line = layout.LOG_LINE
        with self._appending():
            self._log.append(host_time_s, _cut(level, line["level"].itemsize), _cut(text, line["text"].itemsize))

    @property
    def n_samples(self) -> int:
        """Samples appended so far, per channel."""
        return self._time_data.n_rows

    @property
    def n_frames(self) -> int:
        """Pictures appended so far."""
        return self._frames.n_rows

    def flush(self) -> None:
        """Hand everything to the operating system: from here on it survives a crash of this program.

        Raises
        ------
        SessionError
            The file cannot be written.
        """
        with self._appending():
            for stream in (self._time_data, self._pictures):
                stream.flush()
            for table in (self._blocks, self._frames, self._pings, self._fits, self._poses):
                table.flush()
            for table in (self._onsets, self._emissions, self._log):
                table.flush()
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

    def _close(self, state: int) -> None:
        if not self._file:
            return
        self.flush()
        with self._appending():
            self._state[0] = state
            self._file.flush()
            self._file.close()

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
            raise


def _create_file(path: Path) -> h5py.File:
    if not path.parent.is_dir():
        raise TargetError(f"{path}: there is no folder {path.parent}: make it first, or name another")
    try:
        return h5py.File(path, "x", libver=_LIBVER)
    except (OSError, ValueError) as error:
        if path.exists() or path.is_symlink():
            raise TargetExistsError(f"{path}: there is already something of this name: choose another name") from error
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
