"""When a session does not support an answer: a clear statement is worth more than wild places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.errors import NotEnoughDataError
from calib.joint.observability import board_tilts_deg
from calib.joint.problem import JointProblem
from calib.joint.robust import JointSolution
from calib.joint.uncertainty import microphone_rms_m, shared_covariance
from calib.joint.unknowns import Blocks

FloatArray = NDArray[np.float64]

MAX_STD_M = 0.05  # of the microphones, root mean square: more is no answer
MAX_REACH_M = 10.0  # a microphone further off is a fit at infinity
ASSUMED_LESS = 10.0  # times the standard deviation of what nobody stated
MAX_GROWTH, HARMLESS_STD_M = 2.0, 0.01
MORE_POSES = "capture more poses, tilted by 30 degrees both ways about both axes and at several distances"


def check_determined(solution: JointSolution, covariance: FloatArray, n_mics: int) -> None:
    """Refuse an answer that is none, or that rests on what was assumed rather than measured.

    What is assumed of intrinsics and delays keeps the solve from running away. Where the microphones would be far less
    certain with a tenth of that assumed, it is not the session that places them. What the user told to hold is relied
    upon, and its error stands in the covariance.

    Raises
    ------
    NotEnoughDataError
    """
    most, least = board_tilts_deg(solution.at.rotations)
    tilts = f"with boards tilted by {most:.0f} and {least:.0f} degrees"
    rms_m = microphone_rms_m(covariance, n_mics)
    far_m = float(np.abs(solution.at.microphones_m[:n_mics]).max())
    if rms_m > MAX_STD_M or far_m > MAX_REACH_M:
        raise NotEnoughDataError(
            f"the session does not place the microphones: they are uncertain by {1e3 * rms_m:.0f} mm and up to "
            f"{far_m:.1f} m away, {tilts}: {MORE_POSES}"
        )
    less = _assuming_less(solution.problem, solution.at.blocks)
    open_m = microphone_rms_m(shared_covariance(less, solution.at, solution.weights()), n_mics)
    if open_m > max(MAX_GROWTH * rms_m, HARMLESS_STD_M):
        raise NotEnoughDataError(
            f"focal length and depth cannot be told apart, {tilts}: what is assumed of the camera places the "
            f"microphones, and without it they are uncertain by {1e3 * open_m:.0f} mm: {MORE_POSES}; or --exact "
            "intrinsics if they are known exactly"
        )


def _assuming_less(problem: JointProblem, blocks: Blocks) -> JointProblem:
    std = problem.priors.std.copy()
    for assumed in (blocks.camera, blocks.delays):
        std[assumed] *= np.where(problem.priors.free[assumed], ASSUMED_LESS, 1.0)
    return replace(problem, priors=replace(problem.priors, std=std))
