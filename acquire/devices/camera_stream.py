"""The stream of a camera's pictures: a thread that takes every one as it comes, so that none is ever stale."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.devices.base import Frame
from acquire.devices.camera_backlog import Backlog, Sleep
from acquire.devices.frame_queue import FrameQueue
from acquire.errors import DeviceError
from rigs.errors import reason

Picture = NDArray[np.uint8]
_LOOK_S = 0.2  # between pictures that are looked at although nobody asked for one
_FROZEN_S = 1.0
_FROZEN_PICTURES = 4
_JOIN_S = 1.0
_CATCH_UP_S = 8.0  # so long may all pictures that come be old
_LOST = "lost, it sends no more pictures: check its cable, its power and the network"
_PLAYED = "played to its end: give a longer recording, or a camera"


class Pictures(Protocol):
    """What a stream draws from, as `cv2.VideoCapture` has it."""

    def grab(self) -> bool:
        """Wait for the next picture; False where there is none any more."""

    def retrieve(self) -> tuple[bool, Any]:
        """Decode the picture that was grabbed last."""

    def release(self) -> None:
        """Let go of the source."""


class Repetition:
    """Counts how often and how long a picture has been the same, bit by bit; a live sensor's noise forbids it."""

    def __init__(self) -> None:
        self._last: Picture | None = None
        self._since_s, self._n_same = 0.0, 0

    def see(self, picture: Picture, time_s: float) -> bool:
        """Take a picture, and tell whether the camera is frozen."""
        if self._last is None or not np.array_equal(picture, self._last):
            self._last, self._since_s, self._n_same = picture, time_s, 1
            return False
        self._n_same += 1
        return time_s - self._since_s >= _FROZEN_S and self._n_same >= _FROZEN_PICTURES


class PictureStream:
    """Grabs pictures in a thread of its own, hands over the newest, and fills a queue in its rhythm.

    A picture is decoded only when somebody wants it, or when it is time to look whether the camera is frozen.
    All calls into a driver are made in the thread: one that hangs there for ever holds up nobody else.

    Parameters
    ----------
    start : callable
        Opens the source; may take long and raise DeviceError.
    label : str
        What messages call the source.
    is_live : bool
        A camera: it never ends by itself, and when its pictures repeat themselves it is frozen.
    fps : float
        How many pictures a second are expected.

    Attributes
    ----------
    grabbed : (int, float)
        How many pictures have come in, decoded or not, and the host monotonic time of the last.
    queue : FrameQueue or None
        Gets every frame that is due in it.
    """

    def __init__(self, start: Callable[[], Pictures], label: str, *, is_live: bool, fps: float) -> None:
        self.grabbed = (0, 0.0)
        self.queue: FrameQueue | None = None
        self._start, self._label = start, label
        self._over = _LOST if is_live else _PLAYED
        self._repetition = Repetition() if is_live else None
        self._backlog = Backlog(1 / fps) if is_live else None
        self._changed = threading.Condition()
        self._frame: Frame | None = None
        self._wanted, self._frozen, self._stopping = True, False, False
        self._end: str | None = None  # why no more pictures come
        self._looked_s = float("-inf")
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()

    def next_frame(self, timeout_s: float) -> Frame:
        """Return the first frame that comes in after this call.

        Raises
        ------
        DeviceError
            None came in time, the stream has ended, or it is frozen.
        """
        asked_s = time.monotonic()
        with self._changed:
            self._wanted = True
            self._changed.wait_for(lambda: self._end or self._frozen or self._is_newer(asked_s), timeout_s)
            if not self._end and not self._is_newer(asked_s) and self.grabbed[1] > asked_s:  # old ones come
                self._changed.wait_for(lambda: self._end or self._is_newer(asked_s), _CATCH_UP_S - timeout_s)
            return self._newer_frame(asked_s, timeout_s)

    def check(self, timeout_s: float) -> None:
        """See that pictures come, and new ones now and then. Raises as `next_frame` does, without waiting."""
        now_s = time.monotonic()
        with self._changed:
            old_ones_come = self.grabbed[1] > now_s - timeout_s
            self._newer_frame(now_s - (_CATCH_UP_S if old_ones_come else timeout_s), timeout_s)

    def stop(self) -> None:
        """End the thread; one that hangs in a driver is left behind and lets go when the driver does."""
        self._stopping = True
        self._thread.join(_JOIN_S)

    def _is_newer(self, time_s: float) -> bool:
        return self._frame is not None and self._frame.host_time_s > time_s

    def _newer_frame(self, time_s: float, timeout_s: float) -> Frame:
        if self._end:
            raise DeviceError(self._end)
        if self._frozen:
            raise DeviceError(
                f"{self._label}: frozen, it has sent the same picture for {_FROZEN_S:g} s: take the cap off its "
                "lens, or unplug it once"
            )
        if not self._is_newer(time_s) and self.grabbed[1] > time_s:
            raise DeviceError(
                f"{self._label}: its pictures come late, as this computer or the network is too slow for so many: "
                "close other programs, lower the camera's rate and camera.fps, or choose a smaller size"
            )
        if self._frame is None or not self._is_newer(time_s):
            raise DeviceError(
                f"{self._label}: no picture for {timeout_s:g} s: check its cable, its power, and that no other "
                "program uses it"
            )
        return self._frame

    def _run(self) -> None:
        try:
            with ExitStack() as stack:
                pictures = self._start()
                stack.callback(pictures.release)
                while not self._stopping and self._grab(pictures):
                    pass
        except DeviceError as error:
            self._finish(str(error))
        except cv2.error as error:
            self._finish(f"{self._label}: OpenCV cannot read it ({error.err}): check the camera, and start again")
        except OSError as error:
            self._finish(f"{self._label}: cannot be read ({reason(error)}): check it, and start again")

    def _grab(self, pictures: Pictures) -> bool:
        """Take the next picture in, and tell whether there was one."""
        sleep = Sleep()
        if not pictures.grab():
            self._finish(f"{self._label}: {self._over}")
            return False
        now_s = time.monotonic()
        self.grabbed = (self.grabbed[0] + 1, now_s)
        if self._backlog is not None and not self._backlog.is_new(now_s, sleep.slept_s()):
            return True
        queue = self.queue
        is_due = queue is not None and queue.is_due(now_s)
        if self._wanted or is_due or now_s - self._looked_s >= _LOOK_S:
            self._looked_s = now_s
            good, picture = pictures.retrieve()
            if good:  # one damaged picture is no loss: the next is awaited
                frame = Frame(np.asarray(picture, dtype=np.uint8), now_s)
                self._take(frame)
                if queue is not None and is_due:
                    queue.put(frame)
        return True

    def _take(self, frame: Frame) -> None:
        frozen = self._repetition is not None and self._repetition.see(frame.image, frame.host_time_s)
        with self._changed:
            self._frame, self._frozen, self._wanted = frame, frozen, False
            self._changed.notify_all()

    def _finish(self, why: str) -> None:
        with self._changed:
            self._end = why
            self._changed.notify_all()
