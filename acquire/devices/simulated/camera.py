"""The simulated camera."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.devices.base import Frame
from acquire.devices.simulated.draws import draws
from acquire.devices.simulated.flaws import flawed_picture
from acquire.devices.simulated.picture import Painter
from acquire.devices.simulated.stage import Stage
from acquire.errors import DeviceError
from rigs.geometry import Pose

_STAMP_JITTER_S = 0.001
_SHIFTS = 128  # in each direction


class SimulatedCamera:
    """Takes pictures of a stage at its frame rate, each with noise of its own."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self._painter = Painter(stage.scene)
        self._fps = stage.scene.description.camera.fps
        self._noise = self._drawn_noise()
        self.warnings: list[str] = []
        self._start_s: float | None = None
        self._frozen: Frame | None = None
        self._painted: tuple[Pose, NDArray[np.float32]] | None = None

    def open(self) -> str:
        """Start the camera and return the driver's name and version. Raises DeviceError while it is unplugged."""
        if self._stage.is_out("camera_lost"):
            raise DeviceError("camera: there is no simulated camera: plug it in")
        self._frozen = None
        self._start_s = self._stage.clock.now_s()
        return "simulated-camera 1.0"

    def read(self) -> Frame:
        """Let virtual time pass until the next frame and return it, gray (height, width).

        Raises
        ------
        DeviceError
            The camera is not open, or lost.
        """
        if self._stage.is_out("camera_lost"):
            self._start_s = None
            raise DeviceError("camera: the simulated camera is gone: check its cable")
        if self._start_s is None:
            raise DeviceError("camera: the simulated camera is not open; open it first")
        clock = self._stage.clock
        number = int(np.floor((clock.now_s() - self._start_s) * self._fps + 1e-6)) + 1
        taken_s = self._start_s + number / self._fps
        clock.sleep_s(taken_s - clock.now_s())
        rng = draws(self._stage.scene.seed, "frame", number)
        image = cv2.add(self._clean(taken_s), self._shifted_noise(rng), dtype=cv2.CV_8U)  # rounds and saturates
        stamp_s = taken_s + _STAMP_JITTER_S * abs(float(rng.standard_normal()))
        frame = Frame(np.asarray(image, np.uint8), stamp_s)
        if self._stage.happens("camera_frozen"):
            self._frozen = frame
        return self._frozen or frame

    def close(self) -> None:
        """Stop the camera; safe to call twice."""
        self._start_s = None

    def _drawn_noise(self) -> NDArray[np.float32]:
        """Draw noise for more than a picture: cut out elsewhere for each frame it is as good as new and faster."""
        width, height = self._stage.scene.description.camera.size_px
        rng = draws(self._stage.scene.seed, "pixels")
        noise = rng.standard_normal((height + _SHIFTS, width + _SHIFTS), dtype=np.float32)
        return np.float32(self._stage.scene.description.simulation.image_noise) * noise

    def _shifted_noise(self, rng: np.random.Generator) -> NDArray[np.float32]:
        (down, right), (width, height) = rng.integers(0, _SHIFTS, 2), self._stage.scene.description.camera.size_px
        return self._noise[down : down + height, right : right + width]

    def _clean(self, time_s: float) -> NDArray[np.float32]:
        """Paint the picture, or take the last one while the board stands still."""
        moving, pose = self._stage.is_moving(time_s), self._stage.board_to_camera(time_s)
        if moving:
            return self._picture(pose, moving=True)
        if self._painted is None or self._painted[0] is not pose:
            self._painted = (pose, self._picture(pose, moving=False))
        return self._painted[1]

    def _picture(self, pose: Pose, *, moving: bool) -> NDArray[np.float32]:
        return flawed_picture(self._painter.picture(pose, moving=moving), self._stage)
