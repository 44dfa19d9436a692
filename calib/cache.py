"""Arrivals kept beside the session, so that another solve of it need not listen again.

The session itself is never written into. A file of another session, of other settings or of another version is no use
and is replaced; one that cannot be read or written is done without.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
import zipfile
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.flaws import Flaw, Flaws
from calib.sound import SoundArrivals, TdoaMode
from rigs import __version__

DAMAGED = (OSError, ValueError, KeyError, EOFError, IndexError, RuntimeError, zipfile.BadZipFile, zlib.error)
VERSION = 3  # changes whenever arrivals come out differently
SUFFIX = ".arrivals.npz"


class ArrivalCache:
    """The arrivals of one session, beside its file.

    Parameters
    ----------
    session_path : Path
    session_sha256 : str
        Of the session's file as it is now.
    """

    def __init__(self, session_path: Path, session_sha256: str) -> None:
        self.path = session_path.with_suffix(SUFFIX)
        self._session_sha256 = session_sha256

    def load(self, rows: NDArray[np.intp], mode: TdoaMode) -> SoundArrivals | None:
        """Return the arrivals of an earlier run on the same sound with the same settings, if there are any."""
        try:
            with self.path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
                if str(file["key"]) != self._key(mode) or not np.array_equal(file["rows"], rows):
                    return None
                arrival_s = file["arrival_s"]
                table = {Flaw(str(name)): mask for name, mask in zip(file["flaws"], file["masks"], strict=True)}
                channels = tuple(int(channel) for channel in file["channels"])
                flaws = Flaws((len(rows), arrival_s.shape[1]), table)
                return SoundArrivals(
                    str(file["mode"]), rows, channels, arrival_s, file["std_s"], flaws, file["quality"],
                    *((file["onset_s"], file["onset_std_s"]) if "onset_s" in file else ()),
                )  # fmt: skip
        except DAMAGED:
            return None

    def save(self, sound: SoundArrivals, mode: TdoaMode) -> None:
        """Keep arrivals for the next run, where the folder lets us and nothing else has that name."""
        if self.path.exists() and not self._is_ours():
            return
        with contextlib.suppress(OSError):
            handle, temporary = tempfile.mkstemp(dir=self.path.parent, prefix=f".{self.path.name}.")
            try:
                with os.fdopen(handle, "wb") as file:
                    self._write(file, sound, mode)
                Path(temporary).chmod(0o644)
                Path(temporary).replace(self.path)
            finally:
                Path(temporary).unlink(missing_ok=True)

    def _write(self, file: object, sound: SoundArrivals, mode: TdoaMode) -> None:
        onsets = {}
        if sound.onset_s is not None and sound.onset_std_s is not None:
            onsets = {"onset_s": sound.onset_s, "onset_std_s": sound.onset_std_s}
        masks = np.array(list(sound.flaws.table.values()), dtype=bool).reshape(-1, *sound.flaws.shape)
        np.savez_compressed(
            file,  # type: ignore[arg-type]
            key=np.array(self._key(mode)),
            mode=np.array(sound.mode),
            rows=sound.rows,
            channels=np.array(sound.channels, dtype=np.int32),
            arrival_s=sound.arrival_s,
            std_s=sound.std_s,
            quality=sound.quality,
            flaws=np.array([str(flaw) for flaw in sound.flaws.table], dtype="U40"),
            masks=masks,
            **onsets,  # type: ignore[arg-type]
        )

    def _key(self, mode: TdoaMode) -> str:
        text = f"{self._session_sha256} {mode} {VERSION} {__version__}"
        return hashlib.sha256(text.encode()).hexdigest()

    def _is_ours(self) -> bool:
        try:
            with self.path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
                return {"key", "arrival_s", "masks"} <= set(file.files)
        except DAMAGED:
            return False
