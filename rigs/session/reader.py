"""The reader of a session file: whatever it hands out has been checked."""

from __future__ import annotations

import hashlib
import zlib
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from rigs.errors import DamagedSessionError, SessionError
from rigs.session import layers, layout, picture
from rigs.session.checksums import misfits
from rigs.session.container import Container, reading
from rigs.session.validation import Judge


class Session:
    """A session file, open for reading; make one with `open`.

    A file that is still being recorded, or whose writer was killed, reads as far as it was flushed when it was opened.

    Attributes
    ----------
    name, created_utc : str
    recovered : str
        What it was recovered from, such as "from s1.h5"; empty where it was not.
    complete : bool
        The recording ended well.
    description : RigDescription
    description_text, description_sha256 : str
        The YAML it was recorded with, word for word, and its hash.
    versions : dict of str to str
        Of software, firmware and drivers.
    sample_rate_hz : float
    n_samples, n_channels : int
    channels : tuple of int
        Input channel of each column of the audio.
    microphone_columns : tuple of int
        The columns of the audio that are microphones, the reference microphone included; the sync output is none.
    audio_blocks, frames, emissions, poses, log : structured arrays
        As in `rigs.session.layout`.
    onsets : structured array or None
        `layout.ONSET`, a row per row of `emissions`; None where the session has none.
    pings, clock_fits : structured arrays
        As in `rigs.session.layout`; empty where the session has none.
    corners_px : (n_poses, n_corners, 2) array or None
        NaN where not found.
    tdoas : MeasuredTdoas or None
    truth : Truth or None
    remarks : list of str
        What a cut-off recording lost.
    """

    def __init__(self, container: Container) -> None:
        self._container = container
        self.path = container.path
        self.name, self.created_utc = layers.read_identity(container)
        self.recovered = str(container.attribute("/", "recovered") or "")
        # The state, then the tables, then the streams: in a growing file each is as long as the one before needs.
        self.complete = bool(container.read(layout.STATE, np.uint8, (1,))[0] == layout.STATE_CLOSED)
        self.description_text, self.description_sha256 = layers.read_description(container)
        self.description = layers.parse(self.description_text, self.path)
        self.versions = layers.read_versions(container)
        self.channels = self.description.audio.recorded_channels()
        self.n_channels = len(self.channels)
        self.microphone_columns = tuple(range(len(self.description.audio.microphone_channels())))
        self.log = container.read(layout.LOG, layout.LOG_LINE, (None,))
        judge = Judge(str(self.path), self.complete)
        self._read_recording(judge)
        self.corners_px = layers.read_corners(container, self.description, len(self.poses), judge)
        self.tdoas = layers.read_tdoas(container, self.channels, len(self.emissions), judge)
        self.truth = layers.read_truth(container, self.description)
        self.remarks = judge.remarks

    @classmethod
    def open(cls, path: Path | str) -> Self:
        """Open a session file and check it.

        Raises
        ------
        SessionError
            Missing, empty, damaged, foreign, of a newer version, or its parts contradict one another.
        """
        container = Container.open(Path(path))
        try:
            return cls(container)
        except BaseException:
            container.close()
            raise

    def close(self) -> None:
        """Let the file go; safe to call twice."""
        self._container.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self.close()

    def audio(self, first_sample: int, n_samples: int) -> NDArray[np.float32]:
        """Return samples (n_samples, n_channels) from row `first_sample` on, full scale = 1.

        Raises
        ------
        SessionError
            The session does not hold all of them, or the file is damaged.
        """
        if first_sample < 0 or n_samples < 0 or first_sample + n_samples > self.n_samples:
            raise SessionError(
                f"{self.path}: samples {first_sample} to {first_sample + n_samples} are asked for, the session holds "
                f"0 to {self.n_samples}"
            )
        with reading(self.path):
            return np.asarray(self._time_data[first_sample : first_sample + n_samples], dtype=np.float32)

    def picture(self, index: int) -> NDArray[np.uint8]:
        """Return a picture (height, width) or (height, width, 3), as the camera gave it.

        Raises
        ------
        SessionError
            No such frame, a checksum that does not fit, or not a sane PNG.
        """
        return picture.decode(self.png(index), f"{self.path}: frame {index}")

    def png(self, index: int) -> NDArray[np.uint8]:
        """Return the bytes (n,) of a picture as they are stored, a PNG file.

        Raises
        ------
        SessionError
            No such frame, or a checksum that does not fit.
        """
        if not 0 <= index < len(self.frames):
            raise SessionError(f"{self.path}: frame {index} is asked for, the session holds {len(self.frames)}")
        png = self._png(index)
        if zlib.crc32(png.data) != self.frames["crc32"][index]:
            raise DamagedSessionError(f"{self.path}: frame {index} is damaged: its checksum does not fit")
        return png

    def verify(self) -> list[str]:
        """Read everything and return in words what does not fit its checksum; empty when all is well."""
        return [*self.remarks, *misfits(self._container), *self._bad_blocks(), *self._bad_frames()]

    def sha256(self) -> str:
        """Return the SHA-256 of the whole file, in hexadecimal."""
        with reading(self.path), self.path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()

    def _read_recording(self, judge: Judge) -> None:
        container = self._container
        blocks = container.read(layout.AUDIO_BLOCKS, layout.AUDIO_BLOCK, (None,))
        frames = container.read(layout.CAMERA_FRAMES, layout.FRAME, (None,))
        emissions = container.read(layout.EMISSIONS, layout.EMISSION, (None,))
        poses = container.read(layout.POSES, layout.POSE, (None,))
        self._time_data = container.dataset(layout.TIME_DATA, "<f4", (None, None))
        self._pictures = container.dataset(layout.CAMERA_STREAM, np.uint8, (None,))
        judge.channels(self._time_data.shape[1], self.description)
        self.sample_rate_hz = judge.sample_rate(container.attribute(layout.TIME_DATA, "sample_freq"), self.description)
        self.audio_blocks = judge.blocks(blocks, self._time_data.shape[0])
        self.n_samples = int(self.audio_blocks["n_samples"].sum(dtype=np.int64))
        self.frames = judge.frames(frames, self._pictures.shape[0])
        self.poses = judge.poses(poses)
        self.emissions = judge.emissions(emissions, self.poses, self.description)
        self.pings = layers.read_table(container, layout.PINGS, layout.PING)
        self.clock_fits = layers.read_table(container, layout.CLOCK_FITS, layout.CLOCK_FIT)
        onsets = layers.read_table(container, layout.ONSETS, layout.ONSET)[: len(self.emissions)]
        self.onsets = onsets if layout.ONSETS in container else None
        if self.onsets is not None:
            judge.measured_rows(len(self.onsets), len(self.emissions), layout.ONSETS)

    def _png(self, index: int) -> NDArray[np.uint8]:
        offset, length = int(self.frames["offset"][index]), int(self.frames["length"][index])
        with reading(self.path):
            return np.asarray(self._pictures[offset : offset + length])

    def _bad_blocks(self) -> list[str]:
        bad = []
        for index, block in enumerate(self.audio_blocks):
            samples = self.audio(int(block["first_sample"]), int(block["n_samples"]))
            if zlib.crc32(samples.data) != block["crc32"]:
                bad.append(f"audio block {index} is damaged: its checksum does not fit")
            elif not np.isfinite(samples).all():
                bad.append(f"audio block {index} holds samples that are not numbers")
        return bad

    def _bad_frames(self) -> list[str]:
        return [
            f"frame {index} is damaged: its checksum does not fit"
            for index, frame in enumerate(self.frames)
            if zlib.crc32(self._png(index).data) != frame["crc32"]
        ]
