"""The residuals and their derivatives."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import MICROPHONES_M, make_world

from calib.problem import Estimate


def displaced(seed: int = 3) -> Estimate:
    noise = np.random.default_rng(seed).normal(scale=0.05, size=MICROPHONES_M.shape)
    return Estimate(MICROPHONES_M + noise, 340.0)


def test_residuals_vanish_at_the_truth():
    world = make_world()
    assert np.abs(world.problem.residuals(world.truth)).max() < 1e-15


def test_tdoa_is_arrival_at_j_minus_arrival_at_i():
    world = make_world(pairs=[(0, 1)], n_poses=4)
    nearer_to_second = np.linalg.norm(MICROPHONES_M[1] - world.problem.sources_m, axis=1) < np.linalg.norm(
        MICROPHONES_M[0] - world.problem.sources_m, axis=1
    )
    assert np.array_equal(world.problem.tdoa_s[:, 0] < 0, nearer_to_second)


@pytest.mark.parametrize("pairs", [None, [(0, j) for j in range(1, 8)]])
def test_gradient_and_hessian_match_numeric_differences(pairs):
    problem = make_world(pairs=pairs, n_poses=5).problem
    estimate, weights = displaced(), np.random.default_rng(1).uniform(0.1, 2.0, problem.tdoa_s.shape)
    equations = problem.normal_equations(estimate, weights)
    columns = []
    for unknown in range(25):
        step = np.zeros(25)
        step[unknown] = 1e-6
        ahead, behind = problem.residuals(estimate.moved(step)), problem.residuals(estimate.moved(-step))
        columns.append((ahead - behind).ravel() / 2e-6)
    jacobian = np.array(columns).T
    weighted = jacobian * weights.ravel()[:, None]
    np.testing.assert_allclose(equations.hessian, weighted.T @ jacobian, rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(
        equations.gradient, -weighted.T @ problem.residuals(estimate).ravel(), rtol=1e-5, atol=1e-12
    )
    assert equations.cost == pytest.approx(0.5 * np.sum(weights * problem.residuals(estimate) ** 2))


def test_missing_tdoas_do_not_count():
    whole = make_world(noise_s=1e-5).problem
    kept = np.random.default_rng(5).random(whole.tdoa_s.shape) < 0.7
    holed = replace(whole, tdoa_s=np.where(kept, whole.tdoa_s, np.nan))
    ones = np.ones_like(whole.tdoa_s)
    np.testing.assert_allclose(
        holed.normal_equations(displaced(), ones).hessian,
        whole.normal_equations(displaced(), kept.astype(float)).hessian,
    )


def test_all_pairs_are_arrivals_minus_their_mean():
    """Facts of least squares: the N(N-1)/2 pairs cost N times the centred arrivals, whatever the estimate."""
    world = make_world(noise_s=2e-5)
    estimate = displaced()
    distances_m, _ = world.problem.distances(estimate)
    rows = np.zeros((len(distances_m), 8))
    rows[:, 1:] = world.problem.tdoa_s[:, :7]
    errors_s = rows - distances_m / estimate.speed_of_sound_m_s
    centred = errors_s - errors_s.mean(axis=1, keepdims=True)
    cost = world.problem.normal_equations(estimate, np.ones_like(world.problem.tdoa_s)).cost
    assert cost == pytest.approx(0.5 * 8 * np.sum(centred**2), rel=1e-9)
