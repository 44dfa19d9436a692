"""The simulated camera."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.devices.base import Frame, Rhythm
from acquire.devices.frame_queue import FrameQueue
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
        self._number = 0  # of the newest frame that was taken or passed over
        self._queue: FrameQueue | None = None
        self._painted: tuple[Pose, NDArray[np.float32]] | None = None

    def open(self) -> str:
        """Start the camera and return the driver's name and version. Raises DeviceError while it is unplugged."""
        if self._stage.is_out("camera_lost"):
            raise DeviceError("camera: there is no simulated camera: plug it in")
        self._start_s, self._number = self._stage.clock.now_s(), 0
        return "simulated-camera 1.0"

    def read(self) -> Frame:
        """Let virtual time pass until the next frame and return it, gray (height, width).

        Raises
        ------
        DeviceError
            The camera is not open, lost, or frozen.
        """
        start_s, clock = self._checked_start_s(), self._stage.clock
        self._collect_until(self._n_taken(start_s), start_s)
        taken_s = start_s + (self._n_taken(start_s) + 1) / self._fps
        clock.sleep_s(taken_s - clock.now_s())
        self._collect_until(self._n_taken(start_s), start_s)
        return self._frame(self._number, taken_s)

    def collect(self, rhythm: Rhythm | None) -> int:
        """Collect frames from now on, also after it was lost and opened again; None: no more, and forget them.

        Returns how many were due until now and are missing, beyond those of which the collected frames tell.
        """
        ended, self._queue = self._queue, None if rhythm is None else FrameQueue(rhythm)
        return 0 if ended is None else ended.n_missing_at(self._stage.clock.now_s())

    def collected(self) -> list[Frame]:
        """Return the frames of the virtual time that has passed; none while it is closed. Raises as `read` does."""
        if self._start_s is not None:
            start_s = self._checked_start_s()
            self._collect_until(self._n_taken(start_s), start_s)
        return self._queue.take() if self._queue is not None else []

    def close(self) -> None:
        """Stop the camera; safe to call twice."""
        self._start_s = None

    def _checked_start_s(self) -> float:
        if self._stage.is_out("camera_lost"):
            self._start_s = None
            raise DeviceError("camera: the simulated camera is gone: check its cable")
        if self._start_s is None:
            raise DeviceError("camera: the simulated camera is not open; open it first")
        if self._stage.happens("camera_frozen"):
            raise DeviceError("camera: the simulated camera is frozen: take the cap off its lens, or unplug it once")
        return self._start_s

    def _n_taken(self, start_s: float) -> int:
        """Return how many frames the camera has taken by now."""
        return int(np.floor((self._stage.clock.now_s() - start_s) * self._fps + 1e-6))

    def _collect_until(self, number: int, start_s: float) -> None:
        """Queue what is due of the frames up to this one."""
        while self._number < number:
            self._number += 1
            taken_s = start_s + self._number / self._fps
            if self._queue is not None and self._queue.is_due(taken_s):
                self._queue.put(self._frame(self._number, taken_s))

    def _frame(self, number: int, taken_s: float) -> Frame:
        rng = draws(self._stage.scene.seed, "frame", number)
        image = cv2.add(self._clean(taken_s), self._shifted_noise(rng), dtype=cv2.CV_8U)  # rounds and saturates
        stamp_s = taken_s + _STAMP_JITTER_S * abs(float(rng.standard_normal()))
        return Frame(np.asarray(image, np.uint8), stamp_s)

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
