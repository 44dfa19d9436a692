"""A camera that OpenCV reads: at a USB port, in the network, or recorded."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import cv2

from acquire.devices.base import Frame, Rhythm
from acquire.devices.camera_lock import lock_controls
from acquire.devices.camera_recorded import Paced, PictureFolder
from acquire.devices.camera_source import CameraSource, SourceKind, camera_source
from acquire.devices.camera_stream import Pictures, PictureStream
from acquire.devices.frame_queue import FrameQueue
from acquire.devices.jpeg_complaints import Quiet
from acquire.errors import DeviceError
from rigs.description import Camera

_OPEN_TIMEOUT_S, _READ_TIMEOUT_S, _FIRST_PICTURE_S = 5.0, 2.0, 8.0
_RATE_PICTURES, _RATE_S = 10, 1.0
_SLOW = 0.8  # of the rate that the rig wants
_LOCKED_ELSEWHERE = (
    "exposure and focus cannot be locked over the network: lock them on the camera's own page, and set "
    "camera.exposure.locked to false"
)
_QUIET = {  # libraries that would write over the operator's screen, and a driver's own time-out
    "OPENCV_FFMPEG_LOGLEVEL": "-8",
    "OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT": "2",
}
_REMEDIES = {
    SourceKind.DEVICE: "no camera there, or another program uses it: check its cable, and camera.source",
    SourceKind.ADDRESS: "no stream from this address: check the address, its user name and password, and the network",
    SourceKind.FILE: "not a video that OpenCV can read: try another format, such as MJPEG in .avi",
}


class OpenCvCamera:
    """Reads a camera, and tells what its driver refuses.

    A live camera is drained all the time, so that `read` never returns what a driver had stored up. Files and folders
    are played once, at their own pace.

    Parameters
    ----------
    description : Camera

    Attributes
    ----------
    warnings : list of str
        What the driver refused when the camera was opened last; capture tells the operator and the session's log.
    """

    def __init__(self, description: Camera) -> None:
        assert description.source is not None  # the description sees to it
        self._description, self._source = description, camera_source(description.source)
        self._stream: PictureStream | None = None
        self._queue: FrameQueue | None = None  # outlives the stream
        self._driver, self._told_fps = "", 0.0
        self._timeout_s = max(_READ_TIMEOUT_S, 3 / description.fps)
        self.warnings: list[str] = []

    @property
    def n_grabbed(self) -> int:
        """Return how many pictures have come in since the camera was opened."""
        return self._stream.grabbed[0] if self._stream else 0

    def open(self) -> str:
        """Start the camera and return the driver, the source and what was read back.

        Raises
        ------
        DeviceError
            Nothing there, no permission, no picture in time, or pictures of another size.
        """
        self.close()
        self.warnings = []
        fps = self._description.fps
        self._stream = PictureStream(self._start, self._source.label, is_live=self._source.is_live, fps=fps)
        self._stream.queue = self._queue
        try:
            first = self._stream.next_frame(_FIRST_PICTURE_S)
            self._check_size(first)
            rate = self._rate_told(self._stream) if self._source.is_live else f"{self._told_fps:.3g}"
        except BaseException:
            self.close()
            raise
        width, height = self._description.size_px
        return f"{self._driver} {cv2.__version__}, {self._source.label}, {width} x {height} at {rate} pictures/s"

    def read(self) -> Frame:
        """Wait for the next picture and return it; its time is taken right after it came in.

        Raises
        ------
        DeviceError
            The camera is not open, lost, frozen, or sends nothing; a recording has ended.
        """
        if self._stream is None:
            raise DeviceError(f"{self._source.label}: the camera is not open; open it first")
        return self._stream.next_frame(self._timeout_s)

    def collect(self, rhythm: Rhythm | None) -> int:
        """Collect frames from now on, also after it was lost and opened again; None: no more, and forget them.

        Returns how many were due until now and are missing, beyond those of which the collected frames tell.
        """
        ended, self._queue = self._queue, None if rhythm is None else FrameQueue(rhythm)
        if self._stream is not None:
            self._stream.queue = self._queue
        return 0 if ended is None else ended.n_missing_at(time.monotonic())

    def collected(self) -> list[Frame]:
        """Return the frames collected since the last call; none while it is closed.

        Raises
        ------
        DeviceError
            The camera is lost, frozen, or sends nothing, and no frame is left; a recording has ended.
        """
        frames = self._queue.take() if self._queue is not None else []
        if not frames and self._stream is not None:
            self._stream.check(self._timeout_s)
        return frames

    def close(self) -> None:
        """Stop the camera; safe to call twice."""
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.stop()

    def _start(self) -> Pictures:
        """Open the source; runs in the stream's thread."""
        source, fps = self._source, self._description.fps
        self._driver, self._told_fps = "opencv", fps
        if source.kind is SourceKind.FOLDER:
            return Paced(Quiet(PictureFolder(Path(str(source.place)))), fps)
        capture = _opened(source)
        self._driver = f"opencv-{capture.getBackendName().lower()}"
        if source.kind is SourceKind.FILE:
            self._told_fps = capture.get(cv2.CAP_PROP_FPS) or fps
            return Paced(capture, self._told_fps)
        if source.kind is SourceKind.ADDRESS:
            self._warn([_LOCKED_ELSEWHERE] if self._description.exposure.locked else [])
            return capture
        _choose_mode(capture, self._description)
        self._warn(lock_controls(capture, self._description.exposure))
        return Quiet(capture)

    def _warn(self, refusals: list[str]) -> None:
        self.warnings += [f"{self._source.label}: {refusal}" for refusal in refusals]

    def _check_size(self, frame: Frame) -> None:
        height, width = frame.image.shape[:2]
        wanted = self._description.size_px
        if (width, height) != wanted:
            raise DeviceError(
                f"{self._source.label}: sends pictures of {width} x {height} pixels, camera.size_px wants "
                f"{wanted[0]} x {wanted[1]}: choose a size that the camera has"
            )

    def _rate_told(self, stream: PictureStream) -> str:
        """Measure the rate, which no driver tells truly; a slow one is warned of."""
        n_first, first_s = n_last, last_s = stream.grabbed
        while n_last - n_first < _RATE_PICTURES and last_s - first_s < _RATE_S:
            stream.next_frame(self._timeout_s)
            n_last, last_s = stream.grabbed
        rate_hz = (n_last - n_first) / (last_s - first_s)
        if rate_hz < _SLOW * self._description.fps:
            self.warnings.append(
                f"{self._source.label}: {rate_hz:.3g} pictures/s although camera.fps wants {self._description.fps:g}: "
                "give it more light, a smaller size, or a USB port of its own"
            )
        return f"{rate_hz:.3g}"


def _opened(source: CameraSource) -> cv2.VideoCapture:
    """Open a source with OpenCV, quietly and within a time where the driver knows one."""
    for name, value in _QUIET.items():
        os.environ.setdefault(name, value)
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    _check_there(source)
    if source.kind in (SourceKind.ADDRESS, SourceKind.FILE):
        times = {cv2.CAP_PROP_OPEN_TIMEOUT_MSEC: _OPEN_TIMEOUT_S, cv2.CAP_PROP_READ_TIMEOUT_MSEC: _READ_TIMEOUT_S}
        settings = [number for prop, time_s in times.items() for number in (prop, int(time_s * 1000))]
        capture = cv2.VideoCapture(str(source.place), cv2.CAP_FFMPEG, settings)
    elif source.kind is SourceKind.DEVICE and sys.platform == "linux":
        capture = cv2.VideoCapture(source.place, cv2.CAP_V4L2)
    else:
        capture = cv2.VideoCapture(source.place)
    if not capture.isOpened():
        raise DeviceError(f"{source.label}: {_REMEDIES[source.kind]}")
    return capture


def _check_there(source: CameraSource) -> None:
    """Say what a driver would not: that there is nothing, or that it must not be read."""
    if source.kind is SourceKind.ADDRESS or (source.kind is SourceKind.DEVICE and sys.platform != "linux"):
        return
    path = Path(f"/dev/video{source.place}" if isinstance(source.place, int) else source.place)
    if not path.exists():
        what = "camera: check its cable, and camera.source" if source.kind is SourceKind.DEVICE else "file or folder"
        raise DeviceError(f"{path}: there is no such {what}")
    if not os.access(path, os.R_OK):
        remedy = "add yourself to the group video" if source.kind is SourceKind.DEVICE else "ask its owner"
        raise DeviceError(f"{path}: no permission to read it: {remedy}")


def _choose_mode(capture: cv2.VideoCapture, wanted: Camera) -> None:
    """Ask for size and rate; where raw pictures are too many for the cable, for those that the camera compressed."""
    _set_mode(capture, wanted)
    told = [capture.get(prop) for prop in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)]
    if told != list(wanted.size_px) or 0 < capture.get(cv2.CAP_PROP_FPS) < _SLOW * wanted.fps:
        capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG"))
        _set_mode(capture, wanted)


def _set_mode(capture: cv2.VideoCapture, wanted: Camera) -> None:
    capture.set(cv2.CAP_PROP_FRAME_WIDTH, wanted.size_px[0])
    capture.set(cv2.CAP_PROP_FRAME_HEIGHT, wanted.size_px[1])
    capture.set(cv2.CAP_PROP_FPS, wanted.fps)
