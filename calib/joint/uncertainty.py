"""How sure the answer is: the covariance of all shared unknowns, the poses eliminated.

At the optimum the inverse of the normal equations is the covariance of the estimate (to first order), and with the true
values and variances in it the Cramer-Rao bound. Priors count as measurements.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.errors import NotEnoughDataError
from calib.joint.problem import JointProblem, Weights
from calib.joint.unknowns import Unknowns

FloatArray = NDArray[np.float64]

SINGULAR = 1e-13


def shared_covariance(problem: JointProblem, at: Unknowns, weights: Weights) -> FloatArray:
    """Return the covariance (n_shared, n_shared) of the shared unknowns; 0 for those that are held.

    Raises
    ------
    NotEnoughDataError
        The measurements do not determine all unknowns.
    """
    free = problem.priors.free
    information = problem.free_equations(at, weights).complement()
    scale = np.sqrt(np.diag(information))
    if not (scale > 0).all():
        raise _undetermined()
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    if values[0] < SINGULAR * values[-1]:
        raise _undetermined()
    covariance = np.zeros((at.blocks.size, at.blocks.size))
    covariance[np.ix_(free, free)] = (vectors / values) @ vectors.T / np.outer(scale, scale)
    return covariance


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
