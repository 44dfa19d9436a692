"""The simulated rig, put together."""

from __future__ import annotations

from acquire.clock import VirtualClock
from acquire.devices.base import Rig
from acquire.devices.simulated.camera import SimulatedCamera
from acquire.devices.simulated.microphones import SimulatedMicrophones
from acquire.devices.simulated.operator import SimulatedOperator
from acquire.devices.simulated.scene import draw_scene
from acquire.devices.simulated.stage import Stage
from acquire.devices.simulated.trigger import SimulatedTrigger
from rigs.description import RigDescription


def simulated_rig(description: RigDescription, seed: int) -> Rig:
    """Return the simulated devices of one scene, in virtual time, not yet opened.

    Raises
    ------
    rigs.errors.DescriptionError
        A fault names a channel or a buzzer that the rig does not have, or the ChArUco dictionary is too small.
    """
    clock = VirtualClock()
    scene = draw_scene(description, seed)
    stage = Stage(scene, clock)
    return Rig(
        SimulatedTrigger(stage),
        SimulatedMicrophones(stage),
        SimulatedCamera(stage),
        clock,
        SimulatedOperator(stage),
        scene.truth(),
    )
