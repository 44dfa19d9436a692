"""Evaluation, uncertainty, and the result file."""

import numpy as np
import pytest

from calib.evaluation import evaluate
from calib.uncertainty import jackknife_covariance, pose_groups
from rigs.geometry import Pose


def square_array() -> np.ndarray:
    return np.array([(x, y, z) for x in (0.0, 0.4) for y in (0.0, 0.4) for z in (0.0, 0.4)])


def test_a_rigid_motion_shows_in_rmse_only():
    motion = Pose.from_rotation_vector(np.array([0.0, 0.1, 0.05]), np.array([0.01, 0.0, -0.02]))
    evaluation = evaluate(motion.apply(square_array()), square_array(), "test")
    assert evaluation.rmse_m > 0.01
    assert evaluation.rmse_aligned_m < 1e-12
    assert evaluation.distance_rmse_m < 1e-12


def test_figures_of_a_known_error():
    moved = square_array()
    moved[7, 0] += 0.08  # the microphone that the paper's figure leaves out
    evaluation = evaluate(moved, square_array(), "test")
    assert evaluation.rmse_m == pytest.approx(0.08 / np.sqrt(8))
    assert evaluation.paper_rmse_m == 0.0
    moved[0, 1] -= 0.04
    assert evaluate(moved, square_array(), "test").paper_rmse_m == pytest.approx(0.04 / np.sqrt(8))


def test_paper_figure_needs_eight_microphones():
    assert evaluate(square_array()[:7], square_array()[:7], "test").paper_rmse_m is None


def test_mirrored_array_is_not_aligned_away():
    lopsided = square_array() + 0.1 * np.random.default_rng(0).uniform(-1, 1, (8, 3))
    evaluation = evaluate(lopsided * (-1, 1, 1), lopsided, "test")
    assert evaluation.rmse_aligned_m > 0.02
    assert evaluation.distance_rmse_m < 1e-12


def test_jackknife_of_a_mean_is_its_standard_error():
    generator = np.random.default_rng(0)
    values = generator.normal(size=(25, 2)) * (1.0, 3.0)
    poses = np.arange(25, dtype=np.int32)
    covariance = jackknife_covariance(poses, lambda out: values[~np.isin(poses, out)].mean(axis=0))
    np.testing.assert_allclose(covariance, np.cov(values.T) / 25, rtol=1e-9)


def test_groups_hold_every_pose_once():
    poses = np.arange(100, 169, dtype=np.int32)
    groups = pose_groups(poses)
    assert len(groups) == 30
    assert sorted(np.concatenate(groups)) == list(poses)
