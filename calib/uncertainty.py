"""How sure the answer is: the jackknife over board poses.

Everything that a pose brings (its corners, its sound, its share in the camera's intrinsics) is left out at once and the
whole chain is solved again, so the spread of the answers contains every error that differs from pose to pose, whatever
its law. Source: B. Efron and C. Stein, Ann. Statist. 9 (1981) 586, doi:10.1214/aos/1176345462.

It cannot see what all poses share. Such errors are known in size where the rig description states how well a value
is known: buzzer places, square size, speed of sound, a known microphone's place. Their share is found by moving each
by its standard deviation and solving again.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rigs.description import Audio, Board, Medium, RigDescription

FloatArray = NDArray[np.float64]

MAX_GROUPS = 30


def pose_groups(poses: NDArray[np.int32]) -> list[NDArray[np.int32]]:
    """Deal the poses' numbers (n_poses,) out to at most MAX_GROUPS groups, neighbours into different ones."""
    n_groups = min(len(poses), MAX_GROUPS)
    return [poses[group::n_groups] for group in range(n_groups)]


def jackknife_covariance(
    poses: NDArray[np.int32], solve_without: Callable[[NDArray[np.int32]], FloatArray]
) -> FloatArray:
    """Return the covariance (n_unknowns, n_unknowns) of an estimate.

    Parameters
    ----------
    poses : (n_poses,) integer array
        The poses that the estimate rests on.
    solve_without : callable
        Takes the poses to leave out, returns the estimate (n_unknowns,) without them.
    """
    answers = np.array([solve_without(group) for group in pose_groups(poses)])
    deviations = answers - answers.mean(axis=0)
    n_groups = len(answers)
    return np.asarray((n_groups - 1) / n_groups * deviations.T @ deviations)


def shift_covariance(estimate: FloatArray, shifted: list[FloatArray]) -> FloatArray:
    """Return the share (n_unknowns, n_unknowns) of values that the rig description gives.

    Parameters
    ----------
    estimate : (n_unknowns,) array
    shifted : list of (n_unknowns,) arrays
        The estimate with each of the given values moved by its standard deviation, one at a time.
    """
    shifts = np.array(shifted) - estimate
    return np.asarray(shifts.T @ shifts)


def descriptions_off_by_one_std(description: RigDescription) -> list[RigDescription]:
    """Return the rig descriptions in which one uncertain value is moved by its standard deviation."""
    board, medium = description.board, description.medium
    boards = [_with_moved_buzzer(board, number, axis) for number in range(len(board.buzzers)) for axis in range(3)]
    boards.append(board.model_copy(update={"square_size_m": board.square_size_m + board.square_size_std_m}))
    faster = Medium(
        speed_of_sound_m_s=medium.speed_m_s() + medium.speed_std_m_s(), speed_of_sound_std_m_s=medium.speed_std_m_s()
    )
    return [
        *(description.model_copy(update={"board": moved}) for moved in boards),
        *(description.model_copy(update={"audio": moved}) for moved in _with_moved_reference(description.audio)),
        description.model_copy(update={"medium": faster}),
    ]


def _with_moved_reference(audio: Audio) -> list[Audio]:
    reference = audio.reference_microphone
    if reference is None:
        return []
    places_m = np.array(reference.position_m) + reference.position_std_m * np.eye(3)
    moved = [reference.model_copy(update={"position_m": tuple(place_m.tolist())}) for place_m in places_m]
    return [audio.model_copy(update={"reference_microphone": other}) for other in moved]


def _with_moved_buzzer(board: Board, number: int, axis: int) -> Board:
    position_m = list(board.buzzers[number].position_m)
    position_m[axis] += board.buzzer_std_m
    moved = board.buzzers[number].model_copy(update={"position_m": tuple(position_m)})
    return board.model_copy(update={"buzzers": (*board.buzzers[:number], moved, *board.buzzers[number + 1 :])})
