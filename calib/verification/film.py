"""A short film: one picture for each emission, in a codec that ordinary players and browsers read."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]

FRAMES_PER_S = 3.0
# The first that this computer's OpenCV can write. H.264 plays everywhere, but its wheels for Linux cannot write it; VP9
# plays in browsers and in VLC, mpv and the like; MPEG-4 part 2 in players, but in no browser.
CODECS = {"avc1": "H.264", "vp09": "VP9", "mp4v": "MPEG-4 part 2"}


def write_film(path: Path, pictures: Iterable[Picture], size_px: tuple[int, int]) -> str | None:
    """Write pictures (height, width, 3) into an MP4 file and return its codec; None where OpenCV can write none.

    Width and height become even, as the codecs need them.
    """
    width, height = (side // 2 * 2 for side in size_px)
    opened = _opened(path, (width, height))
    if opened is None:
        return None
    writer, codec = opened
    try:
        for picture in pictures:
            writer.write(np.ascontiguousarray(picture[:height, :width]))
    finally:
        writer.release()
    return codec


def _opened(path: Path, size_px: tuple[int, int]) -> tuple[cv2.VideoWriter, str] | None:
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # a codec that is not there is no news to the user
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(0)
    try:
        for tag, codec in CODECS.items():
            writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*tag), FRAMES_PER_S, size_px)
            if writer.isOpened():
                return writer, codec
    finally:
        cv2.utils.logging.setLogLevel(level)
    return None
