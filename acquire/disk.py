"""The disk: whether a session fits on it, and whether there is still room while it is recorded."""

from __future__ import annotations

import shutil
from pathlib import Path

from acquire.errors import DiskShortError
from rigs.description import RigDescription
from rigs.errors import TargetError, reason

_RESERVE_BYTES = 64_000_000
_RESERVE_S = 10.0
_SAMPLE_BYTES = 4
_PNG_BYTES_PER_PIXEL = 1.5  # of a colour picture with a camera's noise
_MOVE_S = 6.0  # in which an operator brings the board to its next place
_REMEDY = "free some space or choose another disk"


class DiskSpace:
    """The room for a session on its disk.

    Parameters
    ----------
    path : Path
        Of the session file.
    description : RigDescription
    """

    def __init__(self, path: Path, description: RigDescription) -> None:
        self._path = path
        self._session_bytes = session_bytes(description)
        self._reserve_bytes = _RESERVE_BYTES + _RESERVE_S * _bytes_per_s(description)

    def check(self, also_bytes: int = 0) -> None:
        """Raise DiskShortError where less is left than it takes to close the session well, or the folder is gone.

        Parameters
        ----------
        also_bytes : int
            What will be written before, such as a copy.
        """
        free_bytes, needed_bytes = _free_bytes(self._path), self._reserve_bytes + also_bytes
        if free_bytes < needed_bytes:
            raise DiskShortError(
                f"{self._path}: the disk is nearly full ({in_words(free_bytes)} left, at least "
                f"{in_words(needed_bytes)} needed): {_REMEDY}"
            )

    def doubt(self) -> str | None:
        """Say that the session may not fit; None where it most likely does."""
        room_bytes = _free_bytes(self._path) - self._reserve_bytes
        if room_bytes >= self._session_bytes:
            return None
        return (
            f"{self._path}: this session may take {in_words(self._session_bytes)}, the disk has room for "
            f"{in_words(max(room_bytes, 0))}: {_REMEDY}"
        )


def session_bytes(description: RigDescription) -> float:
    """Return about how large (bytes) a session becomes, all its poses captured at the first go."""
    signal, capture = description.signal, description.capture
    n_emissions = len(description.board.buzzers) * signal.repeats
    pose_s = _MOVE_S + capture.still_s + n_emissions * (signal.waveform().duration_s + signal.gap_s)
    return capture.poses * pose_s * _bytes_per_s(description)


def _bytes_per_s(description: RigDescription) -> float:
    audio, (width, height) = description.audio, description.camera.size_px
    audio_bytes = _SAMPLE_BYTES * len(audio.recorded_channels()) * audio.sample_rate_hz
    return audio_bytes + _PNG_BYTES_PER_PIXEL * width * height / description.capture.frame_interval_s


def _free_bytes(path: Path) -> int:
    try:
        usage = shutil.disk_usage(path.parent)
    except OSError as error:
        raise DiskShortError(f"{path}: its folder is gone ({reason(error)}): look where it was moved to") from error
    if usage.total == usage.free == 0:
        raise TargetError(f"{path}: {path.parent} is no disk: choose another folder")
    return usage.free


def in_words(n_bytes: float) -> str:
    """Return a size as people say it."""
    return f"{n_bytes / 1e9:.1f} GB" if n_bytes >= 1e9 else f"{n_bytes / 1e6:.0f} MB"
