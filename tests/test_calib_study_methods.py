"""The methods that studies try, on batches: against their plain selves, and against the figures the paper prints."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from conftest import AISLAB, MICROPHONES_M, SPEED_M_S, make_world

pytest.importorskip("pyarrow")

from calib.baseline.batch import PairBatch, against_known, all_pairs, star
from calib.baseline.coordinate_search import ArrayState, search_coordinates
from calib.baseline.gauss_newton import gauss_newton
from calib.baseline.gauss_newton_batch import gauss_newton_together
from calib.baseline.legg_2013 import FlightBatch, legg_2013
from calib.problem import Estimate
from calib.study.bound import rms_bound_m
from calib.study.draws import draw_places
from calib.study.library import find_study, parse_study
from calib.study.pages import printed
from calib.study.part import solve_part
from calib.study.published import read_published
from calib.study.scene import cases, make_scene
from rigs.geometry import rotation_matrix

needs_files = pytest.mark.skipif(not AISLAB.is_dir(), reason="the published files are not in ../shared/data/aislab")
NO_KNOWN = np.zeros((1, 0, 3))


@pytest.mark.parametrize("kind", ["star", "all pairs"])
def test_a_batch_of_gauss_newton_takes_the_steps_of_one(kind):
    worlds = [make_world(pairs=[(0, j) for j in range(1, 8)] if kind == "star" else None, noise_s=1e-5, seed=seed)
              for seed in range(3)]  # fmt: skip
    batch = PairBatch(
        np.array([world.problem.sources_m for world in worlds]),
        np.array([world.problem.tdoa_s for world in worlds]),
        star(8) if kind == "star" else all_pairs(8),
        NO_KNOWN,
        SPEED_M_S,
    )
    starts_m = MICROPHONES_M + np.random.default_rng(0).uniform(-0.1, 0.1, (3, 8, 3))
    runs = gauss_newton_together(batch, starts_m, 1e-6)
    for row, world in enumerate(worlds):
        alone = gauss_newton(world.problem, Estimate(starts_m[row], SPEED_M_S), 1e-6)
        assert runs.n_iterations[row] == alone.n_iterations
        np.testing.assert_allclose(runs.places_m[row], alone.estimate.microphones_m, atol=1e-8)
        assert runs.settled[row]


def test_a_run_that_never_settles_does_not_disturb_the_others():
    world = make_world(noise_s=1e-6)
    batch = PairBatch(
        world.problem.sources_m[None], np.array([world.problem.tdoa_s] * 2), all_pairs(8), NO_KNOWN, SPEED_M_S
    )
    runs = gauss_newton_together(batch, np.array([MICROPHONES_M + 50.0, MICROPHONES_M]), 1e-9)
    assert list(runs.settled) == [False, True]
    assert np.abs(runs.places_m[1] - MICROPHONES_M).max() < 0.01


def known_world(noise_s: float = 0.0):
    world = make_world()
    known_m = np.array([[0.05, 0.02, 0.1]])
    nodes_m = np.vstack([MICROPHONES_M, known_m])
    flights_s = np.linalg.norm(nodes_m - world.problem.sources_m[:, None], axis=2) / SPEED_M_S
    flights_s = flights_s + noise_s * np.random.default_rng(0).standard_normal(flights_s.shape)
    return world.problem.sources_m, flights_s, known_m


def test_the_search_follows_the_rules_as_written_down():
    """One repetition after the other, in plain words, against the batch."""
    sources_m, flights_s, known_m = known_world(1e-5)
    tdoa_s = flights_s @ against_known(8).T
    generator = np.random.default_rng(1)
    boxes_m, origins_m = generator.uniform(0, 0.5, (3, 8, 3)), generator.uniform(-0.3, -0.1, (3, 3))
    batch = PairBatch(sources_m[None], np.array([tdoa_s] * 3), against_known(8), known_m[None], SPEED_M_S)
    found = search_coordinates(batch, ArrayState(np.zeros((3, 3)), origins_m, boxes_m))
    targets_m = tdoa_s * SPEED_M_S + np.linalg.norm(known_m - sources_m, axis=1)[:, None]
    for row in range(2):
        pose, microphones_m = plain_search(sources_m, targets_m, boxes_m[row], origins_m[row])
        np.testing.assert_allclose(np.append(found.turn_rad[row], found.shift_m[row]), pose, atol=1e-12)
        np.testing.assert_allclose(found.microphones_m[row], microphones_m, atol=1e-9)


def plain_search(sources_m, targets_m, microphones_m, origin_m):  # noqa: C901 - it is to be read beside the words
    pose, microphones_m = np.append(np.zeros(3), origin_m), microphones_m.copy()

    def error() -> float:
        places_m = microphones_m @ rotation_matrix(pose[:3]).T + pose[3:]
        return float(np.sum((np.linalg.norm(places_m - sources_m[:, None], axis=2) - targets_m) ** 2))

    def search(values, index, step, logged, sign, trials, early):
        for _ in range(trials):
            old = values[index]
            values[index] = old + sign * step
            logged.append(error())
            if logged[-1] > logged[-2]:
                values[index] = old
                logged.pop()
                if len(logged) >= early:
                    break
                sign = -sign
        return sign

    sign, turn_rad, shift_m = -1, 1e-3, 1e-2
    for _ in range(10):
        logged = [error()]
        for index in range(6):
            sign = search(pose, index, turn_rad if index < 3 else shift_m, logged, sign, 10, 4)
        turn_rad, shift_m = turn_rad / 10, shift_m / 10
        if shift_m < 1e-5:
            break
    sign, step_m = 1, 0.01 / 1.1
    while step_m >= 1e-3:
        logged = [error()]
        for mic in range(8):
            for axis in range(3):
                sign = search(microphones_m[mic], axis, step_m, logged, sign, 20, 10)
        step_m /= 1.1
    return pose, microphones_m


def test_legg_2013_finds_speed_latency_and_microphones_in_spite_of_outliers():
    sources_m, flights_s, known_m = known_world(1e-6)
    arrivals_s = 1.02 * flights_s + 0.0123  # a speed of sound and a latency that nobody told
    arrivals_s[::20, 3] += 1e-3
    batch = FlightBatch(sources_m[None], arrivals_s[None, :, :8], arrivals_s[None, :, 8], known_m)
    start_m = MICROPHONES_M + np.random.default_rng(2).uniform(-0.15, 0.15, (1, 8, 3))
    found_m = legg_2013(batch, start_m)
    assert np.sqrt(np.mean(np.sum((found_m[0] - MICROPHONES_M) ** 2, axis=1))) < 0.01


def scenes_of(study, published):
    return {(case.method, case.noise): make_scene(study, case, published) for case in cases(study)}


@needs_files
def test_table_3_comes_out_to_the_digit():
    study = find_study("table3-as-published")
    scenes = scenes_of(study, read_published(AISLAB))
    for method, expected_mm in {"ours-1": 47.01, "ours-2": 26.06, "ours-3": 61.46}.items():
        columns = solve_part(scenes[method, "measured"], range(4))
        np.testing.assert_allclose(1e3 * columns["paper_rmse_m"], expected_mm, atol=0.005)


@needs_files
@pytest.mark.parametrize(("method", "share", "n"), [("ours-2", 0.06, 100), ("ours-3", 0.06, 100), ("search", 0.25, 25)])
def test_table_2_comes_out_as_printed(method, share, n):
    scenes = scenes_of(find_study("table2-as-published"), read_published(AISLAB))
    for noise, printed_mm in printed("table2")[method].items():
        figures_mm = 1e3 * solve_part(scenes[method, noise], range(n))["paper_rmse_m"]
        assert np.sqrt(np.mean(figures_mm**2)) == pytest.approx(printed_mm, rel=share), noise


SMALL = """
format: acoustic-study
version: 1
name: small
speed_of_sound_m_s: 340
start: {offset_m: [-0.25, -0.25, -0.25]}
known_microphone: {position_m: [0.1, 0.0, 0.1]}
arrays: {cube: {kind: cube}}
boards: {B: {kind: published, layout: B}}
pose_sets: {drawn: {kind: drawn, n_poses: 25}}
noises: {quiet: {law: gaussian, scale_s: 1.0e-6, adds_to: pairs}}
runs:
  - {arrays: [cube], boards: [B], pose_sets: [drawn], noises: [quiet], methods: [ours-1, ours-2, ours-3, joint]}
"""


@pytest.mark.parametrize("adds_to", ["pairs", "arrivals"])
@pytest.mark.parametrize("buzzer_std_m", [0.0, 0.002])
def test_the_bound_is_what_the_best_methods_reach(adds_to, buzzer_std_m):
    text = SMALL.replace("pairs}", f"{adds_to}, buzzer_std_m: {buzzer_std_m}}}")
    study = parse_study(text, "small")
    scenes = scenes_of(study, read_published(None))
    best = "joint" if buzzer_std_m else "ours-2"
    columns = solve_part(scenes[best, "quiet"], range(6 if buzzer_std_m else 200))
    ratio = np.sqrt(np.mean(columns["rmse_m"] ** 2)) / columns["bound_m"][0]
    assert 0.75 < ratio < 1.3 if buzzer_std_m else 0.93 < ratio < 1.07
    if not buzzer_std_m:  # as the paper counts: 7 microphones of 8
        (bound_m,) = rms_bound_m(scenes[best, "quiet"], draw_places(scenes[best, "quiet"], range(1)), 7)
        assert bound_m < 0.99 * columns["bound_m"][0]
        assert np.sqrt(np.mean(columns["paper_rmse_m"] ** 2)) / bound_m == pytest.approx(1, abs=0.07)
    if adds_to == "pairs" and not buzzer_std_m:
        for method in ("ours-1", "ours-3"):
            columns = solve_part(scenes[method, "quiet"], range(200))
            assert np.sqrt(np.mean(columns["rmse_m"] ** 2)) / columns["bound_m"][0] == pytest.approx(1, abs=0.07)


def test_repetitions_are_the_same_in_any_company():
    scene = scenes_of(parse_study(SMALL, "small"), read_published(None))["ours-2", "quiet"]
    scene = replace(scene, n_subset=5)
    whole = solve_part(scene, range(6))
    for part in pairwise((0, 1, 4, 6)):
        columns = solve_part(scene, range(*part))
        for name, column in columns.items():
            np.testing.assert_allclose(column, whole[name][slice(*part)], rtol=1e-7, atol=1e-12)
