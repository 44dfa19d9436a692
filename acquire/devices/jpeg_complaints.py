"""The complaints of libjpeg about damaged pictures: it writes them to standard error, over the operator's screen.

OpenCV's FFmpeg keeps quiet when it is told to; its decoder of a USB camera's MJPEG and of picture files cannot be told.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock

from acquire.devices.camera_stream import Picture, Pictures

_STDERR = 2
_COMPLAINTS = (b"Corrupt JPEG data", b"Premature end of JPEG file", b"Invalid SOS parameters for sequential JPEG")
_ONE_AT_A_TIME = Lock()  # the number is the whole process's: two that exchange it would put back each other's


class Quiet:
    """Pictures that are decoded without a complaint on the screen.

    Parameters
    ----------
    pictures : Pictures
    """

    def __init__(self, pictures: Pictures) -> None:
        self.grab, self.release, self._pictures = pictures.grab, pictures.release, pictures

    def retrieve(self) -> tuple[bool, Picture]:
        """Return the picture that was grabbed last."""
        with no_jpeg_complaints():
            return self._pictures.retrieve()


@contextmanager
def no_jpeg_complaints() -> Iterator[None]:
    """Hold standard error back until the block ends, and then let through all but the complaints; on Linux only."""
    if sys.platform != "linux" or sys.__stderr__ is None:  # closed: that number may be another file's
        yield
        return
    with _ONE_AT_A_TIME:
        screen, held = os.dup(_STDERR), os.memfd_create("stderr")
        try:
            os.dup2(held, _STDERR)
            yield
        finally:
            os.dup2(screen, _STDERR)
            with os.fdopen(held, "rb") as said:
                said.seek(0)
                others = b"".join(line for line in said if not line.startswith(_COMPLAINTS))
            if others:
                os.write(screen, others)
            os.close(screen)
