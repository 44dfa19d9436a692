"""Held-out check: each fifth of the poses is predicted by what the others say.

The camera and the board's pose come from the held-out pose's corners alone, so its sound is not used at all until it is
compared. Poses are dealt out in turn, so that each fold sees the whole session.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.fit import robust_sigma
from calib.joint.assemble import PairTdoas
from calib.joint.descend import descend
from calib.joint.problem import JointProblem, Priors, Weights
from calib.joint.robust import JointSolution, solve_again
from calib.joint.unknowns import Unknowns
from calib.result import HeldOut

FloatArray = NDArray[np.float64]

N_FOLDS = 5


def hold_out(solution: JointSolution, tdoas: PairTdoas) -> HeldOut:
    """Solve without each fold of poses in turn, near a solution, and predict it.

    Raises
    ------
    NotConvergedError
    """
    n_poses = len(solution.at.rotations)
    fold = np.arange(n_poses) % min(N_FOLDS, n_poses)
    times_s = np.zeros_like(solution.problem.arrivals.arrival_s)
    answers_m = []
    for number in range(fold.max() + 1):
        out = fold == number
        trained = _solved_on(solution, ~out)
        answers_m.append(trained.microphones_m)
        times_s[out[solution.problem.arrivals.pose]] = _predicted(solution, trained, out)
    residuals_s = tdoas.tdoa_s - (times_s[:, tdoas.pairs[:, 1]] - times_s[:, tdoas.pairs[:, 0]])
    places_m = np.array(answers_m)
    spread_m = float(np.sqrt(np.mean(np.sum((places_m - places_m.mean(axis=0)) ** 2, axis=2))))
    sigma_s = robust_sigma(residuals_s)
    return HeldOut(sigma_s / 1.4826, sigma_s, spread_m)


def _solved_on(solution: JointSolution, poses: NDArray[np.bool_]) -> Unknowns:
    part = replace(
        solution,
        used_arrivals=solution.used_arrivals[poses[solution.problem.arrivals.pose]],
        used_corners=solution.used_corners[poses] if solution.problem.corners is not None else solution.used_corners,
    )
    return solve_again(part, solution.problem.only(poses), solution.at.only(poses)).at


def _predicted(solution: JointSolution, trained: Unknowns, poses: NDArray[np.bool_]) -> FloatArray:
    """Return times of flight (n_emissions, n_mics) of held-out poses, placed by their corners alone."""
    problem = solution.problem.only(poses)
    at = replace(solution.at.only(poses), shared=trained.shared)
    if problem.corners is not None:
        held = JointProblem(problem.arrivals, problem.corners, Priors(at.shared, np.zeros_like(at.shared)))
        corners = solution.weights().corners[poses]
        at = descend(held, at, Weights(np.zeros_like(problem.arrivals.std_s), corners)).end
    return problem.arrivals.flights(at).times_s
