"""How sure the answer is: the covariance of all shared unknowns, the poses eliminated.

At the optimum the inverse of the normal equations is the covariance of the estimate (to first order), and with the true
values and variances in it the Cramer-Rao bound. Priors count as measurements. Values that are held pass their own
errors on (`held.py`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.errors import NotEnoughDataError
from calib.joint.equations import NormalEquations
from calib.joint.held import described_errors
from calib.joint.problem import JointProblem, Weights
from calib.joint.unknowns import Unknowns

FloatArray = NDArray[np.float64]

SINGULAR = 1e-13


def shared_covariance(problem: JointProblem, at: Unknowns, weights: Weights) -> FloatArray:
    """Return the covariance (n_shared, n_shared) of the shared unknowns; 0 for those that are known exactly.

    Raises
    ------
    NotEnoughDataError
        The measurements do not determine all unknowns.
    """
    free, equations = problem.priors.free, problem.normal_equations(at, weights)
    information = equations.shared if problem.priors.poses_held else equations.complement()
    covariance = np.zeros((at.blocks.size, at.blocks.size))
    covariance[np.ix_(free, free)] = inverse = _inverse(information[np.ix_(free, free)])
    if problem.priors.poses_held or np.any(problem.priors.held):
        steps = _steps_of_held(problem, equations, information)
        steps[:, free] = -steps[:, free] @ inverse
        covariance += steps.T @ steps
    return covariance


def _inverse(information: FloatArray) -> FloatArray:
    scale = np.sqrt(np.diag(information))
    if not (scale > 0).all():
        raise _undetermined()
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    if values[0] < SINGULAR * values[-1]:
        raise _undetermined()
    return np.asarray((vectors / values) @ vectors.T / np.outer(scale, scale))


def _steps_of_held(problem: JointProblem, equations: NormalEquations, information: FloatArray) -> FloatArray:
    """Return each source's step of what is held (n_sources, n_shared); in the free columns its pull on these."""
    priors, fit = problem.priors, problem.fit
    if fit is None:
        steps = described_errors(priors.std)
        steps[:, priors.free] = 0.0
        steps[:, priors.free] = steps @ information[:, priors.free]
        return steps
    errors = fit.errors(priors.std)
    steps = np.where(priors.free, 0.0, errors.shared)
    pulls = steps @ information[:, priors.free]
    if priors.poses_held:
        pulls += np.einsum("npk,psk->ns", errors.poses, equations.border[:, priors.free], optimize=True)
    steps[:, priors.free] = pulls
    if not priors.poses_held:
        return steps
    alone = np.zeros((errors.alone.shape[0] * errors.alone.shape[1], steps.shape[1]))
    pulls = errors.alone @ equations.border[:, priors.free].swapaxes(1, 2)
    alone[:, priors.free] = pulls.reshape(len(alone), -1)
    return np.vstack([steps, alone])


def microphone_covariances(covariance: FloatArray, n_mics: int) -> FloatArray:
    """Return the blocks (n_mics, 3, 3) of the microphones."""
    return np.array([covariance[start : start + 3, start : start + 3] for start in range(0, 3 * n_mics, 3)])


def microphone_rms_m(covariance: FloatArray, n_mics: int) -> float:
    """Return the root mean square error of the microphones that a covariance promises: of a bound, the bound."""
    return float(np.sqrt(np.trace(covariance[: 3 * n_mics, : 3 * n_mics]) / n_mics))


def _undetermined() -> NotEnoughDataError:
    return NotEnoughDataError(
        "the measurements do not determine all microphones: capture a session with more poses, tilted both ways and at "
        "several distances"
    )
