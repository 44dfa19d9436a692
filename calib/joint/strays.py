"""Held values that the measurements contradict, in words."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.errors import CalibrationError, NotEnoughDataError
from calib.joint.problem import JointProblem
from calib.joint.robust import JointSolution, solve_robustly
from calib.joint.uncertainty import shared_covariance
from calib.joint.unknowns import Blocks

FloatArray = NDArray[np.float64]

STRAYS_SIGMAS = 3.0
CONTRADICTS_SIGMAS = 4.0  # of the intrinsics: all places rest on them, and bend with them
LEARNT = 0.98  # of the prior's variance: where more is left, the measurements say nothing


def stray_doubts(solution: JointSolution, released: JointProblem) -> list[str]:
    """Solve with nothing held, and say which held values stray from what is then found.

    Parameters
    ----------
    solution : JointSolution
    released : JointProblem
        The same measurements with nothing held.

    Raises
    ------
    NotEnoughDataError
        The measurements contradict held intrinsics.
    """
    priors = solution.problem.priors
    try:
        free = solve_robustly(released, solution.at)
        variance = np.diag(shared_covariance(released, free.at, free.weights()))
    except CalibrationError:
        return []
    deviations = _deviations(free, variance, priors.std == 0)
    doubts = []
    for name, where, block, check in _values(solution.at.blocks):
        sigmas = float(np.sqrt(np.mean(deviations[where] ** 2)))
        if priors.free[where].any() or sigmas < STRAYS_SIGMAS:
            continue
        held, said = f"{name} is held at {_told(solution, where)}", f"say {_told(free, where)}"
        remedy = f"{sigmas:.1f} standard deviations away: do not hold {block}, or check {check} in the rig description"
        if block == "intrinsics" and sigmas > CONTRADICTS_SIGMAS:
            raise NotEnoughDataError(f"{held}, and the measurements contradict it: they {said}, {remedy}")
        doubts.append(f"{held}, and the measurements {said}, {remedy}")
    return doubts


def _deviations(free: JointSolution, variance: FloatArray, exact: NDArray[np.bool_]) -> FloatArray:
    """Return how far the measurements alone are from the priors, in standard deviations of that difference.

    With a prior of variance P and V left of it, the measurements alone know the value to P V / (P - V), and what is
    found differs from the prior by (P - V) / P of what they say.
    """
    priors = free.problem.priors
    prior = np.where(np.isfinite(priors.std) & (priors.std > 0), priors.std, 1.0) ** 2
    learnt = np.where(variance < LEARNT * prior, prior - variance, np.inf)
    expected = np.where(exact, variance / prior, 1.0) * learnt
    return np.asarray((free.at.shared - priors.mean) / np.sqrt(np.where(expected > 0, expected, np.inf)))


def _told(solution: JointSolution, where: slice) -> str:
    blocks, values = solution.at.blocks, solution.at.shared[where]
    if blocks.speed.start <= where.start < blocks.speed.stop:
        return f"{values[0]:.1f} m/s"
    if where == blocks.scale:
        return f"{100 * values[0]:.2f} % of its description"
    if where.start >= blocks.camera.start:
        return f"{values[0]:.0f} px"
    return f"[{', '.join(f'{1e3 * value:.1f}' for value in values)}] mm"


def _values(blocks: Blocks) -> list[tuple[str, slice, str, str]]:
    """Return names and places of values that may be held, their block, and what to check."""
    focal = slice(blocks.camera.start, blocks.camera.start + 2)
    speeds = np.arange(blocks.size)[blocks.speed]
    return [
        *(("the speed of sound", slice(n, n + 1), "speed", "medium") for n in speeds),
        *((f"buzzer {n + 1}", blocks.buzzer(n), "buzzers", "board.buzzers") for n in range(blocks.n_buzzers)),
        ("the squares' size", blocks.scale, "scale", "board.square_size_m"),
        ("the focal length", focal, "intrinsics", "camera.intrinsics"),
    ]
