"""One of the session's own pictures, with what the calibration makes of it."""

from __future__ import annotations

import base64
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.result import Calibration
from rigs.board import project
from rigs.session.reader import Session

FloatArray = NDArray[np.float64]

QUALITY = 80
LARGEST_PX = 1280


@dataclass(frozen=True)
class Photograph:
    """A picture of the session's.

    Parameters
    ----------
    pose : int
    width, height : int
        Of the picture as the session has it, in pixels.
    source : str
        The picture as a data URL.
    corners_px, buzzers_px : (n, 2) arrays
        Corners seen, and buzzers where the calibration says that they are.
    """

    pose: int
    width: int
    height: int
    source: str
    corners_px: FloatArray
    buzzers_px: FloatArray


def photograph(session: Session, result: Calibration) -> Photograph | None:
    """Return the picture of the nearest board; None where the session has no pictures."""
    if result.evidence is None or len(session.frames) == 0:
        return None
    rows = np.flatnonzero(np.isin(result.view.pose, session.frames["pose"]))
    if len(rows) == 0:
        return None
    row = int(min(rows, key=lambda row: result.view.board_to_camera[row].translation_m[2]))
    pose = int(result.view.pose[row])
    frames = np.flatnonzero(session.frames["pose"] == pose)
    image = session.picture(int(frames[0]))
    height, width = image.shape[:2]
    placed, buzzers = result.view.board_to_camera[row], session.description.board.buzzers
    corners_px = result.evidence.corners_px[row]
    return Photograph(
        pose,
        width,
        height,
        _data_url(image),
        corners_px[np.isfinite(corners_px).all(axis=1)],
        project(np.array([buzzer.position_m for buzzer in buzzers]), placed, result.view.intrinsics),
    )


def _data_url(image: NDArray[np.uint8]) -> str:
    shrink = min(1.0, LARGEST_PX / max(image.shape[:2]))
    if shrink < 1:
        image = np.asarray(cv2.resize(image, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    _, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return f"data:image/jpeg;base64,{base64.b64encode(jpeg.tobytes()).decode()}"
