"""Every warning, each provoked by what it warns of."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from conftest import make_world, write_measured_session

from calib.doubts import noise_doubts
from calib.flaws import Flaws
from calib.pipeline import calibrate
from calib.result import Calibration
from calib.settings import Settings
from calib.sound import SoundArrivals
from rigs.description import Medium, RigDescription
from rigs.session.reader import Session


def calibrated(path: Path, **settings) -> Calibration:
    with Session.open(path) as session:
        return calibrate(session, Settings(**settings))


def with_board(description: RigDescription, **changes) -> RigDescription:
    return description.model_copy(update={"board": description.board.model_copy(update=changes)})


def test_swapped_buzzers_are_named(tmp_path, simulated_description):
    first, second, third, *others = simulated_description.board.buzzers
    swapped = (
        first.model_copy(update={"position_m": third.position_m}),
        second,
        third.model_copy(update={"position_m": first.position_m}),
        *others,
    )
    path = write_measured_session(tmp_path / "s.h5", with_board(simulated_description, buzzers=swapped))
    result = calibrated(path)
    assert result.evaluation.rmse_m < 0.003
    assert any("buzzer 1 and 3" in warning for warning in result.warnings)


def test_many_outliers_are_told(tmp_path, simulated_description):
    tdoa_s = make_world(n_poses=12, noise_s=1e-6).problem.tdoa_s
    generator = np.random.default_rng(0)
    wrong = generator.random(tdoa_s.shape) < 0.2
    tdoa_s = np.where(wrong, generator.uniform(-2e-3, 2e-3, tdoa_s.shape), tdoa_s)
    result = calibrated(write_measured_session(tmp_path / "s.h5", simulated_description, tdoa_s=tdoa_s))
    assert any("of the TDOAs do not fit" in warning for warning in result.warnings)
    assert result.residual.n_rejected == pytest.approx(wrong.sum(), rel=0.02)


def test_scattered_tdoas_are_told(tmp_path, simulated_description):
    result = calibrated(write_measured_session(tmp_path / "s.h5", simulated_description, noise_s=2e-5))
    assert any(warning.startswith("TDOAs scatter by") for warning in result.warnings)
    assert any("uncertain by" in warning for warning in result.warnings)


def test_a_wrong_speed_of_sound_is_told(tmp_path, simulated_description):
    cold = simulated_description.model_copy(update={"medium": Medium(temperature_c=0.0)})
    tdoa_s = make_world(n_poses=12, noise_s=1e-6).problem.tdoa_s
    result = calibrated(write_measured_session(tmp_path / "s.h5", cold, tdoa_s=tdoa_s))
    assert any("the speed of sound came out at" in warning for warning in result.warnings)


def test_blurred_corners_are_told(tmp_path, simulated_description):
    path = write_measured_session(tmp_path / "s.h5", simulated_description)
    with h5py.File(path, "r+") as file:
        file["measured/corners"][:] += np.random.default_rng(0).normal(scale=0.6, size=file["measured/corners"].shape)
    assert any("corners fit the camera to" in warning for warning in calibrated(path).warnings)


def test_a_session_that_was_cut_off_is_told(tmp_path, simulated_description):
    path = write_measured_session(tmp_path / "s.h5", simulated_description)
    with h5py.File(path, "r+") as file:
        file["state"][0] = 0
    assert any("cut off" in warning for warning in calibrated(path).warnings)


def test_poses_with_too_few_corners_are_left_out(tmp_path, simulated_description):
    path = write_measured_session(tmp_path / "s.h5", simulated_description)
    with h5py.File(path, "r+") as file:
        file["measured/corners"][3] = np.nan
        file["measured/corners"][5, 4:] = np.nan
        file["measured/corners"][7, 0] = 1e300
    result = calibrated(path)
    assert [warning for warning in result.warnings if "left out" in warning] == [
        "pose 3 left out: only 0 corners of the board were seen",
        "pose 5 left out: only 4 corners of the board were seen",
    ]
    assert len(result.view.board_to_camera) == 10
    assert result.evaluation.rmse_m < 0.003


def test_poses_may_have_any_numbers(tmp_path, simulated_description):
    plain = calibrated(write_measured_session(tmp_path / "a.h5", simulated_description))
    numbered = calibrated(write_measured_session(tmp_path / "b.h5", simulated_description, first_pose=40))
    np.testing.assert_allclose(numbered.positions_m, plain.positions_m, atol=1e-12)


def test_absurd_tdoas_are_missing_ones(tmp_path, simulated_description):
    tdoa_s = make_world(n_poses=12, noise_s=1e-6).problem.tdoa_s.copy()
    tdoa_s[5, 3], tdoa_s[6, 4] = 1e200, -np.inf
    result = calibrated(write_measured_session(tmp_path / "s.h5", simulated_description, tdoa_s=tdoa_s))
    assert result.residual.n_used + result.residual.n_rejected == 12 * 6 * 28 - 2
    assert result.evaluation.rmse_m < 0.003


def test_a_buzzer_that_was_never_heard_is_named(tmp_path, simulated_description):
    path = write_measured_session(tmp_path / "s.h5", simulated_description)
    with h5py.File(path, "r+") as file:
        emissions = file["emissions"][:]
        emissions["accepted"][emissions["buzzer"] == 2] = 0
        emissions["accepted"][(emissions["buzzer"] == 5) & (emissions["pose"] < 6)] = 0
        file["emissions"][:] = emissions
    named = [warning for warning in calibrated(path).warnings if warning.startswith("buzzer")]
    assert [warning.split(":")[0] for warning in named] == [
        "buzzer 2 was heard in none of 12 poses",
        "buzzer 5 was heard only 6 of its 12 times",
    ]


def test_a_noisy_channel_is_named():
    std_s = np.full((6, 4), 1e-7)
    std_s[:, 2] = 5e-7
    flaws = Flaws(std_s.shape)
    sound = SoundArrivals("matched", np.arange(6), (1, 2, 3, 4), np.zeros((6, 4)), std_s, flaws, np.ones(6))
    (doubt,) = noise_doubts(sound)
    assert doubt.startswith("channel 3 is noisy")
