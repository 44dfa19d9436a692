"""The hands that move the board: to the next place once every buzzer has sounded and it has been quiet for a while."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquire.devices.base import Clock
from acquire.devices.simulated.scene import Scene
from acquire.devices.simulated.stage import Movement
from rigs.geometry import Pose

_MOVE_S = 1.0
_ASIDE = Pose(np.eye(3), np.array([2.0, 0.2, 0.9]))  # beside the camera's view


@dataclass
class Place:
    """Where the board stands, and between which host times; `left_s` is None while it stands there."""

    number: int
    board_to_camera: Pose
    reached_s: float
    left_s: float | None = None


class Hands:
    """Moves the board by what is heard alone, as somebody does who sees no display.

    Parameters
    ----------
    scene : Scene
    clock : Clock
    quiet_s : float
        Silence after which the last sound is taken for the last of the place, so that a buzzer may be fired again.
    patience_s : float
        Silence after which the board is moved although not every buzzer has sounded: something may be wrong there.
    """

    def __init__(self, scene: Scene, clock: Clock, quiet_s: float, patience_s: float) -> None:
        self._scene, self._clock = scene, clock
        self._quiet_s, self._patience_s = quiet_s, patience_s
        self._heard: set[int] = set()
        self._last_s = clock.now_s()
        self.places: list[Place] = []
        self._movement = Movement(_ASIDE, _ASIDE, self._last_s - 1, self._last_s)
        self._move()

    @property
    def place(self) -> Place:
        """Where the board is, or is on its way to."""
        return self.places[-1]

    def board_to_camera(self, time_s: float) -> Pose:
        """Return where the board is at a host time not before it set off last."""
        return self._movement.at(time_s)

    def is_moving(self, time_s: float) -> bool:
        """Tell whether the board moves at a host time."""
        return self._movement.start_s < time_s < self._movement.end_s

    def hear(self, buzzer: int, time_s: float) -> None:
        """Take note that a buzzer sounds."""
        self._heard.add(buzzer)
        self._last_s = max(self._last_s, time_s)

    def step(self) -> Place | None:
        """Move the board if it is time to, and return the place it sets off for."""
        done = len(self._heard) == len(self._scene.buzzers_m)
        silent_s = self._clock.now_s() - max(self._last_s, self.place.reached_s)
        if silent_s > (self._quiet_s if done else self._patience_s):
            self.place.left_s = self._clock.now_s()
            self._move()
            return self.place
        return None

    def _move(self) -> None:
        self._heard.clear()
        now_s, number = self._clock.now_s(), len(self.places)
        target = self._scene.planned_pose(number)
        self._movement = Movement(self._movement.at(now_s), target, now_s, now_s + _MOVE_S)
        self.places.append(Place(number, target, now_s + _MOVE_S))
