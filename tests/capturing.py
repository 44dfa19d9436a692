"""Small captures with the real simulated devices, the real writer and the real reader."""

from pathlib import Path
from typing import Any

import yaml
from simulated import make_description

from acquire.capture import capture
from acquire.status import Message, Status
from rigs.description import RigDescription
from rigs.library import FoundDescription

BUZZERS = [{"id": 1, "position_m": (-0.045, -0.045, -0.005)}, {"id": 7, "position_m": (0.245, 0.17, 0.0)}]
SMALL: dict[str, dict[str, Any]] = {
    "camera": {"size_px": (640, 480)},
    "board": {"buzzers": BUZZERS},
    "signal": {"gap_s": 0.15},
    "capture": {"poses": 2, "frame_interval_s": 0.1},
    "simulation": {"rt60_s": 0.0},
}


class Listener:
    """A screen that remembers what it was told, and in which states."""

    def __init__(self) -> None:
        self.messages: list[Message] = []
        self.states: list[str] = []
        self.status: Status | None = None

    def show(self, status: Status) -> None:
        self.status = status
        if status.state.value not in self.states[-1:]:
            self.states.append(status.state.value)

    def say(self, message: Message) -> None:
        self.messages.append(message)

    def watch(self, rows, what):
        return rows

    def warnings(self) -> str:
        return "\n".join(message.text for message in self.messages if message.level == "warning")


def small_description(**sections: dict[str, Any]) -> RigDescription:
    return make_description(**{name: SMALL.get(name, {}) | sections.get(name, {}) for name in SMALL | sections})


def small_rig(**sections: dict[str, Any]) -> FoundDescription:
    description = small_description(**sections)
    return FoundDescription(rig_text(description), description, "small.yaml", "--rig")


def rig_text(description: RigDescription) -> str:
    return yaml.safe_dump(description.model_dump(mode="json"), sort_keys=False)


def with_fault(kind: str, **keys: int) -> FoundDescription:
    return small_rig(simulation={"faults": [{"kind": kind, **keys}]})


def captured(path: Path, found: FoundDescription | None = None, **options: Any) -> Listener:
    listener = Listener()
    capture(found or small_rig(), path, **({"screen": listener} | options))
    return listener
