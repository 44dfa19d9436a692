"""Gauss-Newton as in the paper: plain least squares, a fixed speed of sound, a first guess drawn at random."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.problem import Estimate, TdoaProblem

FloatArray = NDArray[np.float64]

MAX_ITERATIONS = 50


@dataclass(frozen=True)
class GaussNewtonRun:
    """Where Gauss-Newton ended, whether its last step was under the threshold, and after how many steps."""

    estimate: Estimate
    converged: bool
    n_iterations: int


def draw_start(n_mics: int, low_m: FloatArray, high_m: FloatArray, seed: int) -> FloatArray:
    """Draw a first guess (n_mics, 3), uniform between two corners (3,) in metres."""
    return np.random.default_rng(seed).uniform(low_m, high_m, size=(n_mics, 3))


def gauss_newton(problem: TdoaProblem, start: Estimate, step_threshold_m: float) -> GaussNewtonRun:
    """Minimise the sum of squared TDOA residuals over the microphones (arXiv 2502.06196, section III-B).

    Parameters
    ----------
    problem : TdoaProblem
        Pairs with one reference (Ours-1), all pairs (Ours-2), or pairs with a known microphone (Ours-3).
    start : Estimate
        First guess; its speed of sound is kept.
    step_threshold_m : float
        A step whose norm is smaller is the last.
    """
    weights = np.ones_like(problem.tdoa_s)
    estimate = start
    for iteration in range(1, MAX_ITERATIONS + 1):
        equations = problem.normal_equations(estimate, weights)
        # the speed of sound is the last unknown and is held
        step_m, *_ = np.linalg.lstsq(equations.hessian[:-1, :-1], equations.gradient[:-1], rcond=None)
        estimate = estimate.moved(np.append(step_m, 0.0))
        if np.linalg.norm(step_m) < step_threshold_m:
            return GaussNewtonRun(estimate, True, iteration)
    return GaussNewtonRun(estimate, False, MAX_ITERATIONS)
