"""The joint solve, its start, and Gauss-Newton."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import MICROPHONES_M, SPEED_M_S, make_world

from calib.baseline.gauss_newton import draw_start, gauss_newton
from calib.errors import NotEnoughDataError
from calib.problem import Estimate, TdoaProblem
from calib.solve import SpeedPrior, solve_joint
from calib.start import closed_form, consensus_tdoas, find_start

PRIOR = SpeedPrior(342.0, 1.0)


def rmse_m(estimate: Estimate) -> float:
    return float(np.sqrt(np.mean(np.sum((estimate.microphones_m - MICROPHONES_M) ** 2, axis=1))))


def bound_m(problem: TdoaProblem, arrival_sigma_s: float) -> float:
    """Return the Cramer-Rao bound of the RMS microphone error with the speed of sound held and free."""
    truth = Estimate(MICROPHONES_M, SPEED_M_S)
    hessian = problem.normal_equations(truth, np.ones_like(problem.tdoa_s)).hessian / 8 / arrival_sigma_s**2
    hessian[-1, -1] += 1 / PRIOR.std_m_s**2
    return float(np.sqrt(np.trace(np.linalg.inv(hessian)[:-1, :-1]) / 8))


def test_closed_form_is_exact_without_noise():
    world = make_world()
    np.testing.assert_allclose(closed_form(world.problem, SPEED_M_S), MICROPHONES_M, atol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_start_lands_in_the_right_basin(seed):
    world = make_world(noise_s=2e-5, seed=seed)
    assert rmse_m(find_start(world.problem, PRIOR, seed=0)) < 0.1


def test_joint_solve_reaches_the_bound():
    errors = []
    for seed in range(30):
        world = make_world(noise_s=1e-6, seed=seed)
        start = find_start(world.problem, PRIOR, seed=0)
        errors.append(rmse_m(solve_joint(world.problem, start, PRIOR).estimate) / bound_m(world.problem, 1e-6))
    assert np.sqrt(np.mean(np.square(errors))) < 1.15


def test_joint_solve_withstands_ten_percent_outliers():
    world = make_world(noise_s=1e-6, seed=7)
    generator = np.random.default_rng(0)
    wrong = generator.random(world.problem.tdoa_s.shape) < 0.1
    spoilt = np.where(wrong, generator.uniform(-2e-3, 2e-3, wrong.shape), world.problem.tdoa_s)
    problem = replace(world.problem, tdoa_s=spoilt)
    clean = solve_joint(world.problem, find_start(world.problem, PRIOR, seed=0), PRIOR)
    solution = solve_joint(problem, find_start(problem, PRIOR, seed=0), PRIOR)
    assert rmse_m(solution.estimate) < 2 * rmse_m(clean.estimate) + 1e-4
    far_out = np.abs(problem.residuals(solution.estimate)) > 1e-5
    assert not solution.used[far_out].any()
    assert solution.used[~wrong].mean() > 0.99


def test_consensus_outvotes_a_wrong_pair():
    world = make_world()
    spoilt = world.problem.tdoa_s.copy()
    spoilt[:, 2] += 1e-3  # the pair (0, 3)
    consensus_s = consensus_tdoas(replace(world.problem, tdoa_s=spoilt))
    np.testing.assert_allclose(consensus_s[:, 3], world.problem.tdoa_s[:, 2], atol=1e-9)


def test_start_needs_no_emission_that_all_microphones_heard():
    """Each emission misses one microphone, in turn."""
    world = make_world(noise_s=1e-6)
    deaf = np.arange(len(world.problem.tdoa_s)) % 8
    missing = (world.problem.pairs[None] == deaf[:, None, None]).any(axis=2)
    problem = replace(world.problem, tdoa_s=np.where(missing, np.nan, world.problem.tdoa_s))
    assert rmse_m(solve_joint(problem, find_start(problem, PRIOR, seed=0), PRIOR).estimate) < 0.005


def test_start_refuses_nothing_at_all():
    problem = make_world().problem
    with pytest.raises(NotEnoughDataError, match="no TDOA"):
        find_start(replace(problem, tdoa_s=np.full_like(problem.tdoa_s, np.nan)), PRIOR, seed=0)


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
