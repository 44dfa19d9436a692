"""Which concrete devices a rig description means."""

from __future__ import annotations

from acquire.devices.base import Rig
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
    drivers = {"audio": description.audio.driver, "camera": description.camera.driver}
    for device, driver in drivers.items():
        if driver != "simulated":
            raise DeviceError(f"{device}: driver {driver} is not available in this version; use driver simulated")
    from acquire.devices.simulated.rig import simulated_rig  # noqa: PLC0415 - OpenCV and SciPy load late

    board = _serial_board(description) if description.trigger.driver == "serial" else None
    return simulated_rig(description, description.simulation.seed if seed is None else seed, board)


def _serial_board(description: RigDescription) -> SerialBoard:
    buzzers = [buzzer.id for buzzer in description.board.buzzers]
    return SerialBoard(description.trigger.port, description.signal.waveform(), buzzers)
