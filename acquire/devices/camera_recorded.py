"""Recorded pictures in place of a camera: a folder of them, and the pace at which they are played."""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np

from acquire.devices.camera_stream import Picture, Pictures
from acquire.errors import DeviceError

_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm"}


class PictureFolder:
    """The pictures of a folder, once, in the order of their names.

    Parameters
    ----------
    folder : Path

    Raises
    ------
    DeviceError
        The folder holds no picture.
    """

    def __init__(self, folder: Path) -> None:
        self._left = sorted((path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES), reverse=True)
        self._path = folder
        if not self._left:
            raise DeviceError(f"{folder}: no pictures in this folder: name one with .png or .jpg files")

    def grab(self) -> bool:
        """Go on to the next picture; False after the last."""
        if not self._left:
            return False
        self._path = self._left.pop()
        return True

    def retrieve(self) -> tuple[bool, Picture]:
        """Read the picture, colour where it has colour.

        Raises
        ------
        DeviceError
            The file holds no picture of 8 bits.
        """
        picture = cv2.imread(str(self._path), cv2.IMREAD_ANYCOLOR)
        if picture is None:
            raise DeviceError(f"{self._path}: not a picture that OpenCV can read: take it out of the folder")
        return True, np.asarray(picture, dtype=np.uint8)

    def release(self) -> None:
        """Drop the pictures that are left."""
        self._left.clear()


class Paced:
    """Pictures held back until their time has come.

    Parameters
    ----------
    pictures : Pictures
    fps : float
    """

    def __init__(self, pictures: Pictures, fps: float) -> None:
        self._pictures, self._interval_s = pictures, 1 / fps
        self._due_s: float | None = None

    def grab(self) -> bool:
        """Wait until the next picture is due; False after the last."""
        if self._due_s is None:
            self._due_s = time.monotonic()
        time.sleep(max(0.0, self._due_s - time.monotonic()))
        self._due_s += self._interval_s
        return self._pictures.grab()

    def retrieve(self) -> tuple[bool, Picture]:
        """Return the picture."""
        return self._pictures.retrieve()

    def release(self) -> None:
        """Let go of the pictures."""
        self._pictures.release()
