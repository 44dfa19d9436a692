"""Levenberg-Marquardt on the joint problem."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.joint.problem import JointProblem, Weights
from calib.joint.unknowns import POSE_SIZE, Unknowns

FloatArray = NDArray[np.float64]

MAX_ITERATIONS = 100
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-4, 1e-14, 1e12
AT_REST = 1e-14  # of the cost: the same answer to a nanometre, from wherever it was approached


@dataclass(frozen=True)
class Descent:
    """Where it ended, at what cost, whether it came to rest, and after how many steps."""

    end: Unknowns
    cost: float
    converged: bool
    n_iterations: int


def descend(problem: JointProblem, start: Unknowns, weights: Weights, max_iterations: int = MAX_ITERATIONS) -> Descent:
    """Minimise the weighted sum of squares (Marquardt's scaling, doi:10.1137/0111030)."""
    at, damping = start, FIRST_DAMPING
    weights = problem.with_onset_weights(weights, start)
    equations = problem.free_equations(at, weights)
    for iteration in range(1, max_iterations + 1):
        try:
            shared, poses = equations.step(damping)
        except np.linalg.LinAlgError:
            damping *= 10
            continue
        moved = at.moved(*whole_step(problem, at, shared, poses))
        new = problem.free_equations(moved, weights)
        gain = float(shared @ equations.shared_gradient + np.sum(poses * equations.pose_gradient))
        if new.cost <= equations.cost:
            at, equations, damping = moved, new, max(damping / 10, LEAST_DAMPING)
        else:
            damping *= 10
        if gain <= AT_REST * (equations.cost + 1e-6):
            return Descent(at, equations.cost, True, iteration)
        if not damping < MOST_DAMPING:
            break
    return Descent(at, equations.cost, False, max_iterations)


def whole_step(
    problem: JointProblem, at: Unknowns, shared: FloatArray, poses: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the steps of all unknowns: 0 for what is held."""
    step = np.zeros(at.blocks.size)
    step[problem.priors.free] = shared
    return step, poses if len(poses) else np.zeros((len(at.rotations), POSE_SIZE))
