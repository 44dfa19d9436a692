"""The robust solve: a loss that narrows, then least squares without what does not fit.

How far measurements scatter is found along with the rest: one factor on the stated standard deviations of all arrivals
and one on those of all corners, so that neither needs to be known beforehand, only their ratios among themselves.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from operator import add

import numpy as np
from numpy.typing import NDArray

from calib.errors import NotConvergedError
from calib.joint.descend import descend
from calib.joint.problem import JointProblem, Weights
from calib.joint.search import CAUCHY_WIDTH
from calib.joint.unknowns import Unknowns

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

MAX_ROUNDS = 20
ROUND_ITERATIONS = 4
SETTLED, STEADY = 1e-2, 1e-7  # of the scale, from round to round: on the way, and at the end
REJECT_SIGMAS = 4.5
LEAST_SCALE = 1e-6  # keeps weights finite where there is no noise at all
FEW_MICROPHONES = 4  # with fewer, that is the likely reason where nothing settles


@dataclass(frozen=True)
class Scales:
    """Factors on the stated standard deviations of arrivals and of corners."""

    arrivals: float
    corners: float


@dataclass(frozen=True)
class JointSolution:
    """Values of all unknowns, and what they rest on.

    Parameters
    ----------
    problem : JointProblem
    at : Unknowns
    used_arrivals : (n_emissions, n_mics) bool array
    used_corners : (n_poses, n_corners) bool array
    scales : Scales
    cost : float
        Half the sum of squares of everything used, priors included, each over its variance.
    """

    problem: JointProblem
    at: Unknowns
    used_arrivals: BoolArray
    used_corners: BoolArray
    scales: Scales
    cost: float

    def weights(self) -> Weights:
        """Return the weights of the last solve: 1 / variance of what was used."""
        return _chosen(self.problem, self.used_arrivals, self.used_corners, self.scales)

    def residuals_s(self) -> FloatArray:
        """Return residuals of all arrivals (n_emissions, n_mics) about when each emission began by those used."""
        return self.problem.arrivals.residuals_s(self.at, self.weights().arrivals)


def solve_robustly(problem: JointProblem, start: Unknowns) -> JointSolution:
    """Find all unknowns from a start in the right basin.

    Raises
    ------
    NotConvergedError
        Levenberg-Marquardt did not come to rest.
    """
    return _without_outliers(problem, *robust_rounds(problem, start))


def robust_rounds(
    problem: JointProblem, start: Unknowns, max_rounds: int = MAX_ROUNDS
) -> tuple[Unknowns, Weights, Scales]:
    """Descend with a loss whose width follows the scatter, until that is steady."""
    at, weights = start, Weights(np.zeros_like(problem.arrivals.std_s), problem.stated_weights().corners)
    scales = _robust_scales(problem, at, weights)
    for _ in range(max_rounds):
        weights = _cauchy(problem, at, weights, scales)
        at = descend(problem, at, weights, ROUND_ITERATIONS).end
        previous, scales = scales, _robust_scales(problem, at, weights)
        if _alike(scales, previous, SETTLED):
            break
    return at, weights, scales


def solve_again(solution: JointSolution, problem: JointProblem, start: Unknowns) -> JointSolution:
    """Solve a changed problem with the same choice of measurements and the same scales.

    Raises
    ------
    NotConvergedError
    """
    weights = _chosen(problem, solution.used_arrivals, solution.used_corners, solution.scales)
    descent = descend(problem, start, weights)
    if not descent.converged:
        raise _not_settled(descent.n_iterations, problem)
    return JointSolution(
        problem, descent.end, solution.used_arrivals, solution.used_corners, solution.scales, descent.cost
    )


def _without_outliers(problem: JointProblem, at: Unknowns, weights: Weights, scales: Scales) -> JointSolution:
    arrivals, corners = np.zeros_like(problem.arrivals.present), weights.corners > 0
    for _ in range(MAX_ROUNDS):
        deviations = _deviations(problem, at, weights)
        chosen = [np.nan_to_num(found, nan=np.inf) < REJECT_SIGMAS * scale
                  for found, scale in zip(deviations, (scales.arrivals, scales.corners), strict=True)]  # fmt: skip
        chosen[0] &= chosen[0].sum(axis=1, keepdims=True) > 1
        same = np.array_equal(chosen[0], arrivals) and np.array_equal(chosen[1], corners)
        arrivals, corners = chosen
        weights = _chosen(problem, arrivals, corners, scales)
        descent = descend(problem, at, weights)
        if not descent.converged:
            raise _not_settled(descent.n_iterations, problem)
        at, previous = descent.end, scales
        scales = _scales(problem, at, weights, scales)
        if same and _alike(scales, previous, STEADY):
            break
    weights = _chosen(problem, arrivals, corners, scales)
    descent = descend(problem, at, weights)
    return JointSolution(problem, descent.end, arrivals, corners, scales, descent.cost)


def _alike(first: Scales, second: Scales, tolerance: float) -> bool:
    arrivals, corners = first.arrivals / second.arrivals, first.corners / second.corners
    return abs(arrivals - 1) < tolerance and abs(corners - 1) < tolerance


def _not_settled(n_iterations: int, problem: JointProblem) -> NotConvergedError:
    n_mics = problem.arrivals.arrival_s.shape[1]
    why = "the poses may be too much alike; capture more, tilted and at several distances"
    if n_mics < FEW_MICROPHONES:
        why = f"{n_mics} microphones tell too little; leave fewer channels out"
    return NotConvergedError(f"the solve did not settle within {n_iterations} steps: {why}")


def _chosen(problem: JointProblem, arrivals: BoolArray, corners: BoolArray, scales: Scales) -> Weights:
    stated = problem.stated_weights()
    return Weights(
        arrivals * stated.arrivals / scales.arrivals**2,
        corners * stated.corners / scales.corners**2 if problem.corners is not None else stated.corners,
    )


def _deviations(problem: JointProblem, at: Unknowns, weights: Weights) -> tuple[FloatArray, FloatArray]:
    """Return residuals over their stated standard deviations, of arrivals and of corners (n_poses, n_corners).

    Those of corners are lengths in the picture over the square root of 2, so that they compare with one axis.
    """
    arrivals = np.abs(problem.arrivals.residuals_s(at, weights.arrivals)) / problem.arrivals.std_s
    if problem.corners is None:
        return arrivals, np.zeros((0, 0))
    corners = np.linalg.norm(problem.corners.residuals_px(at), axis=2) / problem.corners.std_px / np.sqrt(2)
    return arrivals, corners


def _robust_scales(problem: JointProblem, at: Unknowns, weights: Weights) -> Scales:
    arrivals, corners = _deviations(problem, at, weights)
    scale = 1.4826 * float(np.median(arrivals[problem.arrivals.present]))
    seen = corners[np.isfinite(corners)]
    # the median length of a 2-D Gaussian error is 1.1774 standard deviations
    corner_scale = float(np.median(seen)) * np.sqrt(2) / 1.1774 if len(seen) else 1.0
    return Scales(max(scale, LEAST_SCALE), max(corner_scale, LEAST_SCALE))


def _cauchy(problem: JointProblem, at: Unknowns, weights: Weights, scales: Scales) -> Weights:
    stated = problem.stated_weights()
    arrivals, corners = _deviations(problem, at, weights)
    loose = [1 / (1 + (np.nan_to_num(found) / (CAUCHY_WIDTH * scale)) ** 2) / scale**2
             for found, scale in ((arrivals, scales.arrivals), (corners, scales.corners))]  # fmt: skip
    return Weights(stated.arrivals * loose[0], stated.corners * loose[1])


def _scales(problem: JointProblem, at: Unknowns, weights: Weights, scales: Scales) -> Scales:
    """Return the scales by what was used, from earlier ones: root mean squares, what unknowns take of them given back.

    Each kind of measurement gives back what it tells of the unknowns itself, the trace of its part of the hat matrix
    (W. Foerstner, Allg. Vermess.-Nachr. 86 (1979) 446): all or nothing would be wrong where poses are few.
    """
    free, poses_free = problem.priors.free, not problem.priors.poses_held
    parts = problem.measured_equations(at, weights)
    whole = problem.with_all_else(reduce(add, parts), at, weights).only(free, poses_free=poses_free)
    taken = whole.shares([part.only(free, poses_free=poses_free) for part in parts])
    used = weights.arrivals > 0
    n_values = [used.sum() - used.any(axis=1).sum(), 2 * np.sum(weights.corners > 0)]  # emissions begin when they like
    factors = [float(np.sqrt(2 * part.cost / max(n - own, 1.0)))
               for part, n, own in zip(parts, n_values, taken, strict=False)]  # fmt: skip
    arrivals = max(scales.arrivals * factors[0], LEAST_SCALE)
    return Scales(arrivals, 1.0 if problem.corners is None else max(scales.corners * factors[1], LEAST_SCALE))
