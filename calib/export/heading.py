"""What every export begins with, so that nobody has to ask where its numbers come from and what they mean."""

from __future__ import annotations

from calib.result_file import StoredCalibration
from rigs.geometry import CAMERA_FRAME


def heading(array: StoredCalibration) -> list[str]:
    """Return the lines that every export begins with: origin, frame and units, order, speed of sound."""
    channels, columns = (", ".join(map(str, numbers)) for numbers in (array.channels, array.columns))
    sessions = printable(array.session_names)
    return [
        f"Microphone positions by {array.software}, method {array.method}, from session {sessions}",
        f"(SHA-256 {' + '.join(array.sessions)}).",
        f"Frame and unit: {CAMERA_FRAME}.",
        f"Order: input channels {channels} (columns {columns} of the session's time_data, from 0).",
        f"Speed of sound: {array.speed_of_sound_m_s:.3f} +- {array.speed_of_sound_std_m_s:.3f} m/s.",
    ]


def printable(text: str) -> str:
    """Return a text with a question mark for whatever cannot stand in a line of a file."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)
