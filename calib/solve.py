"""The joint solve: robust, reference-free, by Levenberg-Marquardt from a closed-form start."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.errors import NotConvergedError
from calib.problem import Estimate, NormalEquations, TdoaProblem

FloatArray = NDArray[np.float64]

MAX_ITERATIONS = 100
STEP_THRESHOLD_M = 1e-9
MAX_ROUNDS = 30
CAUCHY_WIDTH = 2.385  # 95 % efficient for Gaussian noise (Holland and Welsch 1977, doi:10.1080/03610927708827533)
REJECT_SIGMAS = 4.5
MIN_SIGMA_S = 1e-9  # keeps weights finite where there is no noise at all


@dataclass(frozen=True)
class SpeedPrior:
    """What is known of the speed of sound before: mean and standard deviation in m/s; 0 holds it."""

    mean_m_s: float
    std_m_s: float


@dataclass(frozen=True)
class Solution:
    """An estimate and how well it fits.

    Parameters
    ----------
    estimate : Estimate
    residuals_s : (n_emissions, n_pairs) array
        Measured minus modelled TDOAs; NaN where missing.
    used : (n_emissions, n_pairs) bool array
        Which TDOAs the estimate rests on.
    robust_sigma_s : float
        1.4826 times the median absolute residual of all TDOAs.
    scale : float
        The same of the residuals over their stated standard deviations; `robust_sigma_s` where none are stated.
    """

    estimate: Estimate
    residuals_s: FloatArray
    used: NDArray[np.bool_]
    robust_sigma_s: float
    scale: float

    @property
    def rms_s(self) -> float:
        """Root mean square of the residuals used."""
        return float(np.sqrt(np.mean(self.residuals_s[self.used] ** 2)))


def solve_joint(problem: TdoaProblem, start: Estimate, prior: SpeedPrior) -> Solution:
    """Find microphones and speed of sound: least squares, then a robust loss, then a re-solve without outliers.

    Raises
    ------
    NotConvergedError
        Levenberg-Marquardt ran out of iterations.
    """
    estimate = levenberg_marquardt(problem, start, problem.information, prior)
    scale = _scale(problem, estimate)
    for _ in range(MAX_ROUNDS):
        robust = _cauchy_weights(problem.residuals(estimate) / problem.tdoa_std_s, scale)
        estimate = levenberg_marquardt(problem, estimate, problem.information * robust / scale**2, prior)
        previous, scale = scale, _scale(problem, estimate)
        if abs(scale - previous) < 1e-3 * scale:
            break
    return _without_outliers(problem, estimate, scale, prior)


def _without_outliers(problem: TdoaProblem, estimate: Estimate, scale: float, prior: SpeedPrior) -> Solution:
    used = np.zeros_like(problem.present)
    for _ in range(MAX_ROUNDS):
        deviations = np.abs(problem.residuals(estimate) / problem.tdoa_std_s)
        inliers = np.nan_to_num(deviations, nan=np.inf) < REJECT_SIGMAS * scale
        if np.array_equal(inliers, used):
            break
        used = inliers
        estimate = refine_joint(problem, estimate, used, scale, prior)
        scale = _scale(problem, estimate)
    residuals_s = problem.residuals(estimate)
    return Solution(estimate, residuals_s, used, robust_sigma(residuals_s), scale)


def refine_joint(
    problem: TdoaProblem, start: Estimate, used: NDArray[np.bool_], scale: float, prior: SpeedPrior
) -> Estimate:
    """Solve again near an estimate, on TDOAs already chosen (n_emissions, n_pairs).

    Raises
    ------
    NotConvergedError
        Levenberg-Marquardt ran out of iterations.
    """
    return levenberg_marquardt(problem, start, used * problem.information / scale**2, prior)


def levenberg_marquardt(problem: TdoaProblem, start: Estimate, weights: FloatArray, prior: SpeedPrior) -> Estimate:
    """Minimise the weighted sum of squared residuals.

    Raises
    ------
    NotConvergedError
        No convergence within MAX_ITERATIONS.
    """
    estimate, converged = descend(problem, start, weights, prior, MAX_ITERATIONS)
    if not converged:
        raise NotConvergedError(
            f"the solve did not settle within {MAX_ITERATIONS} steps: the poses may be too much alike; capture more, "
            "tilted and at several distances"
        )
    return estimate


def descend(
    problem: TdoaProblem, start: Estimate, weights: FloatArray, prior: SpeedPrior, max_iterations: int
) -> tuple[Estimate, bool]:
    """Take Levenberg-Marquardt steps (Marquardt's scaling, doi:10.1137/0111030); tell whether they came to rest."""
    estimate, damping = start, 1e-3
    equations = _with_prior(problem, estimate, weights, prior)
    for _ in range(max_iterations):
        step = _damped_step(equations, damping)
        moved = estimate.moved(step)
        new = _with_prior(problem, moved, weights, prior)
        if new.cost <= equations.cost:
            estimate, equations, damping = moved, new, max(damping / 10, 1e-12)
        else:
            damping *= 10
        if np.linalg.norm(step) < STEP_THRESHOLD_M:
            return estimate, True
    return estimate, False


def robust_sigma(residuals_s: FloatArray) -> float:
    """Return 1.4826 times the median absolute value of the finite residuals: a standard deviation blind to outliers."""
    return max(float(1.4826 * np.median(np.abs(residuals_s[np.isfinite(residuals_s)]))), MIN_SIGMA_S)


def _scale(problem: TdoaProblem, estimate: Estimate) -> float:
    return robust_sigma(problem.residuals(estimate) / problem.tdoa_std_s)


def _cauchy_weights(residuals: FloatArray, scale: float) -> FloatArray:
    return np.asarray(1 / (1 + (np.nan_to_num(residuals) / (CAUCHY_WIDTH * scale)) ** 2))


def _damped_step(equations: NormalEquations, damping: float) -> FloatArray:
    scale = np.sqrt(np.maximum(np.diag(equations.hessian), 1e-300))
    scaled = equations.hessian / np.outer(scale, scale) + damping * np.eye(len(scale))
    return np.asarray(np.linalg.solve(scaled, equations.gradient / scale) / scale)


def _with_prior(problem: TdoaProblem, estimate: Estimate, weights: FloatArray, prior: SpeedPrior) -> NormalEquations:
    """Add the prior of the speed of sound to the TDOAs' normal equations.

    Where pairs say one thing several times over, the prior counts as many times.
    """
    equations = problem.normal_equations(estimate, weights)
    information = problem.overcount / max(prior.std_m_s, 1e-9) ** 2
    deviation = prior.mean_m_s - estimate.speed_of_sound_m_s
    equations.hessian[-1, -1] += information
    equations.gradient[-1] += information * deviation
    return NormalEquations(equations.hessian, equations.gradient, equations.cost + 0.5 * information * deviation**2)
