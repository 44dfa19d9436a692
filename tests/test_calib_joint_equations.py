"""The joint problem's derivatives, and the elimination of the poses."""

from dataclasses import replace

import numpy as np
import pytest
from measured_rig import bent_rig, make_rig

from calib.joint.problem import JointProblem, Weights
from calib.joint.unknowns import Unknowns, rotation_matrices
from rigs.board import board_corners_m, project
from rigs.description import Intrinsics
from rigs.geometry import Pose, rotation_matrix

N_POSES = 4


@pytest.fixture(scope="module")
def rig():
    return make_rig(0, n_poses=N_POSES, description=bent_rig())


@pytest.fixture(scope="module")
def problem(rig) -> JointProblem:
    problem, _ = rig.assembled(find_delays=True)
    arrival_s = problem.arrivals.arrival_s.copy()
    arrival_s[3, 2] = arrival_s[7, :5] = arrival_s[9, 1:] = np.nan
    seen_px = problem.corners.seen_px.copy()
    seen_px[1, 7] = np.nan
    return replace(
        problem,
        arrivals=replace(problem.arrivals, arrival_s=arrival_s),
        corners=replace(problem.corners, seen_px=seen_px),
    )


@pytest.fixture(scope="module")
def displaced(rig) -> Unknowns:
    generator = np.random.default_rng(1)
    step = 1e-3 * generator.standard_normal(rig.truth.blocks.size) * np.maximum(np.abs(rig.truth.shared), 1e-3)
    return rig.truth.moved(step, 1e-2 * generator.standard_normal((N_POSES, 6)))


@pytest.fixture(scope="module")
def weights(problem) -> Weights:
    generator = np.random.default_rng(2)
    stated = problem.stated_weights()
    return Weights(
        stated.arrivals * generator.uniform(0.5, 2.0, stated.arrivals.shape),
        stated.corners * generator.uniform(0.5, 2.0, stated.corners.shape),
    )


def residuals(problem: JointProblem, at: Unknowns, weights: Weights) -> np.ndarray:
    """Return all residuals, priors among them, over their standard deviations."""
    arrivals = problem.arrivals.residuals_s(at, weights.arrivals) * np.sqrt(weights.arrivals)
    corners = problem.corners.residuals_px(at) * np.sqrt(weights.corners)[..., None]
    priors = (problem.priors.mean - at.shared) * np.sqrt(problem.priors.information)
    return np.nan_to_num(np.concatenate([arrivals.ravel(), corners.ravel(), priors]))


def numeric_jacobian(problem: JointProblem, at: Unknowns, weights: Weights) -> np.ndarray:
    n_shared = at.blocks.size
    sizes = np.full(n_shared + 6 * N_POSES, 1e-6)
    sizes[at.blocks.speed], sizes[at.blocks.delays], sizes[at.blocks.camera] = 1e-4, 1e-8, 1e-5
    columns = []
    for unknown, size in enumerate(sizes):
        step = np.zeros(len(sizes))
        step[unknown] = size
        ahead = at.moved(step[:n_shared], step[n_shared:].reshape(-1, 6))
        behind = at.moved(-step[:n_shared], -step[n_shared:].reshape(-1, 6))
        columns.append((residuals(problem, behind, weights) - residuals(problem, ahead, weights)) / (2 * size))
    return np.array(columns).T


def whole(equations) -> np.ndarray:
    """Return the bordered matrix in full."""
    n_poses, n_shared, _ = equations.border.shape
    out = np.zeros((n_shared + 6 * n_poses, n_shared + 6 * n_poses))
    out[:n_shared, :n_shared] = equations.shared
    for pose in range(n_poses):
        rows = slice(n_shared + 6 * pose, n_shared + 6 * pose + 6)
        out[:n_shared, rows], out[rows, :n_shared] = equations.border[pose], equations.border[pose].T
        out[rows, rows] = equations.poses[pose]
    return out


def test_normal_equations_match_numeric_derivatives(problem, displaced, weights):
    equations = problem.normal_equations(displaced, weights)
    jacobian = numeric_jacobian(problem, displaced, weights)
    expected = jacobian.T @ jacobian
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(whole(equations) / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-6)
    errors = residuals(problem, displaced, weights)
    gradient = np.concatenate([equations.shared_gradient, equations.pose_gradient.ravel()])
    np.testing.assert_allclose(
        gradient / scale, jacobian.T @ errors / scale, rtol=1e-5, atol=1e-5 * np.linalg.norm(errors)
    )
    assert equations.cost == pytest.approx(0.5 * np.sum(errors**2))


def test_poses_are_eliminated_exactly(problem, displaced, weights):
    equations = problem.free_equations(displaced, weights)
    full = whole(equations)
    n_shared = len(equations.shared)
    gradient = np.concatenate([equations.shared_gradient, equations.pose_gradient.ravel()])
    scale = np.sqrt(np.diag(full))
    damped = full / np.outer(scale, scale) + 1e-3 * np.eye(len(full))
    expected = np.linalg.solve(damped, gradient / scale) / scale
    shared, poses = equations.step(1e-3)
    np.testing.assert_allclose(np.concatenate([shared, poses.ravel()]) * scale, expected * scale, rtol=1e-6, atol=1e-9)
    scaled = np.linalg.inv(full / np.outer(scale, scale))[:n_shared, :n_shared]
    complement = equations.complement() / np.outer(scale[:n_shared], scale[:n_shared])
    std = np.sqrt(np.diag(scaled))
    correlation = np.linalg.inv(complement) / np.outer(std, std)
    np.testing.assert_allclose(correlation, scaled / np.outer(std, std), atol=1e-5)


def test_measurements_share_what_they_tell(problem, displaced, weights):
    """The hat matrix has a trace for each kind of measurement, and with the priors' they make all unknowns."""
    equations, free = problem.free_equations(displaced, weights), problem.priors.free
    parts = [part.only(free, poses_free=True) for part in problem.measured_equations(displaced, weights)]
    scale = np.sqrt(np.diag(whole(equations)))
    inverse = np.linalg.inv(whole(equations) / np.outer(scale, scale)) / np.outer(scale, scale)
    found = equations.shares(parts)
    np.testing.assert_allclose(found, [np.trace(inverse @ whole(part)) for part in parts], rtol=1e-5)
    of_priors = np.diag(inverse)[: free.sum()] @ problem.priors.information[free]
    assert sum(found) + of_priors == pytest.approx(len(inverse), rel=1e-5)


def test_what_is_held_has_no_equation(rig):
    problem, at = rig.assembled(hold=("speed", "buzzers", "scale", "corners", "intrinsics", "poses"))
    equations = problem.free_equations(at.placed(rig.truth.microphones_m), problem.stated_weights())
    assert equations.shared.shape == (24, 24)
    assert equations.border.shape[0] == 0


def test_all_pairs_are_arrivals_about_their_weighted_mean(problem, displaced, weights):
    """The sum over all pairs (i, j) with weights w_i w_j / sum w is the same, whatever the values."""
    flights_s = problem.arrivals.flights(displaced).times_s
    offsets_s = problem.arrivals.arrival_s - flights_s
    pairs_cost = 0.0
    for row, weight in zip(offsets_s, weights.arrivals, strict=True):
        heard = np.flatnonzero(weight > 0)
        for i in heard:
            for j in heard[heard > i]:
                pairs_cost += weight[i] * weight[j] / weight[heard].sum() * (row[j] - row[i]) ** 2
    cost = problem.arrivals.normal_equations(displaced, weights.arrivals).cost
    assert cost == pytest.approx(0.5 * pairs_cost, rel=1e-9)


def test_projection_is_opencvs(rig):
    fx, fy, cx, cy, *distortion = rig.truth.camera
    intrinsics = Intrinsics(focal_px=(fx, fy), principal_px=(cx, cy), distortion=tuple(distortion))
    problem, _ = rig.assembled()
    perfect = rig.truth.shared.copy()
    perfect[rig.truth.blocks.scale], perfect[rig.truth.blocks.corners] = 1.0, 0.0
    ours_px = problem.corners.seen_px - problem.corners.residuals_px(replace(rig.truth, shared=perfect))
    pose = Pose(rig.truth.rotations[2], rig.truth.translations_m[2])
    np.testing.assert_allclose(ours_px[2], project(board_corners_m(rig.description.board), pose, intrinsics), atol=1e-9)


def test_rotations_are_rodrigues():
    vectors = np.array([(0.0, 0.0, 0.0), (1e-9, 0.0, 0.0), (0.3, -0.8, 2.0)])
    np.testing.assert_allclose(rotation_matrices(vectors), [rotation_matrix(vector) for vector in vectors], atol=1e-15)


def test_some_of_the_poses(problem, displaced, weights):
    chosen = np.array([True, False, True, False])
    part = problem.only(chosen)
    kept = np.isin(problem.arrivals.pose, [0, 2])
    equations = part.normal_equations(displaced.only(chosen), Weights(weights.arrivals[kept], weights.corners[chosen]))
    out = Weights(np.where(kept[:, None], weights.arrivals, 0.0), weights.corners * chosen[:, None])
    np.testing.assert_allclose(equations.shared, problem.normal_equations(displaced, out).shared, rtol=1e-9)
