"""The scene: everything about the simulated rig that is true and does not change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquire.devices.simulated.draws import draws
from acquire.devices.simulated.placement import planned_pose
from rigs.board import camera_matrix
from rigs.description import Board, Intrinsics, RigDescription
from rigs.errors import DescriptionError
from rigs.geometry import Pose, rotation_matrix
from rigs.session.layout import Truth

FloatArray = NDArray[np.float64]
_HALF_FRAME_M = 0.2  # the microphones sit around the camera on a frame like a cube of twice this side
_MICROPHONE_SPREAD_M = 0.005
_MOVED_M = 0.003  # by the fault moved_channel
_POSES_PER_VISIT = 10_000
_CORNERS = [(-1, -1, -1), (1, 1, -1), (1, -1, 1), (-1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1), (1, 1, 1)]


@dataclass(frozen=True)
class Scene:
    """What is true of one simulated rig.

    Parameters
    ----------
    description : RigDescription
    seed : int
    intrinsics : Intrinsics
        Of the camera.
    microphones_m : (n_columns, 3) array
        Camera frame, in the order of the recorded channels (the reference microphone, if any, is the last).
    buzzers_m : (n_buzzers, 3) array
        Board frame, in the order of the description.
    speed_of_sound_m_s : float
    camera_to_room : Pose
        Room frame: z up, one corner of the room is the origin.
    board : Board
        As it was printed: its squares are a little off.
    """

    description: RigDescription
    seed: int
    intrinsics: Intrinsics
    microphones_m: FloatArray
    buzzers_m: FloatArray
    speed_of_sound_m_s: float
    camera_to_room: Pose
    board: Board

    def planned_pose(self, pose: int) -> Pose:
        """Return `board_to_camera` of a planned pose, counted from 0; there is always one more."""
        description = self.description
        number = pose + _POSES_PER_VISIT * description.simulation.visit
        return planned_pose(self.board, self.intrinsics, description.camera.size_px, self.seed, number)

    def truth(self) -> Truth:
        """Return what evaluation may know."""
        poses = [self.planned_pose(pose).matrix() for pose in range(self.description.capture.poses)]
        return Truth(
            microphones_m=self.microphones_m[: len(self.description.audio.channels)],
            source="simulation",
            speed_of_sound_m_s=self.speed_of_sound_m_s,
            board_to_camera=np.array(poses),
            buzzers_m=self.buzzers_m,
            camera_matrix=camera_matrix(self.intrinsics),
            distortion=np.array(self.intrinsics.distortion),
        )


def draw_scene(description: RigDescription, seed: int) -> Scene:
    """Draw the scene of a seed.

    Raises
    ------
    DescriptionError
        A fault names a channel or a buzzer that the rig does not have.
    """
    _check_faults(description)
    places_m = np.array([buzzer.position_m for buzzer in description.board.buzzers])
    medium = description.medium
    return Scene(
        description,
        seed,
        _draw_intrinsics(description, seed),
        _draw_microphones(description, seed),
        places_m + description.board.buzzer_std_m * draws(seed, "buzzers").standard_normal(places_m.shape),
        medium.speed_m_s() + medium.speed_std_m_s() * float(_air(description, seed).standard_normal()),
        _draw_camera_to_room(np.array(description.simulation.room_size_m), seed),
        _draw_board(description.board, seed),
    )


def _check_faults(description: RigDescription) -> None:
    channels, buzzers = description.audio.recorded_channels(), [buzzer.id for buzzer in description.board.buzzers]
    for fault in description.simulation.faults:
        if fault.channel is not None and fault.channel not in channels:
            raise DescriptionError(f"simulation.faults: channel {fault.channel} is none of audio.channels")
        if fault.buzzer is not None and fault.buzzer not in buzzers:
            raise DescriptionError(f"simulation.faults: buzzer {fault.buzzer} is none of board.buzzers")


def _air(description: RigDescription, seed: int) -> np.random.Generator:
    visit = description.simulation.visit
    return draws(seed, "medium", visit) if visit else draws(seed, "medium")


def _draw_intrinsics(description: RigDescription, seed: int) -> Intrinsics:
    if isinstance(description.camera.intrinsics, Intrinsics):
        return description.camera.intrinsics
    rng, (width, height) = draws(seed, "camera"), description.camera.size_px
    focal_px = 0.74 * width * rng.uniform(0.98, 1.02)
    shift_px = width / 200 * rng.uniform(-1, 1, 2)
    k1, k2 = -0.1 + 0.01 * rng.uniform(-1, 1), 0.05 + 0.01 * rng.uniform(-1, 1)
    p1, p2 = 5e-4 * rng.uniform(-1, 1, 2)
    return Intrinsics(
        focal_px=(focal_px, focal_px * rng.uniform(0.998, 1.002)),
        principal_px=((width - 1) / 2 + shift_px[0], (height - 1) / 2 + shift_px[1]),
        distortion=(k1, k2, p1, p2, 0.0),
    )


def _draw_board(board: Board, seed: int) -> Board:
    error_m = board.square_size_std_m * float(draws(seed, "print").standard_normal())
    return board.model_copy(update={"square_size_m": board.square_size_m + error_m})


def _draw_microphones(description: RigDescription, seed: int) -> FloatArray:
    """Place the microphones at the corners of the frame, then on its sides, all out of the camera's view."""
    rng, n_mics = draws(seed, "microphones"), len(description.audio.channels)
    extra = rng.uniform(-1, 1, (max(0, n_mics - len(_CORNERS)), 3))
    extra[np.arange(len(extra)), rng.integers(0, 2, len(extra))] = rng.choice([-1.0, 1.0], len(extra))
    nominal_m = _HALF_FRAME_M * np.concatenate([np.array(_CORNERS, dtype=float), extra])[:n_mics]
    places_m = nominal_m + _MICROPHONE_SPREAD_M * rng.standard_normal(nominal_m.shape)
    for fault in description.simulation.faults:
        if fault.kind == "moved_channel" and fault.channel in description.audio.channels:
            direction = draws(seed, "moved", fault.channel).standard_normal(3)
            row = description.audio.channels.index(fault.channel)
            places_m[row] += _MOVED_M * direction / np.linalg.norm(direction)
    reference = description.audio.reference_microphone
    if reference is None:
        return places_m
    error_m = reference.position_std_m * draws(seed, "reference").standard_normal(3)
    return np.concatenate([places_m, [np.array(reference.position_m) + error_m]])


def _draw_camera_to_room(size_m: FloatArray, seed: int) -> Pose:
    """Put the camera behind the middle of the room, turned so that nothing is parallel to a wall."""
    rng = draws(seed, "room")
    upright = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    yaw_rad = np.pi / 2 * rng.integers(4) + np.radians(rng.uniform(15, 75))
    yaw = rotation_matrix(np.array([0.0, 0.0, yaw_rad]))
    rotation = yaw @ upright @ rotation_matrix(np.radians(rng.uniform(3, 8, 3)) * rng.choice([-1, 1], 3))
    middle_m = size_m * rng.uniform(0.45, 0.55, 3)
    return Pose(rotation, middle_m - 0.45 * rotation[:, 2])
