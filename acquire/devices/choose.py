"""Which concrete devices a rig description means."""

from __future__ import annotations

from dataclasses import replace

from acquire.devices.base import Camera, Rig
from acquire.devices.board_serial import SerialBoard
from acquire.errors import DeviceError
from rigs.description import RigDescription


def choose_devices(description: RigDescription, *, seed: int | None = None) -> Rig:
    """Return the devices that the description names, not yet opened.

    Parameters
    ----------
    description : RigDescription
    seed : int, optional
        Of the simulated rig, instead of `simulation.seed`.

    Raises
    ------
    DeviceError
        A driver is not available.
    rigs.errors.DescriptionError
        The description asks for a simulation that cannot be.
    """
    driver = description.audio.driver
    if driver != "simulated":
        raise DeviceError(f"audio: driver {driver} is not available in this version; use driver simulated")
    from acquire.devices.simulated.rig import simulated_rig  # noqa: PLC0415 - OpenCV and SciPy load late

    board = _serial_board(description) if description.trigger.driver == "serial" else None
    camera = _opencv_camera(description) if description.camera.driver == "opencv" else None
    seed = description.simulation.seed if seed is None else seed
    rig = simulated_rig(description, seed, board, in_real_time=camera is not None)
    return replace(rig, camera=camera, truth=None) if camera else rig


def _opencv_camera(description: RigDescription) -> Camera:
    from acquire.devices.camera_opencv import OpenCvCamera  # noqa: PLC0415 - only where there is such a camera

    return OpenCvCamera(description.camera)


def _serial_board(description: RigDescription) -> SerialBoard:
    buzzers = [buzzer.id for buzzer in description.board.buzzers]
    return SerialBoard(description.trigger.port, description.signal.waveform(), buzzers)
