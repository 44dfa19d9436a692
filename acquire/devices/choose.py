"""Which concrete devices a rig description means."""

from __future__ import annotations

from dataclasses import replace

from acquire.clock import MonotonicClock
from acquire.devices.audio_portaudio import PortAudioInput
from acquire.devices.base import AudioInput, Camera, Rig, TriggerBoard
from acquire.devices.board_serial import SerialBoard
from rigs.description import RigDescription
from rigs.errors import DescriptionError


class Person:
    """Whoever moves a real board, and reads on the screen when and where to."""

    def ask_for_pose(self, pose: int) -> None:
        """Do nothing: the screen asks."""


def choose_devices(description: RigDescription, *, seed: int | None = None) -> Rig:
    """Return the devices that the description names, not yet opened.

    Real and simulated ones may be mixed, but for a real sound device with a simulated board, which makes no sound.
    Time is virtual where all are simulated, and the host's otherwise.

    Parameters
    ----------
    description : RigDescription
    seed : int, optional
        Of the simulated rig, instead of `simulation.seed`.

    Raises
    ------
    rigs.errors.DescriptionError
        The description asks for a mixture or a simulation that cannot be.
    """
    trigger, audio, camera = _trigger(description), _audio(description), _camera(description)
    if audio and not trigger:
        raise DescriptionError(
            "trigger.driver simulated with audio.driver portaudio: a simulated board makes no sound to record: use "
            "trigger.driver serial, or audio.driver simulated"
        )
    if trigger and audio and camera:
        return Rig(trigger, audio, camera, MonotonicClock(), Person())
    from acquire.devices.simulated.rig import simulated_rig  # noqa: PLC0415 - OpenCV and SciPy load late

    seed = description.simulation.seed if seed is None else seed
    rig = simulated_rig(description, seed, trigger, in_real_time=camera is not None)
    if trigger and audio:  # it hears the board itself
        rig = replace(rig, trigger=trigger, audio=audio, truth=None)
    return replace(rig, camera=camera, truth=None) if camera else rig


def _trigger(description: RigDescription) -> TriggerBoard | None:
    """Return the real board; None where it is simulated."""
    if description.trigger.driver == "simulated":
        return None
    buzzers = [buzzer.id for buzzer in description.board.buzzers]
    return SerialBoard(description.trigger.port, description.signal.waveform(), buzzers)


def _audio(description: RigDescription) -> AudioInput | None:
    """Return the real sound device; None where it is simulated."""
    return None if description.audio.driver == "simulated" else PortAudioInput(description.audio)


def _camera(description: RigDescription) -> Camera | None:
    """Return the real camera; None where it is simulated."""
    if description.camera.driver == "simulated":
        return None
    from acquire.devices.camera_opencv import OpenCvCamera  # noqa: PLC0415 - only where there is such a camera

    return OpenCvCamera(description.camera)
