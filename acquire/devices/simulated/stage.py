"""The stage: what goes on in the scene, moment by moment."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from acquire.devices.base import Clock
from acquire.devices.simulated.draws import draws
from acquire.devices.simulated.scene import Scene
from rigs.geometry import Pose, rotation_matrix
from rigs.simulation import Fault
from rigs.waveform import Waveform

_REACTION_S = 0.3
_MOVE_S = 1.0
_SLIDE_S = 0.2
_SLIDE_M = 0.005
_PARKED = Pose(np.eye(3), np.array([2.0, 0.2, 0.9]))  # beside the camera's view


@dataclass(frozen=True)
class Movement:
    """The board's way from one pose to another (`board_to_camera`), between two host times in seconds."""

    origin: Pose
    target: Pose
    start_s: float
    end_s: float

    def at(self, time_s: float) -> Pose:
        """Return where the board is, starting and stopping gently."""
        share = float(np.clip((time_s - self.start_s) / (self.end_s - self.start_s), 0, 1))
        if share in {0.0, 1.0}:
            return self.target if share else self.origin
        share = share * share * (3 - 2 * share)
        turn, _ = cv2.Rodrigues(self.origin.rotation.T @ self.target.rotation)
        rotation = self.origin.rotation @ rotation_matrix(share * np.asarray(turn, dtype=float))
        return Pose(rotation, (1 - share) * self.origin.translation_m + share * self.target.translation_m)


@dataclass(frozen=True)
class Emission:
    """One sound: which buzzer (from 0, in the description's order) played what, from when on, the board being where.

    Parameters
    ----------
    start_s : float
        True host time of its beginning.
    board_rate : float
        Seconds of the trigger board's clock per second of the host's.
    """

    buzzer: int
    waveform: Waveform
    start_s: float
    board_rate: float
    pose: int
    board_to_camera: Pose


class Stage:
    """What the three devices share: the pose that was asked for, the board on its way, and the sounds made so far."""

    def __init__(self, scene: Scene, clock: Clock) -> None:
        self.scene = scene
        self.clock = clock
        self.pose = -1
        self.emissions: list[Emission] = []
        self._movement = Movement(_PARKED, _PARKED, clock.now_s() - 1, clock.now_s())
        self._slid = False
        self._out_since_s: dict[Fault, float] = {}
        self._happened: set[Fault] = set()

    def ask_for_pose(self, pose: int) -> None:
        """Move the board to a planned pose, from wherever it is; no matter if it was asked for before."""
        self.pose = pose
        self._move(self.scene.planned_pose(pose), _REACTION_S, _MOVE_S)

    def board_to_camera(self, time_s: float) -> Pose:
        """Return where the board is at a host time not before the last movement was asked for."""
        return self._movement.at(time_s)

    def is_moving(self, time_s: float) -> bool:
        """Tell whether the board moves at a host time."""
        return self._movement.start_s < time_s < self._movement.end_s

    def emit(self, emission: Emission) -> None:
        """Add a sound; the board may slide when the pose is half measured (fault board_moves)."""
        self.emissions.append(emission)
        if not self._slid and self.faults("board_moves") and self._is_half_measured():
            self._slid = True
            self._slide(emission.waveform.duration_s)

    def faults(self, kind: str) -> list[Fault]:
        """Return the faults of a kind that are due at the pose asked for last."""
        due = max(0, self.pose)
        return [fault for fault in self.scene.description.simulation.faults if fault.kind == kind and fault.pose <= due]

    def is_out(self, kind: str) -> bool:
        """Tell whether a device is gone by a fault of this kind: for ever, or for a while from mid-pose on."""
        now_s = self.clock.now_s()
        for fault in self.faults(kind) if self.pose >= 0 else []:
            if fault.duration_s is None:
                return True
            if self._is_half_measured():
                self._out_since_s.setdefault(fault, now_s)
            if now_s < self._out_since_s.get(fault, -math.inf) + fault.duration_s:
                return True
        return False

    def happens(self, kind: str) -> bool:
        """Tell whether a fault of this kind, which happens but once, happens now: in the middle of its pose."""
        due = [fault for fault in self.faults(kind) if fault not in self._happened and self._is_half_measured()]
        self._happened.update(due)
        return bool(due)

    def _is_half_measured(self) -> bool:
        description = self.scene.description
        planned = len(description.board.buzzers) * description.signal.repeats
        return sum(emission.pose == self.pose for emission in self.emissions) >= max(1, planned // 2)

    def _slide(self, delay_s: float) -> None:
        here = self.board_to_camera(self.clock.now_s())
        direction = draws(self.scene.seed, "slide").uniform(0, 2 * np.pi)
        shift_m = _SLIDE_M * here.rotation @ np.array([np.cos(direction), np.sin(direction), 0.0])
        self._move(Pose(here.rotation, here.translation_m + shift_m), delay_s, _SLIDE_S)

    def _move(self, target: Pose, delay_s: float, duration_s: float) -> None:
        now_s = self.clock.now_s()
        start_s = now_s + delay_s
        self._movement = Movement(self.board_to_camera(now_s), target, start_s, start_s + duration_s)
