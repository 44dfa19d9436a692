"""What noise adds on average: the model is not linear, so an estimate that scatters is off in the mean.

Where unknowns scatter with a covariance, arrivals and corners are on average not what the mean of the unknowns gives:
distances grow with what a place scatters across them. Moving the unknowns by what explains that difference takes the
first order of the bias away (M. J. Box, J. R. Stat. Soc. B 33 (1971) 171, doi:10.1111/j.2517-6161.1971.tb00871.x). It
is a hundredth of a standard deviation where that is a centimetre, and a tenth where it is a decimetre.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.joint.descend import whole_step
from calib.joint.problem import JointProblem, Weights
from calib.joint.unknowns import Unknowns

FloatArray = NDArray[np.float64]


def without_bias(problem: JointProblem, at: Unknowns, weights: Weights) -> Unknowns:
    """Return the unknowns at an optimum with the first order of their bias taken away.

    Raises
    ------
    numpy.linalg.LinAlgError
        The measurements do not determine all unknowns.
    """
    weights = problem.with_onset_weights(weights, at)
    steps = _expected(problem, at, weights).free_equations(at, weights).step(0.0)
    return at.moved(*whole_step(problem, at, *steps))


def _expected(problem: JointProblem, at: Unknowns, weights: Weights) -> JointProblem:
    """Return the problem with what would be measured on average where the unknowns scatter about these."""
    times_s, pixels = _modelled(problem, at)
    mean_s, mean_px = times_s.copy(), pixels.copy()
    for shared, poses in _scatter(problem, at, weights):
        for side in (-1.0, 1.0):
            there_s, there_px = _modelled(problem, at.moved(side * shared, side * poses))
            mean_s += 0.5 * (there_s - times_s)
            mean_px += 0.5 * (there_px - pixels)
    arrivals = replace(problem.arrivals, arrival_s=np.where(problem.arrivals.present, mean_s, np.nan))
    corners = None if problem.corners is None else replace(problem.corners, seen_px=mean_px)
    onsets = problem.onsets
    if onsets is not None:  # emissions begin at 0 on the axis of these times
        known_s = np.where(np.isfinite(onsets.onset_s), -at.shared[at.blocks.latencies][onsets.latency], np.nan)
        onsets = replace(onsets, onset_s=known_s)
    return JointProblem(arrivals, corners, replace(problem.priors, mean=at.shared), onsets)


def _modelled(problem: JointProblem, at: Unknowns) -> tuple[FloatArray, FloatArray]:
    """Return times of flight (n_emissions, n_mics) and corners (n_poses, n_corners, 2), NaN where not seen."""
    times_s, corners = problem.arrivals.flights(at).times_s, problem.corners
    return times_s, np.zeros(0) if corners is None else corners.seen_px - corners.residuals_px(at)


def _scatter(problem: JointProblem, at: Unknowns, weights: Weights) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Return steps (n_shared,), (n_poses, 6) whose outer products sum up to the covariance of all unknowns."""
    equations = problem.free_equations(at, weights)
    information = equations.complement()
    scale = np.sqrt(np.diag(information))
    spread = np.linalg.inv(np.linalg.cholesky(information / np.outer(scale, scale))) / scale
    followed = np.linalg.solve(equations.poses, equations.border.swapaxes(1, 2)) if len(equations.poses) else None
    for shared in spread:
        poses = np.zeros((0, 6)) if followed is None else -followed @ shared
        yield whole_step(problem, at, shared, poses)
    if followed is not None:
        alone = np.linalg.inv(np.linalg.cholesky(equations.poses))
        for row in range(alone.shape[1]):
            yield np.zeros(at.blocks.size), alone[:, row]
