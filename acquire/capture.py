"""One capture, from the rig description to a closed session file; its states are drawn in docs/capture.md."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import cv2
import h5py
import numpy as np
from numpy.typing import NDArray

from acquire.devices.base import Rig
from acquire.devices.choose import choose_devices
from acquire.disk import DiskSpace
from acquire.errors import CaptureError, CaptureQualityError, DeviceError, InterruptedCaptureError
from acquire.poses import Poses
from acquire.recording import Recording
from acquire.resume import POSES, SEED, Resumption, resume
from acquire.screen import Screen
from acquire.status import State, Status
from rigs import __version__
from rigs.description import RigDescription
from rigs.errors import SessionWriteError
from rigs.library import FoundDescription
from rigs.session.good_part import Watch
from rigs.session.writer import SessionWriter
from rigs.target import check_target

_READDRESS = "; if it has another address now, name a rig description that says so: --resume --rig PATH"


def capture(
    found: FoundDescription,
    path: Path,
    *,
    screen: Screen,
    poses: int | None = None,
    seed: int | None = None,
    stop_wanted: Callable[[], bool] = lambda: False,
    resumes: bool = False,
) -> Status:
    """Capture one session.

    Parameters
    ----------
    found : FoundDescription
    path : Path
        The session file to make.
    screen : Screen
    poses : int, optional
        How many, instead of what the description says.
    seed : int, optional
        Of the simulated rig.
    stop_wanted : callable
        Asked again and again; True ends the capture.
    resumes : bool
        Go on with the session that is at `path`, whose description `found` is.

    Returns
    -------
    Status
        How it ended.

    Raises
    ------
    rigs.errors.TargetError
        The file is there already, or cannot be made; no device was touched.
    rigs.errors.RigError
        A session cannot go on as it is asked to.
    rigs.errors.SessionWriteError
        The disk is full or lost; what was flushed before is kept.
    DeviceError, FirmwareError
        A device is missing or was lost; as for all errors below, what came before is saved in a closed file.
    DiskShortError
        The disk is nearly full, or the folder is gone; before any device was touched, or with all that was recorded in
        a closed file.
    CaptureQualityError
        The board was not found, or nothing was heard.
    InterruptedCaptureError
        Somebody wanted it to end.
    """
    description = _with_poses(found.description, poses)
    status, space = _status(description, path), DiskSpace(path, description)
    if resumes:
        space.check(also_bytes=path.stat().st_size)
    else:
        check_target(path)
        space.check()
    rig = choose_devices(description, seed=seed)
    watch = _interruptible(screen, stop_wanted, path)
    earlier = resume(path, rig.truth, description, description.capture.poses, watch) if resumes else None
    with _telling_what_is_saved(status), ExitStack() as stack:
        if earlier is not None:
            status.saved, status.earlier_s = earlier.recovery.n_accepted, earlier.recovery.duration_s
            stack.enter_context(earlier.writer)  # discards the copy when a device is missing
        versions = stack.enter_context(_opened(rig, stop_wanted, _READDRESS if resumes else ""))
        if rig.truth is not None:
            versions[SEED] = str(description.simulation.seed if seed is None else seed)
        versions[POSES] = str(description.capture.poses)
        writer = earlier.writer if earlier else stack.enter_context(_new_session(path, found, rig, versions))
        recording = Recording(rig, writer, description, screen, status, stop_wanted)
        if earlier is not None:
            _go_on(earlier, recording, versions)
        _warn(recording, space)
        _capture_poses(Poses(recording, description, earlier), recording)
    return status


def _capture_poses(poses: Poses, recording: Recording) -> None:
    """Capture all poses, and close the file well however that ends."""
    status = recording.status
    try:
        poses.capture_all()
    except CaptureError as error:
        level = "info" if isinstance(error, InterruptedCaptureError) else "error"
        _end(recording, _end_state(error), level, str(error))  # whoever called tells the operator
        raise type(error)(_last_line(error, status)) from error
    _end(recording, State.FINISHED, "info", saved_line(status))
    recording.tell("info", saved_line(status))


def _warn(recording: Recording, space: DiskSpace) -> None:
    """Say what is doubtful from the start, and store what is known of the camera's clock."""
    rig, doubt = recording.rig, space.doubt()
    for warning in (*rig.camera.warnings, *([doubt] if doubt else [])):
        recording.say("warning", warning)
    recording.clocks.store_camera(rig.clock.now_s())


def _go_on(earlier: Resumption, recording: Recording, versions: dict[str, str]) -> None:
    """Put the resumed session in its place and tell what it holds."""
    for line in earlier.take_place(versions):
        recording.tell("info", line)


def _interruptible(screen: Screen, stop_wanted: Callable[[], bool], path: Path) -> Watch:
    """Return what shows on the screen how far a copy is, and ends it when somebody wants that."""

    def watch(rows: NDArray[np.void], what: str) -> Iterator[np.void]:
        for row in screen.watch(rows, what):
            if stop_wanted():
                raise InterruptedCaptureError(f"interrupted before it went on: {path} is as it was")
            yield row

    return watch


def saved_line(status: Status) -> str:
    """Say in words what is in the file."""
    minutes, seconds = divmod(round(status.earlier_s + status.time_s), 60)
    poses = "1 pose" if status.saved == 1 else f"{status.saved} poses"
    return f"{poses} saved in {status.file} ({minutes}:{seconds:02d} of audio, {len(status.channels)} channels)"


def _last_line(error: Exception, status: Status) -> str:
    """Say how the capture ended, what is in the file, and how to go on."""
    line = f"{error}; {saved_line(status)}"
    return line if "--resume" in line else f"{line}; go on with --resume"


@contextmanager
def _telling_what_is_saved(status: Status) -> Iterator[None]:
    """Say what is in the file where the disk refuses, or a second Ctrl-C ends the program at once."""
    try:
        yield
    except (KeyboardInterrupt, SessionWriteError) as error:
        ending = InterruptedCaptureError if isinstance(error, KeyboardInterrupt) else SessionWriteError
        what = ending(str(error) or "interrupted at once")
        raise ending(_last_line(what, status) if Path(status.file).exists() else str(what)) from error


@contextmanager
def _opened(rig: Rig, stop_wanted: Callable[[], bool], remedy: str) -> Iterator[dict[str, str]]:
    """Open the devices, audio last so that little of it waits, and give the versions of everything.

    `remedy` is told as well where a device is missing.
    """

    def glance() -> None:
        if stop_wanted():
            raise InterruptedCaptureError("interrupted before the devices were open: nothing was recorded")

    versions = {
        "acoustic-camera-rig": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "h5py": h5py.__version__,
        "hdf5": h5py.version.hdf5_version,
    }
    with ExitStack() as stack:
        for part, device in (("trigger", rig.trigger), ("camera", rig.camera), ("audio", rig.audio)):
            stack.callback(device.close)
            try:
                versions[part] = rig.clock.wait_for(device.open, glance)
            except DeviceError as error:
                glance()  # Ctrl-C at a terminal ends what a device has started, too
                raise DeviceError(f"{error}{remedy}") from error
        yield versions


def _new_session(path: Path, found: FoundDescription, rig: Rig, versions: dict[str, str]) -> SessionWriter:
    audio = found.description.audio
    return SessionWriter.create(
        path,
        name=path.stem,
        description_text=found.text,
        n_channels=len(audio.recorded_channels()),
        sample_rate_hz=audio.sample_rate_hz,
        versions=versions,
        truth=rig.truth,
    )


def _status(description: RigDescription, path: Path) -> Status:
    return Status(
        rig=description.name,
        file=str(path),
        channels=description.audio.recorded_channels(),
        poses=description.capture.poses,
        n_emissions=len(description.board.buzzers) * description.signal.repeats,
    )


def _with_poses(description: RigDescription, poses: int | None) -> RigDescription:
    if poses is None:
        return description
    return description.model_copy(update={"capture": description.capture.model_copy(update={"poses": poses})})


def _end_state(error: CaptureError) -> State:
    if isinstance(error, InterruptedCaptureError):
        return State.INTERRUPTED
    return State.GIVEN_UP if isinstance(error, CaptureQualityError) else State.LOST


def _end(recording: Recording, state: State, level: str, text: str) -> None:
    """Store what is known at the end, and close the file well."""
    recording.status.state, recording.status.advice = state, ""
    if (rate := recording.clocks.store_session()) is not None:
        recording.say("info", rate)
    recording.say("info", recording.film.in_words())
    recording.note(level, text)
    recording.writer.close()
