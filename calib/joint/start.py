"""A first guess of the microphones from the arrivals alone, so that none is asked of the user.

With d_i = x_i - x_1, q_i = |x_i|^2 - |x_1|^2 and r_k = |x_1 - s_k|, every range difference T_ik of microphone i against
microphone 1 gives

    -2 s_k . d_i + q_i - 2 T_ik r_k = T_ik^2

which is linear in (d_i, q_i, r_k): exact without noise, but biased with it. So it is one candidate beside seeded draws
around the camera. All descend, the best fit wins, and one that fits nearly as well elsewhere is told.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from calib.errors import NotEnoughDataError
from calib.joint.problem import JointProblem
from calib.joint.search import Candidates, RangeTable, descend_together
from calib.joint.unknowns import Unknowns

FloatArray = NDArray[np.float64]

N_DRAWS = 8
MIN_EMISSIONS = 3  # fewer places lie in no plane
MIN_COMMON_EMISSIONS, MAX_COMMON_EMISSIONS = 12, 120
REACH_PERCENTILE = 95.0  # of the arrival differences: a few may be wild
SAME_BASIN_M = 0.02
RIVAL_SCORE = 30.0  # in squared standard deviations


@dataclass(frozen=True)
class Start:
    """Where to start.

    Parameters
    ----------
    at : Unknowns
    rival_m : (n_mics, 3) array or None
        Other places of the microphones that fit nearly as well.
    """

    at: Unknowns
    rival_m: FloatArray | None


def find_start(problem: JointProblem, guess: Unknowns, seed: int) -> Start:
    """Find the microphones, with everything else as `guess` has it.

    Raises
    ------
    NotEnoughDataError
        There is hardly any arrival.
    """
    n_heard = int(problem.arrivals.present.any(axis=1).sum())
    if n_heard < MIN_EMISSIONS:
        raise NotEnoughDataError(
            f"{n_heard} emissions were heard by two microphones or more, at least {MIN_EMISSIONS} are needed: check "
            "buzzers, gains and signal, and capture again"
        )
    table = range_table(problem, guess)
    places_m = np.concatenate([*_closed_form_if_possible(table), _draws(table, seed)])
    found = descend_together(table, places_m)
    best = int(np.argmin(found.scores()))
    mirrored_m = _mirrored(table, found.places_m[best])
    found = _joined(found, descend_together(table, mirrored_m))
    best = int(np.argmin(found.scores()))
    is_free = problem.priors.free[guess.blocks.microphones].reshape(-1, 3)  # one may be known exactly
    return Start(guess.placed(np.where(is_free, found.places_m[best], guess.microphones_m)), _rival(found, best))


def range_table(problem: JointProblem, at: Unknowns) -> RangeTable:
    """Return the arrivals as ranges from emissions at known places."""
    arrivals = problem.arrivals
    sources_m = arrivals.flights(at).arms_m + at.translations_m[arrivals.pose]
    ranges_m = np.where(arrivals.present, arrivals.arrival_s, 0.0)
    speeds_m_s = arrivals.speeds_m_s(at)
    ranges_m = (ranges_m - np.where(arrivals.present, arrivals.delays_s(at), 0.0)) * speeds_m_s
    return RangeTable(sources_m, ranges_m, arrivals.information / speeds_m_s**2)


def _draws(table: RangeTable, seed: int) -> FloatArray:
    present = table.weights > 0
    ranges_m = np.where(present, table.ranges_m, np.nan)[present.any(axis=1)]
    reach_m = float(np.percentile(np.nanmax(ranges_m, axis=1) - np.nanmin(ranges_m, axis=1), REACH_PERCENTILE))
    return np.random.default_rng(seed).uniform(-reach_m, reach_m, size=(N_DRAWS, ranges_m.shape[1], 3))


def _mirrored(table: RangeTable, places_m: FloatArray) -> FloatArray:
    """Return the places with each microphone in turn, then all, on the other side of the plane nearest the sources."""
    centre_m = table.sources_m.mean(axis=0)
    normal = np.linalg.svd(table.sources_m - centre_m, full_matrices=False)[2][2]
    mirrored_m = places_m - 2 * ((places_m - centre_m) @ normal)[:, None] * normal
    n_mics = len(places_m)
    alone = np.where(np.eye(n_mics, dtype=bool)[..., None], mirrored_m, places_m)
    return np.concatenate([alone, mirrored_m[None]])


def _joined(first: Candidates, second: Candidates) -> Candidates:
    return Candidates(
        np.concatenate([first.places_m, second.places_m]),
        np.concatenate([first.scale, second.scale]),
        np.concatenate([first.residuals, second.residuals]),
    )


def _rival(found: Candidates, best: int) -> FloatArray | None:
    apart_m = np.linalg.norm(found.places_m - found.places_m[best], axis=2).max(axis=1)
    scores = np.where(apart_m > SAME_BASIN_M, found.scores() - found.scores()[best], np.inf)
    rival = int(np.argmin(scores))
    return found.places_m[rival] if scores[rival] < RIVAL_SCORE else None


def _closed_form_if_possible(table: RangeTable) -> list[FloatArray]:
    """Return the closed form (1, n_mics, 3) on evenly spread emissions (its cost is cubic), none if too few suit."""
    heard = np.flatnonzero((table.weights > 0).all(axis=1))
    if len(heard) < MIN_COMMON_EMISSIONS:
        return []
    chosen = heard[np.linspace(0, len(heard) - 1, min(len(heard), MAX_COMMON_EMISSIONS)).astype(int)]
    part = replace(
        table, sources_m=table.sources_m[chosen], ranges_m=table.ranges_m[chosen], weights=table.weights[chosen]
    )
    return [closed_form(part)[None]]


def closed_form(table: RangeTable) -> FloatArray:
    """Find all microphones (n_mics, 3) without a first guess, from emissions that all of them heard."""
    ranges_m = table.ranges_m - table.ranges_m[:, :1]
    differences_m, first_range_m = _linear_solution(table.sources_m, ranges_m)
    first_m = _trilaterate(table.sources_m, first_range_m)
    return np.vstack([first_m, first_m + differences_m])


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
