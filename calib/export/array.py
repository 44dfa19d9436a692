"""What an export says: the calibrated array."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.result import Recording
from rigs.description import Intrinsics
from rigs.geometry import CAMERA_FRAME

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class CalibratedArray:
    """Microphones in the camera frame, and what is needed to use them.

    Parameters
    ----------
    session_name, session_sha256, method, software : str
        What made it.
    channels : tuple of int
        Input channel of each microphone.
    positions_m : (n_mics, 3) array
    covariance_m2 : (n_mics, 3, 3) array
    speed_of_sound_m_s, speed_of_sound_std_m_s : float
    intrinsics : Intrinsics
    recording : Recording
    """

    session_name: str
    session_sha256: str
    method: str
    software: str
    channels: tuple[int, ...]
    positions_m: FloatArray
    covariance_m2: FloatArray
    speed_of_sound_m_s: float
    speed_of_sound_std_m_s: float
    intrinsics: Intrinsics
    recording: Recording

    @property
    def columns(self) -> tuple[int, ...]:
        """Column of each microphone in the session's `time_data`, from 0."""
        return tuple(self.recording.channels.index(channel) for channel in self.channels)

    @property
    def std_m(self) -> FloatArray:
        """Standard deviations (n_mics, 3) of the positions."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance_m2, axis1=1, axis2=2)))

    @property
    def names(self) -> list[str]:
        """A name for each microphone."""
        return [f"microphone_{channel}" for channel in self.channels]

    def heading(self) -> list[str]:
        """Return the lines that every export begins with: origin, frame and units, order, speed of sound."""
        channels, columns = (", ".join(map(str, numbers)) for numbers in (self.channels, self.columns))
        session = printable(self.session_name)
        return [
            f"Microphone positions by {self.software}, method {self.method}, from session {session}",
            f"(SHA-256 {self.session_sha256}).",
            f"Frame and unit: {CAMERA_FRAME}.",
            f"Order: input channels {channels} (columns {columns} of the session's time_data, from 0).",
            f"Speed of sound: {self.speed_of_sound_m_s:.3f} +- {self.speed_of_sound_std_m_s:.3f} m/s.",
        ]


def printable(text: str) -> str:
    """Return a text with a question mark for whatever cannot stand in a line of a file."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)
