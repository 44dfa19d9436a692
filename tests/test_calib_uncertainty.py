"""Are the standard deviations true? Asked of many sessions whose truth is known."""

import numpy as np
import pytest
from conftest import MICROPHONES_M, write_measured_session

from calib.pipeline import calibrate
from calib.settings import Settings
from calib.uncertainty import descriptions_off_by_one_std
from rigs.session.reader import Session


@pytest.mark.parametrize("buzzer_std_m", [0.0001, 0.001], ids=["sound and corners", "buzzers"])
def test_errors_are_as_large_as_stated(tmp_path, simulated_description, buzzer_std_m):
    """Corners, TDOAs, buzzers, squares and the speed of sound are wrong by as much as the rig description admits."""
    board = simulated_description.board.model_copy(update={"buzzer_std_m": buzzer_std_m, "square_size_std_m": 0.00001})
    description = simulated_description.model_copy(update={"board": board})
    noise_s = 1e-6 if buzzer_std_m < 0.001 else 0.2e-6
    normalised = []
    for seed in range(16):
        path = write_measured_session(
            tmp_path / f"s{seed}.h5", description, n_poses=16, seed=10 * seed, noise_s=noise_s, wrong_scales=True
        )
        with Session.open(path) as session:
            result = calibrate(session, Settings())
        errors_m = result.positions_m - MICROPHONES_M
        normalised += [
            error @ np.linalg.solve(covariance, error) / 3
            for error, covariance in zip(errors_m, result.covariance_m2, strict=True)
        ]
    assert 0.6 < np.mean(normalised) < 1.6  # 1 is exact; 16 sessions leave a spread of about 0.2


def test_every_uncertain_value_is_moved_once(simulated_description):
    moved = descriptions_off_by_one_std(simulated_description)
    assert len(moved) == 6 * 3 + 1 + 1
    assert len({other.model_dump_json() for other in moved} | {simulated_description.model_dump_json()}) == 21
    prior = simulated_description.medium
    assert moved[-1].medium.speed_m_s() == pytest.approx(prior.speed_m_s() + prior.speed_std_m_s())
    assert moved[18].board.square_size_m == pytest.approx(0.025 + simulated_description.board.square_size_std_m)
    assert moved[0].board.buzzers[0].position_m[0] == pytest.approx(-0.045 + 0.0001)
