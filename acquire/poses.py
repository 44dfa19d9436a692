"""The poses of a session: for each, wait for a still board, fire the buzzers, and see that the board stayed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from acquire.devices.base import Frame
from acquire.emissions import ChannelFaults, Emissions
from acquire.errors import CaptureQualityError, DeviceLostError
from acquire.holdups import Cause
from acquire.reconnection import Reconnection
from acquire.recording import Recording
from acquire.resume import Resumption
from acquire.sharpness import edge_blur_px
from acquire.soundtrack import VOID
from acquire.status import CHANNEL_REMEDIES, State
from acquire.stillness import Sight, StillBoard
from rigs.board import find_corners, movement_px
from rigs.description import RigDescription

FloatArray = NDArray[np.float64]
_MAX_UNHEARD_POSES = 3
_LOOK_PAUSE_S = 0.15  # the search for corners is most of the work of a capture
_ADVICE = {
    Sight.MISSING: "bring the whole board into the picture, evenly lit and without glare",
    Sight.SAME_PLACE: "move the board to a place where it has not been",
    Sight.MOVING: "let the board stand still",
    Sight.SETTLING: "let the board stand still",
    Sight.BLURRED: "focus the camera on the board, light it better, and hold it still",
    Sight.STILL: "leave the board where it is and keep quiet",
}
_STAND = "put it on a stand, or raise capture.still_px if only the picture's noise moves the corners"
_SHARPEN = f"{_ADVICE[Sight.BLURRED]}, or raise capture.max_blur_px if the lens cannot do better"
_TIMEOUT_REMEDIES = {Sight.MOVING: _STAND, Sight.SETTLING: _STAND, Sight.BLURRED: _SHARPEN}
_UNHEARD = "no emission was good: check the buzzers' power and the microphones"
_UNSURE = "its emissions disagree on the latency of the audio: keep the room quiet and nothing else playing"


class Poses:
    """Captures pose after pose, and counts the good ones in the status.

    Parameters
    ----------
    recording : Recording
    description : RigDescription
    earlier : Resumption, optional
        What a session that goes on holds already.
    """

    def __init__(self, recording: Recording, description: RigDescription, earlier: Resumption | None = None) -> None:
        self._recording, self._status, self._clock = recording, recording.status, recording.rig.clock
        self._board, self._limits = description.board, description.capture
        self._reconnection = Reconnection(recording, description)
        self._emissions = Emissions(recording, description, self._reconnection)
        self._shots = [
            (n, buzzer.id) for n in range(description.signal.repeats) for buzzer in description.board.buzzers
        ]
        # counts attempts: a place that is captured again gets a number of its own
        self._pose = earlier.recovery.next_pose if earlier else 0
        self._again = False  # the last attempt failed, so the same place is wanted
        self._unheard_poses = 0
        self._earlier_px: list[FloatArray] = list(earlier.corners_px) if earlier else []  # of each good pose

    def capture_all(self) -> None:
        """Capture until enough poses are good; what a lost device has spoilt is captured again.

        Raises
        ------
        DeviceError, FirmwareError, DiskShortError, InterruptedCaptureError
        CaptureQualityError
            The board was not found still at a new place in time, or nothing was heard again and again.
        """
        while self._status.saved < self._status.poses:
            try:
                self._capture_next()
            except DeviceLostError as loss:
                self._status.buzzer = None
                self._reconnection.restore(loss)

    def _capture_next(self) -> None:
        frame, corners_px = self._wait_for_still_board()
        self._again = True  # until it is known to be good
        try:
            is_good = self._capture_pose(frame, corners_px)
        finally:
            self._pose += 1
        if is_good:
            self._again = False
            self._earlier_px.append(corners_px)
            self._status.saved += 1
            self._reconnection.forgive()

    def _wait_for_still_board(self) -> tuple[Frame, FloatArray]:
        """Return the picture in which the board has come to rest at a new place, and its corners."""
        self._recording.rig.operator.ask_for_pose(self._status.saved)
        request = "let it stand still where it is" if self._again else "move it to a new place and let it stand still"
        self._recording.say("info", f"{self._status.pose_label()}, board: {request}")
        watch = StillBoard(self._limits, self._earlier_px)
        end_s = self._clock.now_s() + self._limits.pose_timeout_s
        sight = Sight.MISSING
        while self._clock.now_s() < end_s:
            frame, corners_px = self._look()
            sight, figure_px = watch.see(corners_px, frame.host_time_s), watch.movement_px
            if sight is Sight.STILL and corners_px is not None:
                figure_px = edge_blur_px(frame.image, corners_px, self._board)
                sight = Sight.STILL if figure_px <= self._limits.max_blur_px else Sight.BLURRED
            self._show(sight, figure_px)
            if self._recording.sound.is_ready() and sight is Sight.STILL and corners_px is not None:
                return frame, corners_px
            self._recording.record(min(self._limits.still_s / 3, _LOOK_PAUSE_S))
        raise CaptureQualityError(
            f"{self._status.pose_label()}: after {self._limits.pose_timeout_s:g} s the board is {self._status.board}: "
            f"{_TIMEOUT_REMEDIES.get(sight, _ADVICE[sight])}"
        )

    def _capture_pose(self, first: Frame, corners_px: FloatArray) -> bool:
        """Fire all buzzers, and return whether the pose is good; it is stored either way, an interrupted one too."""
        accepted = False
        film = self._recording.film
        n_missing = film.n_missing
        film.begin(first, self._pose)
        try:
            changes = self._recording.clocks.latency.changes
            n_good = self._fire_all()
            accepted = self._was_heard(n_good, changes) and self._has_stayed(corners_px)
            self._note_missing(film.n_missing - n_missing)
        finally:
            film.end()
            self._recording.writer.append_pose(
                pose=self._pose,
                start_host_time_s=first.host_time_s,
                end_host_time_s=self._clock.now_s(),
                accepted=accepted,
            )
            self._recording.flush()
        if accepted:
            self._recording.say(
                "info", f"{self._status.pose_label()} is good: {n_good} of {len(self._shots)} emissions heard"
            )
        return accepted

    def _fire_all(self) -> int:
        """Fire every buzzer in turn, note what ails single channels, and return how many emissions were good."""
        faults = []
        for number, (repeat, buzzer) in enumerate(self._shots, start=1):
            self._status.buzzer, self._status.emission = buzzer, number
            faults.append(self._emissions.fire(self._pose, buzzer, repeat))
            self._status.fired[buzzer] += 1
            self._status.missed[buzzer] += faults[-1] is None
        self._status.buzzer = None
        heard = [each for each in faults if each is not None]
        if heard:
            self._note_channels(frozenset.intersection(*heard))
        return len(heard)

    def _note_channels(self, faults: ChannelFaults) -> None:
        """Warn of channels that had the same fault in every emission of the pose, once until it changes."""
        now = {self._status.channels[column]: kind for column, kind in sorted(faults)}
        for channel, kind in now.items():
            if self._status.faults.get(channel) != kind:
                self._recording.say(
                    "warning", f"channel {channel} is {kind} in every emission: {CHANNEL_REMEDIES[kind]}"
                )
        for channel in self._status.faults.keys() - now.keys():
            self._recording.say("info", f"channel {channel} is good again")
        self._status.faults = now

    def _was_heard(self, n_good: int, changes: int) -> bool:
        """Tell whether the emissions count; `changes` is how often the latency had changed before them."""
        latency = self._recording.clocks.latency
        if n_good and latency.is_confirmed and latency.changes == changes:
            self._unheard_poses = 0
            return True
        self._unheard_poses += 1
        unheard = VOID if self._recording.sound.is_void else _UNHEARD
        line = f"{self._status.pose_label()}: {_UNSURE if n_good else unheard}"
        if self._unheard_poses >= _MAX_UNHEARD_POSES:
            raise CaptureQualityError(f"{line}; given up after {_MAX_UNHEARD_POSES} times")
        self._recording.say("warning", f"{line}; the same place again")
        return False

    def _note_missing(self, n_frames: int) -> None:
        if n_frames:
            self._recording.say(
                "warning",
                f"{self._status.pose_label()}: {n_frames} of its frames are missing, the camera or the computer is too "
                "slow: close other programs, give it more light or a USB port of its own",
            )

    def _has_stayed(self, first_px: FloatArray) -> bool:
        """Tell from some frames of the pose, and from one more that is stored, whether the board is where it was."""
        self._status.state = State.COMPARING
        film = self._recording.film
        between, last = film.end(), self._recording.look()
        film.keep(last)
        for frame in (*between, last):
            corners_px = self._found(frame)
            self._recording.listen()
            moved_px = float("inf") if corners_px is None else movement_px(corners_px, first_px)
            if not moved_px < self._limits.still_px:
                what = "was lost from sight" if corners_px is None else f"moved by {moved_px:.1f} px"
                self._recording.say(
                    "warning",
                    f"{self._status.pose_label()}: the board {what} while the buzzers sounded; the same place again",
                )
                return False
        return True

    def _look(self) -> tuple[Frame, FloatArray | None]:
        frame = self._recording.look()
        return frame, self._found(frame)

    def _found(self, frame: Frame) -> FloatArray | None:
        with self._recording.holdups.during(Cause.PICTURES):
            return find_corners(frame.image, self._board)

    def _show(self, sight: Sight, figure_px: float) -> None:
        found = sight in (Sight.MOVING, Sight.SETTLING, Sight.BLURRED, Sight.STILL)
        self._status.state = State.SETTLING if found else State.WAITING
        what = "blur" if sight in (Sight.BLURRED, Sight.STILL) else "moved by"
        self._status.board = f"{sight.value} ({what} {figure_px:.2f} px)" if found else sight.value
        self._status.advice = _ADVICE[sight]
