"""What the rig description may have wrong: a buzzer's place, the squares, the speed of sound, a late channel.

Such an error bends many measurements at once, so no rejection of single ones helps. The solve is repeated with loose
priors on all of these, and the priors are then drawn tight again by a robust loss of their own, which lets go of the
few that resist. Those are named and left free.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.joint.descend import descend
from calib.joint.problem import JointProblem, Priors
from calib.joint.robust import JointSolution, robust_rounds, solve_robustly
from calib.joint.search import CAUCHY_WIDTH
from calib.joint.uncertainty import shared_covariance
from calib.joint.unknowns import Blocks, Unknowns

FloatArray = NDArray[np.float64]

LOOSE_BUZZER_M, LOOSE_SCALE, LOOSE_SPEED_M_S, LOOSE_DELAY_S = 0.1, 0.1, 20.0, 1e-3
USUAL_DELAY_S = 1e-5  # of a channel that counts as on time
LOOSE_ROUNDS, N_ROUNDS, TIGHTENING_ROUNDS = 10, 8, 2
RELEASE_SIGMAS = 6.0  # beyond the prior, and beyond what the measurements leave open
GAIN = 60.0  # in half squared standard deviations, by loose priors: chance gives 20
REJECTED_SHARE = 0.02  # more rejected than that may be a whole buzzer or channel
TRIAL_STEPS = 3
BETTER = 0.6  # of the misfit, at least, or nothing is explained


@dataclass(frozen=True)
class Suspect:
    """Something that is not as the rig description says.

    Parameters
    ----------
    kind : {"buzzer", "delay", "scale", "speed"}
    number : int
        Of the buzzer, of the channel (session by session), or of the session, from 0; 0 for the scale.
    where : slice
        In the vector of shared unknowns.
    prior_std, loose_std : float
    """

    kind: str
    number: int
    where: slice
    prior_std: float
    loose_std: float


def candidates(blocks: Blocks, priors: Priors) -> list[Suspect]:
    """Return all that may be suspected."""
    n_buzzers, delays = blocks.n_buzzers, blocks.delays.start
    buzzer_std_m = float(priors.std[blocks.buzzers][0])
    out = [Suspect("buzzer", n, blocks.buzzer(n), max(buzzer_std_m, 1e-4), LOOSE_BUZZER_M) for n in range(n_buzzers)]
    if not priors.free[blocks.delays].any():  # else they are found anyway
        out += [
            Suspect("delay", n, slice(delays + n, delays + n + 1), USUAL_DELAY_S, LOOSE_DELAY_S)
            for n in range(blocks.n_sessions * blocks.n_mics)
        ]
    out.append(Suspect("scale", 0, blocks.scale, max(float(priors.std[blocks.scale][0]), 1e-4), LOOSE_SCALE))
    speed = blocks.speed.start
    out += [
        Suspect("speed", n, slice(speed + n, speed + n + 1), max(float(priors.std[speed + n]), 0.1), LOOSE_SPEED_M_S)
        for n in range(blocks.n_sessions)
    ]
    return out


def find_suspects(solution: JointSolution) -> tuple[JointSolution, list[Suspect]]:
    """Return the solution with whatever is suspect left free, and what that is; the same solution where nothing is.

    Raises
    ------
    NotConvergedError
    """
    problem = solution.problem
    groups = candidates(solution.at.blocks, problem.priors)
    loose = _with_stds(problem, groups, [group.loose_std for group in groups])
    if not _worth_it(solution, loose):
        return solution, []
    at, _, _ = robust_rounds(loose, solution.at, LOOSE_ROUNDS)
    for _ in range(N_ROUNDS):
        stds = [_relaxed(group, _deviation(at, problem, group)) for group in groups]
        at, _, _ = robust_rounds(_with_stds(problem, groups, stds), at, TIGHTENING_ROUNDS)
    released = [group for group in groups if _deviation(at, problem, group) > RELEASE_SIGMAS]
    freed, suspects = _confirmed(problem, at, released)
    if not suspects or _misfit(freed, freed.scales.arrivals) > BETTER * _misfit(solution, freed.scales.arrivals):
        return solution, []
    return freed, suspects


def _misfit(solution: JointSolution, scale: float) -> float:
    """Return the mean robust loss of all arrivals at some scale of their standard deviations."""
    table = solution.problem.arrivals
    deviations = (solution.residuals_s() / table.std_s)[table.present]
    return float(np.mean(np.log1p((deviations / (CAUCHY_WIDTH * scale)) ** 2)))


def _worth_it(solution: JointSolution, loose: JointProblem) -> bool:
    """Tell whether loose priors would fit much better, or too much was rejected to tell."""
    rejected = 1 - solution.used_arrivals.sum() / max(solution.problem.arrivals.present.sum(), 1)
    if rejected > REJECTED_SHARE:
        return True
    trial = descend(loose, solution.at, solution.weights(), TRIAL_STEPS)
    return solution.cost - trial.cost > GAIN


def _confirmed(problem: JointProblem, at: Unknowns, released: list[Suspect]) -> tuple[JointSolution, list[Suspect]]:
    """Solve with the suspects free, and let those off whose release explains nothing."""
    while True:
        freed = _with_stds(problem, released, [group.loose_std for group in released])
        solution = solve_robustly(freed, _with_held(freed, at))
        covariance = shared_covariance(freed, solution.at, solution.weights())
        moved = [
            np.linalg.norm(solution.at.shared[group.where] - problem.priors.mean[group.where])
            / np.sqrt(group.prior_std**2 + np.trace(covariance[group.where, group.where]))
            for group in released
        ]
        if not released or min(moved) > RELEASE_SIGMAS:
            return solution, released
        released = [group for group, z in zip(released, moved, strict=True) if z > min(moved)]


def _with_held(problem: JointProblem, at: Unknowns) -> Unknowns:
    """Return the values with what the problem holds where it is held."""
    return replace(at, shared=np.where(problem.priors.free, at.shared, problem.priors.mean))


def _deviation(at: Unknowns, problem: JointProblem, group: Suspect) -> float:
    moved = at.shared[group.where] - problem.priors.mean[group.where]
    return float(np.linalg.norm(moved) / group.prior_std / np.sqrt(len(moved)))


def _relaxed(group: Suspect, deviation: float) -> float:
    """Return the standard deviation that a Cauchy loss of the prior amounts to."""
    return min(group.prior_std * float(np.sqrt(1 + (deviation / CAUCHY_WIDTH) ** 2)), group.loose_std)


def _with_stds(problem: JointProblem, groups: list[Suspect], stds: list[float]) -> JointProblem:
    priors = problem.priors
    for group, std in zip(groups, stds, strict=True):
        priors = priors.with_std(group.where, std)
    return replace(problem, priors=priors)
