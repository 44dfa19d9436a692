"""The methods that a study tries, each on a batch of repetitions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.baseline.batch import FloatArray, PairBatch, against_known, all_pairs, star
from calib.baseline.coordinate_search import ArrayState, search_coordinates
from calib.baseline.gauss_newton import MAX_ITERATIONS
from calib.baseline.gauss_newton_batch import gauss_newton_together
from calib.baseline.legg_2013 import FlightBatch, legg_2013
from calib.errors import CalibrationError
from calib.joint.arrivals import ArrivalTable
from calib.joint.problem import JointProblem, Priors
from calib.joint.robust import solve_robustly
from calib.joint.start import find_start
from calib.joint.unknowns import Unknowns
from calib.methods import MAX_REACH_M, STEP_THRESHOLDS_M
from calib.study.description import MeasuredNoise
from calib.study.draws import Places, draw_starts, measure_arrivals, measure_pairs
from calib.study.scene import Scene
from rigs.geometry import Pose

SAME_OPTIMUM_M = 1e-3


@dataclass(frozen=True)
class Solved:
    """Answers of several repetitions.

    Parameters
    ----------
    places_m : (n, n_mics, 3) array
    settled : (n,) bool array
        The method converged, to a place that is not far away.
    at_optimum : (n,) array
        1 where it is what a start at the truth leads to, 0 where not, NaN where the method knows no such thing.
    n_iterations : (n,) integer array
        0 where the method does not count.
    """

    places_m: FloatArray
    settled: NDArray[np.bool_]
    at_optimum: FloatArray
    n_iterations: NDArray[np.intp]


def solve_repetitions(scene: Scene, places: Places, repetitions: range) -> Solved:
    """Measure and solve repetitions of a scene by its method."""
    if scene.method == "joint":
        return _joint(scene, places, repetitions)
    if scene.method == "legg-2013":
        return _legg_2013(scene, places, repetitions)
    if scene.method == "search":
        return _search(scene, places, repetitions)
    return _gauss_newton(scene, places, repetitions)


def _pairs(scene: Scene, places: Places, repetitions: range) -> PairBatch:
    n_mics = len(scene.microphones_m)
    incidence = {"ours-1": star, "ours-2": all_pairs, "joint": all_pairs}.get(scene.method, against_known)(n_mics)
    known_m = scene.known_m if incidence.shape[1] > n_mics and scene.known_m is not None else np.zeros((0, 3))
    tdoa_s = measure_pairs(scene, places, repetitions, incidence)
    return PairBatch(places.told_m, tdoa_s, incidence, known_m[None], scene.speed_m_s)


def _gauss_newton(scene: Scene, places: Places, repetitions: range) -> Solved:
    batch, threshold_m = _pairs(scene, places, repetitions), STEP_THRESHOLDS_M[scene.method]
    boxes_m, origins_m = draw_starts(scene, repetitions)
    runs = gauss_newton_together(batch, boxes_m + origins_m[:, None], threshold_m, MAX_ITERATIONS)
    best = gauss_newton_together(batch, scene.microphones_m[None], threshold_m, MAX_ITERATIONS)
    settled = runs.settled & _near(runs.places_m)
    return Solved(runs.places_m, settled, _same(runs.places_m, best.places_m, settled), runs.n_iterations)


def _search(scene: Scene, places: Places, repetitions: range) -> Solved:
    boxes_m, origins_m = draw_starts(scene, repetitions)
    start = ArrayState(np.zeros_like(origins_m), origins_m, boxes_m)
    found = search_coordinates(_pairs(scene, places, repetitions), start)
    places_m = found.places_m()
    if scene.search_judged_in == "array frame":
        places_m = found.microphones_m + scene.microphones_m[0]
    return _uncounted(places_m)


def _legg_2013(scene: Scene, places: Places, repetitions: range) -> Solved:
    assert scene.known_m is not None
    arrival_s = measure_arrivals(scene, places, repetitions)
    told_m = np.broadcast_to(places.told_m, (len(repetitions), *places.told_m.shape[1:]))
    boxes_m, origins_m = draw_starts(scene, repetitions)
    batch = FlightBatch(told_m, arrival_s[..., :-1], arrival_s[..., -1], scene.known_m)
    return _uncounted(legg_2013(batch, boxes_m + origins_m[:, None]))


def _uncounted(places_m: FloatArray) -> Solved:
    n = len(places_m)
    return Solved(places_m, _near(places_m), np.full(n, np.nan), np.zeros(n, dtype=np.intp))


def _joint(scene: Scene, places: Places, repetitions: range) -> Solved:
    """Solve by this project's own method, with poses and speed of sound held as the paper holds them."""
    batch = _pairs(scene, places, repetitions)
    arrivals_s = batch.tdoa_s @ batch.incidence / len(scene.microphones_m)  # least squares of the pairs
    results = [
        _joint_once(scene, places.poses[row if len(places.poses) > 1 else 0], arrival_s)
        for row, arrival_s in enumerate(arrivals_s)
    ]
    found_m, best_m = np.array([found for found, _ in results]), np.array([best for _, best in results])
    settled = _near(found_m)
    return Solved(found_m, settled, _same(found_m, best_m, settled), np.zeros(len(found_m), dtype=np.intp))


def _joint_once(scene: Scene, poses: NDArray[np.intp], arrival_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what is found without a first guess, and from the truth as the first guess; NaN where nothing is."""
    problem, truth = joint_problem(scene, poses, arrival_s)
    nowhere = np.full_like(scene.microphones_m, np.nan)
    try:
        guess = find_start(problem, truth.placed(np.zeros_like(scene.microphones_m)), 0).at
        found_m = solve_robustly(problem, guess).at.microphones_m
    except (CalibrationError, np.linalg.LinAlgError):
        return nowhere, nowhere
    try:
        return found_m, solve_robustly(problem, truth).at.microphones_m
    except (CalibrationError, np.linalg.LinAlgError):
        return found_m, nowhere


def joint_problem(scene: Scene, poses: NDArray[np.intp], arrival_s: FloatArray) -> tuple[JointProblem, Unknowns]:
    """Return the joint problem of one repetition, arrivals (n_emissions, n_mics), and the truth."""
    held = [Pose(scene.rotations[pose], scene.translations_m[pose]) for pose in poses]
    truth = Unknowns.of(scene.microphones_m, scene.speed_m_s, scene.buzzers_m, np.zeros(9), held)
    std = np.zeros(truth.blocks.size)
    std[truth.blocks.microphones] = np.inf
    std[truth.blocks.buzzers] = 0.0 if isinstance(scene.noise, MeasuredNoise) else scene.noise.buzzer_std_m
    n_buzzers = len(scene.buzzers_m)
    table = ArrivalTable(
        np.repeat(np.arange(len(poses)), n_buzzers),
        np.tile(np.arange(n_buzzers), len(poses)),
        arrival_s,
        np.full_like(arrival_s, 1e-6),
    )
    return JointProblem(table, None, Priors(truth.shared, std, poses_held=True)), truth


def _near(places_m: FloatArray) -> NDArray[np.bool_]:
    return np.asarray(np.abs(places_m).max(axis=(1, 2)) < MAX_REACH_M)


def _same(found_m: FloatArray, best_m: FloatArray, settled: NDArray[np.bool_]) -> FloatArray:
    apart_m = np.linalg.norm(found_m - best_m, axis=2).max(axis=1)
    return np.asarray((settled & (apart_m < SAME_OPTIMUM_M)).astype(float))
