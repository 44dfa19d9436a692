"""What the network camera sees: the board where the hands hold it, with noise, as JPEG."""

from __future__ import annotations

from threading import Lock

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.devices.simulated.picture import Painter
from acquire.devices.simulated.scene import Scene
from rigs.geometry import Pose
from virtual_bench.hands import Hands

JPEG_QUALITY = 98  # adds under 0.002 px to the 0.02 px that noise alone leaves of the corners


class View:
    """Paints and compresses pictures.

    Parameters
    ----------
    scene : Scene
    hands : Hands
    """

    def __init__(self, scene: Scene, hands: Hands) -> None:
        self._painter, self._hands = Painter(scene), hands
        self._noise = scene.description.simulation.image_noise
        self._rng = np.random.default_rng(scene.seed)
        self._painted: tuple[Pose, NDArray[np.float32]] | None = None
        self._lock = Lock()

    def jpeg(self, time_s: float) -> bytes:
        """Return the picture of a host time."""
        with self._lock:
            clean = self._clean(time_s)
            noise = self._rng.standard_normal(clean.shape, dtype=np.float32)
        picture = np.clip(np.rint(clean + self._noise * noise), 0, 255).astype(np.uint8)
        return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()

    def _clean(self, time_s: float) -> NDArray[np.float32]:
        """Paint the picture, or take the last one while the board stands still."""
        moving, pose = self._hands.is_moving(time_s), self._hands.board_to_camera(time_s)
        if moving:
            return self._painter.picture(pose, moving=True)
        if self._painted is None or self._painted[0] is not pose:
            self._painted = (pose, self._painter.picture(pose, moving=False))
        return self._painted[1]
