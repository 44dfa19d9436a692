"""The simulated rig, put together."""

from __future__ import annotations

from acquire.clock import MonotonicClock, VirtualClock
from acquire.devices.base import Rig, TriggerBoard
from acquire.devices.simulated.camera import SimulatedCamera
from acquire.devices.simulated.heard import HeardTrigger
from acquire.devices.simulated.microphones import SimulatedMicrophones
from acquire.devices.simulated.operator import SimulatedOperator
from acquire.devices.simulated.scene import draw_scene
from acquire.devices.simulated.stage import Stage
from acquire.devices.simulated.trigger import SimulatedTrigger
from rigs.description import RigDescription


def simulated_rig(
    description: RigDescription, seed: int, board: TriggerBoard | None = None, *, in_real_time: bool = False
) -> Rig:
    """Return the simulated devices of one scene, not yet opened.

    Time is virtual, unless a real device is part of the rig: it keeps its own time, so the scene keeps the host's.

    Parameters
    ----------
    description : RigDescription
    seed : int
    board : TriggerBoard, optional
        A real board, heard in the simulated room instead of the simulated one.
    in_real_time : bool
        Whether another real device is part of the rig.

    Raises
    ------
    rigs.errors.DescriptionError
        A fault names a channel or a buzzer that the rig does not have, or the ChArUco dictionary is too small.
    """
    clock = MonotonicClock() if board or in_real_time else VirtualClock()
    scene = draw_scene(description, seed)
    stage = Stage(scene, clock)
    return Rig(
        HeardTrigger(board, stage) if board else SimulatedTrigger(stage),
        SimulatedMicrophones(stage),
        SimulatedCamera(stage),
        clock,
        SimulatedOperator(stage),
        scene.truth(),
    )
