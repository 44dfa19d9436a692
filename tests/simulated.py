"""The rig that the tests of the simulated devices use, changed as each test needs it."""

from typing import Any

import numpy as np

from acquire.devices.base import AudioBlock, Rig
from acquire.devices.choose import choose_devices
from rigs.description import RigDescription

_SQUARE_M = 0.025
_BUZZERS = [(-0.045, -0.045, -0.005), (0.1, -0.045, 0.0), (0.245, -0.045, -0.005), (-0.045, 0.17, 0.0)]


def make_description(**sections: dict[str, Any]) -> RigDescription:
    """Describe a simulated rig; keywords name a section and change keys of it."""
    described: dict[str, Any] = {
        "name": "test",
        "audio": {"driver": "simulated", "channels": list(range(1, 9))},
        "camera": {"driver": "simulated", "size_px": (1280, 720), "fps": 10},
        "board": {
            "pattern": "checkerboard",
            "corners": (9, 6),
            "square_size_m": _SQUARE_M,
            "square_size_std_m": 0.0,
            "buzzers": [{"id": number, "position_m": place} for number, place in enumerate(_BUZZERS, start=1)],
        },
        "trigger": {"driver": "simulated"},
        "signal": {"kind": "sweep"},
        "medium": {"temperature_c": 20.0},
        "capture": {"poses": 5},
        "simulation": {},
    }
    for name, changes in sections.items():
        described[name] = described[name] | changes
    return RigDescription.model_validate(described)


def open_rig(seed: int = 0, **sections: dict[str, Any]) -> Rig:
    """Open the devices of a rig and let the board come to its first pose."""
    rig = choose_devices(make_description(**sections), seed=seed)
    rig.trigger.open()
    rig.audio.open()
    rig.camera.open()
    go_to_pose(rig, 0)
    return rig


def go_to_pose(rig: Rig, pose: int) -> None:
    rig.operator.ask_for_pose(pose)
    rig.clock.sleep_s(1.5)


def record(rig: Rig, duration_s: float = 0.5) -> list[AudioBlock]:
    rig.clock.sleep_s(duration_s)
    return rig.audio.read()


def joined(blocks: list[AudioBlock]) -> np.ndarray:
    return np.concatenate([block.samples for block in blocks])
