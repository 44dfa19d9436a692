"""The check-up, step by step."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import ExitStack
from pathlib import Path

from acquire.devices.choose import choose_devices
from acquire.doctor.channels import judge_channels
from acquire.doctor.computer import judge_computer
from acquire.doctor.devices import Devices
from acquire.doctor.hearing import Hearing, measure
from acquire.doctor.listening import Listening
from acquire.doctor.noise import judge_noise
from acquire.doctor.order import judge_order
from acquire.doctor.picture import board_pose, judge_picture, look
from acquire.doctor.row import Part, Row, refusal
from acquire.doctor.timing import judge_timing
from acquire.errors import DeviceError
from rigs.description import RigDescription
from rigs.geometry import Pose

Finding = Row | Hearing | str


def check_up(description: RigDescription, folder: Path, *, seed: int | None = None) -> Iterator[Finding]:
    """Look at everything that a session needs, and say how each is as soon as it is known.

    Whatever fails, the rest is still looked at.

    Parameters
    ----------
    description : RigDescription
    folder : Path
        Where the session would be written.
    seed : int, optional
        Of the simulated rig, instead of the description's.

    Yields
    ------
    Row, Hearing or str
        The hearing after the rows that judge it; in words, what is done next and takes a while.

    Raises
    ------
    rigs.errors.DescriptionError
        The description asks for devices or a simulation that cannot be.
    """
    with ExitStack() as stack:
        devices = Devices(choose_devices(description, seed=seed), stack)
        yield "opening the devices"
        yield from devices.open_each()
        pose = yield from _see(devices, description)
        yield from _hear(devices, description, pose)
    yield "looking at the computer"
    yield from judge_computer(folder, description)


def _see(devices: Devices, description: RigDescription) -> Generator[Row | str, None, Pose | None]:
    """Judge the picture, and return where the board is."""
    if devices.camera is None:
        return None
    yield "looking for the board"
    try:
        view = look(devices.camera, devices.clock, description)
    except DeviceError as error:
        yield refusal("camera", error, Part.PICTURE)
        return None
    yield from judge_picture(view, description)
    return board_pose(view, description)[0]


def _hear(devices: Devices, description: RigDescription, board_to_camera: Pose | None) -> Iterator[Finding]:
    if devices.audio is None:
        return
    yield "listening to every buzzer; please keep quiet"
    try:
        sounds = Listening(devices, description).hear(devices.trigger)
    except DeviceError as error:
        yield refusal("sound device", error, Part.SOUND)
        return
    hearing = measure(sounds, description)
    yield from judge_timing(sounds, hearing)
    if sounds.trigger_lost is not None:
        yield refusal("trigger board", sounds.trigger_lost, Part.SOUND)
    if hearing.buzzers:
        yield from judge_channels(sounds, hearing)
        yield from judge_order(hearing, description, board_to_camera)
    yield from judge_noise(sounds, hearing)
    yield hearing
