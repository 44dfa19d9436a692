"""A first guess from the TDOAs alone, so that none is asked of the user.

With d_i = x_i - x_1, q_i = |x_i|^2 - |x_1|^2 and r_k = |x_1 - s_k|, every TDOA T_ik of microphone i against
microphone 1 gives

    -2 s_k . d_i + q_i - 2 c T_ik r_k = c^2 T_ik^2

which is linear in (d_i, q_i, r_k): exact without noise, but biased with it. So it is one candidate beside seeded draws
around the camera; each descends for a while on arrivals that outvoted their outliers, and the best fit wins.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from calib.errors import NotEnoughDataError
from calib.problem import Estimate, TdoaProblem
from calib.solve import SpeedPrior, descend, robust_sigma

FloatArray = NDArray[np.float64]

N_DRAWS = 8
DESCENT_ITERATIONS = 40
MIN_COMMON_EMISSIONS, MAX_COMMON_EMISSIONS = 12, 200


def find_start(problem: TdoaProblem, prior: SpeedPrior, seed: int) -> Estimate:
    """Find a first guess in the right basin.

    Raises
    ------
    NotEnoughDataError
        There is no TDOA at all.
    """
    if not problem.present.any():
        raise NotEnoughDataError("no TDOA was measured: check buzzers, gains and signal, and capture again")
    consensus = _consensus_problem(problem)
    reach_m = prior.mean_m_s * float(np.nanmax(np.abs(consensus.tdoa_s)))
    draws = np.random.default_rng(seed).uniform(-reach_m, reach_m, size=(N_DRAWS, problem.n_mics, 3))
    candidates = [*_closed_form_if_possible(consensus, prior.mean_m_s), *draws]
    held = SpeedPrior(prior.mean_m_s, 0.0)
    weights = consensus.present.astype(float)
    descents = [
        descend(consensus, Estimate(candidate, prior.mean_m_s), weights, held, DESCENT_ITERATIONS)[0]
        for candidate in candidates
    ]
    return min(descents, key=lambda estimate: robust_sigma(consensus.residuals(estimate)))


def _consensus_problem(problem: TdoaProblem) -> TdoaProblem:
    """Return the same problem with one consensus TDOA per microphone, against the first."""
    n_nodes = problem.incidence.shape[1]
    pairs = np.column_stack([np.zeros(n_nodes - 1), np.arange(1, n_nodes)]).astype(np.int32)
    return replace(problem, tdoa_s=consensus_tdoas(problem)[:, 1:], pairs=pairs)


def _closed_form_if_possible(problem: TdoaProblem, speed_of_sound_m_s: float) -> list[FloatArray]:
    """Return the closed form on evenly spread emissions (its cost is cubic in them), none if too few suit."""
    heard = np.flatnonzero(np.isfinite(problem.tdoa_s).all(axis=1))
    if len(heard) < MIN_COMMON_EMISSIONS:
        return []
    chosen = np.zeros(len(problem.tdoa_s), dtype=bool)
    chosen[heard[np.linspace(0, len(heard) - 1, min(len(heard), MAX_COMMON_EMISSIONS)).astype(int)]] = True
    return [closed_form(problem.only(chosen), speed_of_sound_m_s)]


def closed_form(problem: TdoaProblem, speed_of_sound_m_s: float) -> FloatArray:
    """Find all microphones (n_mics, 3) without a first guess, from emissions that all of them heard."""
    ranges_m = speed_of_sound_m_s * consensus_tdoas(problem)[:, : problem.n_mics]
    differences_m, first_range_m = _linear_solution(problem.sources_m, ranges_m)
    first_m = _trilaterate(problem.sources_m, first_range_m)
    return np.vstack([first_m, first_m + differences_m])


def consensus_tdoas(problem: TdoaProblem) -> FloatArray:
    """Return TDOAs (n_emissions, n_nodes) against microphone 1, in seconds, each the median over all two-pair ways.

    A single wrong pair is outvoted where all pairs were measured; NaN where there is no way.
    """
    n_nodes = problem.incidence.shape[1]
    table = np.full((len(problem.tdoa_s), n_nodes, n_nodes), np.nan)
    table[:, np.arange(n_nodes), np.arange(n_nodes)] = 0.0
    for column, (i, j) in enumerate(problem.pairs):
        table[:, i, j] = problem.tdoa_s[:, column]
        table[:, j, i] = -problem.tdoa_s[:, column]
    out = np.full((len(table), n_nodes), np.nan)
    for node in range(n_nodes):
        ways = table[:, 0, :] + table[:, :, node]
        some = np.isfinite(ways).any(axis=1)
        out[some, node] = np.nanmedian(ways[some], axis=1)
    return out


def _linear_solution(sources_m: FloatArray, ranges_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solve the linear equations: differences d_i (n_mics - 1, 3), and distances of microphone 1 (n_emissions,)."""
    n_emissions, n_mics = ranges_m.shape
    coefficients = np.zeros((n_emissions, n_mics - 1, 4 * (n_mics - 1) + n_emissions))
    for mic in range(n_mics - 1):
        coefficients[:, mic, 4 * mic : 4 * mic + 3] = -2 * sources_m
        coefficients[:, mic, 4 * mic + 3] = 1.0
    emission = np.arange(n_emissions)
    coefficients[emission, :, 4 * (n_mics - 1) + emission] = -2 * ranges_m[:, 1:]
    rows = coefficients.reshape(-1, coefficients.shape[2])
    solution = np.asarray(np.linalg.lstsq(rows, (ranges_m[:, 1:] ** 2).ravel(), rcond=None)[0], dtype=float)
    return solution[: 4 * (n_mics - 1)].reshape(-1, 4)[:, :3], np.abs(solution[4 * (n_mics - 1) :])


def _trilaterate(sources_m: FloatArray, ranges_m: FloatArray) -> FloatArray:
    """Find the place (3,) at given distances from known places; of two mirrored ones the better."""
    centre_m = sources_m.mean(axis=0)
    normal = np.linalg.svd(sources_m - centre_m)[2][2]
    spread_m = float(np.median(ranges_m))
    results = [
        least_squares(
            lambda place: np.linalg.norm(place - sources_m, axis=1) - ranges_m,
            centre_m + side * spread_m * normal,
            loss="soft_l1",
            f_scale=0.05,
        )
        for side in (-1.0, 1.0)
    ]
    return np.asarray(min(results, key=lambda result: result.cost).x)
