"""How sure the answer is: the jackknife over board poses.

Everything that a pose brings (its corners, its sound, its share in the camera's intrinsics) is left out at once and the
whole chain is solved again, so the spread of the answers contains every error that differs from pose to pose, whatever
its law. It cannot see what all poses share: a board printed to the wrong scale, a buzzer listed in the wrong place.
Source: B. Efron and C. Stein, Ann. Statist. 9 (1981) 586, doi:10.1214/aos/1176345462.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

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
