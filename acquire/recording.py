"""The recording: everything the devices deliver, on its way into the session file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from acquire.attendance import Attendance
from acquire.clocks import Clocks
from acquire.devices.base import Frame, Rig
from acquire.disk import DiskSpace
from acquire.errors import InterruptedCaptureError, losing
from acquire.film import Film
from acquire.holdups import Cause, HoldUps
from acquire.screen import Screen
from acquire.soundtrack import Soundtrack
from acquire.status import Message, Status
from rigs.description import RigDescription
from rigs.session.writer import SessionWriter

T = TypeVar("T")
_STEP_S = 0.1
_FLUSH_S = 1.0
_LATE_S = 2.0  # a device that is later than that has lost the sound


class Recording:
    """The soundtrack, the film of each pose, and log lines.

    Parameters
    ----------
    rig : Rig
        With its devices open.
    writer : SessionWriter
    description : RigDescription
    screen : Screen
    status : Status
        Kept up to date; the screen shows it.
    stop_wanted : callable
        True once somebody wants the capture to end.

    Attributes
    ----------
    clocks : Clocks
    sound : Soundtrack
    film : Film
    holdups : HoldUps
    """

    def __init__(
        self,
        rig: Rig,
        writer: SessionWriter,
        description: RigDescription,
        screen: Screen,
        status: Status,
        stop_wanted: Callable[[], bool],
    ) -> None:
        self.rig, self.writer, self.status = rig, writer, status
        self._screen, self._stop_wanted = screen, stop_wanted
        self.holdups = HoldUps(rig.clock)
        self.clocks, self.film = Clocks(writer, description), Film(rig.camera, writer, description)
        self.sound = Soundtrack(rig, writer, self.clocks, description, status, self.say, self.holdups)
        self._disk = DiskSpace(Path(status.file), description)
        self._start_s = self._flushed_s = rig.clock.now_s()

    def say(self, level: str, text: str) -> None:
        """Tell the operator, and store it in the log; `level` is "info", "warning" or "error"."""
        self.note(level, text)
        self.tell(level, text)

    def note(self, level: str, text: str) -> None:
        """Store it in the log only."""
        self.writer.append_log(self.rig.clock.now_s(), level, text)

    def tell(self, level: str, text: str) -> None:
        """Tell the operator only."""
        message = Message(self.rig.clock.now_s() - self._start_s, level, text)
        self.status.messages.append(message)
        self._screen.say(message)

    def listen(self) -> None:
        """Store the audio that has come in, and within a pose the frames.

        Raises
        ------
        DeviceLostError
            The sound device failed or fell silent, or the camera is lost.
        DiskShortError
            The disk is nearly full.
        InterruptedCaptureError
            Somebody wants the capture to end.
        """
        self.sound.take()
        self._watch()
        self._go_on()

    def attend(self, part: str, call: Callable[[], T], *, is_open: bool = True) -> T:
        """Return what a device's call returns, and store what the others deliver while it waits.

        Parameters
        ----------
        part : str
            The device: "trigger", "audio" or "camera".
        call : callable
        is_open : bool
            False while the device is being opened, so that it delivers nothing.

        Raises
        ------
        DeviceError
            What the call raised.
        DeviceLostError
            Another device was lost meanwhile.
        DiskShortError, InterruptedCaptureError
            At once; nobody waits for the call any longer.
        """
        takes = {"audio": self.sound.take, "camera": self._watch}
        if not is_open:
            takes.pop(part, None)
        attendance = Attendance(self.status, self.rig.clock, part, [*takes.values(), self._go_on])
        with attendance:
            outcome = self.rig.clock.wait_for(call, attendance.glance)
        attendance.check()
        return outcome

    def idle(self, duration_s: float) -> None:
        """Let time pass without a sound device. Raises as `listen` does, but for the sound device."""
        self.rig.clock.sleep_s(duration_s)
        self._watch()
        self._go_on()

    def reopened(self, part: str) -> None:
        """Take note that a device was lost and is open again: "trigger", "audio" or "camera"."""
        if part == "audio":
            self.sound.reopened()

    def look(self) -> Frame:
        """Return the camera's next frame. Raises DeviceLostError, and as `listen` does."""
        with losing("camera"):
            frame = self.attend("camera", self.rig.camera.read)
        self.listen()
        return frame

    def record(self, duration_s: float) -> None:
        """Let time pass, storing what comes in. Raises as `listen` does."""
        end_s = self.rig.clock.now_s() + duration_s
        while (left_s := end_s - self.rig.clock.now_s()) > 1e-6:
            self.rig.clock.sleep_s(min(_STEP_S, left_s))
            self.listen()

    def record_until(self, sample: int) -> None:
        """Record until a row of the recording is in, which comes later than its time, and nothing is in doubt."""
        end_s = self.rig.clock.now_s() + _LATE_S
        while self.writer.n_samples < sample or self.clocks.is_in_doubt:
            if self.rig.clock.now_s() > end_s:
                return
            self.record(_STEP_S)

    def flush(self) -> None:
        """Bring everything recorded so far safely into the file."""
        with self.holdups.during(Cause.DISK):
            self.writer.flush()
        self._flushed_s = self.rig.clock.now_s()

    def _watch(self) -> None:
        """Store the frames that have come in, within a pose."""
        with losing("camera"):
            self.film.store()

    def _go_on(self) -> None:
        """Flush and show what there is, unless this is the end."""
        if self._stop_wanted():
            raise InterruptedCaptureError("stopped on request")
        now_s = self.rig.clock.now_s()
        if now_s - self._flushed_s >= _FLUSH_S:
            self.flush()
            self._disk.check()
        self.status.time_s = now_s - self._start_s
        self._screen.show(self.status)
