"""Gauss-Newton as in the paper."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import MICROPHONES_M, SPEED_M_S, make_world

from calib.baseline.gauss_newton import draw_start, gauss_newton
from calib.problem import Estimate


def rmse_m(estimate: Estimate) -> float:
    return float(np.sqrt(np.mean(np.sum((estimate.microphones_m - MICROPHONES_M) ** 2, axis=1))))


@pytest.mark.parametrize("pairs", [None, [(0, j) for j in range(1, 8)]])
def test_gauss_newton_finds_the_truth_from_a_near_start(pairs):
    world = make_world(pairs=pairs)
    start = MICROPHONES_M + np.random.default_rng(0).uniform(-0.05, 0.05, MICROPHONES_M.shape)
    run = gauss_newton(world.problem, Estimate(start, SPEED_M_S), 1e-9)
    assert run.converged
    assert rmse_m(run.estimate) < 1e-9
    assert run.estimate.speed_of_sound_m_s == SPEED_M_S


def test_gauss_newton_uses_a_known_microphone():
    world = make_world(noise_s=0.0)
    known_m = np.array([[0.05, 0.02, 0.1]])
    flights_s = (
        np.linalg.norm(np.vstack([MICROPHONES_M, known_m]) - world.problem.sources_m[:, None], axis=2) / SPEED_M_S
    )
    problem = replace(
        world.problem,
        tdoa_s=flights_s[:, :8] - flights_s[:, 8:],
        pairs=np.array([(8, j) for j in range(8)], dtype=np.int32),
        known_m=known_m,
    )
    start = MICROPHONES_M + np.random.default_rng(0).uniform(-0.05, 0.05, MICROPHONES_M.shape)
    assert rmse_m(gauss_newton(problem, Estimate(start, SPEED_M_S), 1e-9).estimate) < 1e-9


def test_gauss_newton_says_when_it_did_not_settle():
    world = make_world()
    run = gauss_newton(world.problem, Estimate(MICROPHONES_M + 50.0, SPEED_M_S), 1e-12)
    assert not run.converged


def test_drawn_starts_are_in_the_box_and_repeat():
    low, high = np.array([0.0, -1.0, 2.0]), np.array([0.5, 1.0, 3.0])
    start = draw_start(8, low, high, seed=4)
    assert ((start >= low) & (start <= high)).all()
    np.testing.assert_array_equal(start, draw_start(8, low, high, seed=4))
    assert not np.array_equal(start, draw_start(8, low, high, seed=5))
