"""The film of a pose: its frames in a steady rhythm, from before the first buzzer to after the last."""

from __future__ import annotations

from contextlib import suppress

from acquire.devices.base import Camera, Frame, Rhythm
from acquire.errors import DeviceError
from rigs.description import RigDescription
from rigs.session.writer import SessionWriter

_FRAMES_AGAIN = 3  # of a pose, that somebody wants to look at once more


class SpreadFrames:
    """A few of the frames that come in, spread over all of them, however many they are.

    Parameters
    ----------
    most : int
        How many are held at most.

    Attributes
    ----------
    frames : list of Frame
    """

    def __init__(self, most: int) -> None:
        self.frames: list[Frame] = []
        self._most, self._every, self._n_seen = most, 1, 0

    def add(self, frame: Frame) -> None:
        """Hold the frame, or not; where there are too many, every other one is let go."""
        if self._n_seen % self._every == 0:
            self.frames.append(frame)
        if len(self.frames) > self._most:
            self.frames, self._every = self.frames[::2], 2 * self._every
        self._n_seen += 1


class Film:
    """Stores the frames of a pose; the camera collects them, so none is lost while capture is busy.

    Parameters
    ----------
    camera : Camera
    writer : SessionWriter
    description : RigDescription

    Attributes
    ----------
    n_frames, n_missing : int
        Stored in all poses so far, and missing from the rhythm.
    """

    def __init__(self, camera: Camera, writer: SessionWriter, description: RigDescription) -> None:
        self._camera, self._writer = camera, writer
        self._interval_s = max(description.capture.frame_interval_s, 1 / description.camera.fps)
        self._pose = -1
        self._is_running = False
        self._spread = SpreadFrames(_FRAMES_AGAIN)
        self.n_frames = self.n_missing = 0

    def begin(self, first: Frame, pose: int) -> None:
        """Store the first frame, and have the camera collect those that follow."""
        self._pose, self._spread, self._is_running = pose, SpreadFrames(_FRAMES_AGAIN), True
        self._camera.collect(Rhythm(first.host_time_s, self._interval_s))
        self.keep(first)

    def store(self) -> None:
        """Store what the camera has collected. Raises DeviceError where it is lost."""
        if not self._is_running:
            return
        for frame in self._camera.collected():
            self._spread.add(frame)
            self.keep(frame)

    def keep(self, frame: Frame) -> None:
        """Store one frame of the pose."""
        self._writer.append_frame(frame.image, host_time_s=frame.host_time_s, pose=self._pose)
        self.n_frames += 1
        self.n_missing += frame.n_missing

    def end(self) -> list[Frame]:
        """Store what is left, and return a few frames spread over the pose; safe to call twice."""
        with suppress(DeviceError):  # whoever wants another frame will be told
            self.store()
        self.n_missing += self._camera.collect(None)
        self._is_running = False
        return self._spread.frames

    def in_words(self) -> str:
        """Say how many frames were stored in all poses."""
        return f"{self.n_frames} frames stored, {self.n_missing or 'none'} missing"
