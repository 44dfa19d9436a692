"""Are the standard deviations true? Asked of many sessions whose truth is known."""

import numpy as np
from conftest import MICROPHONES_M, write_measured_session

from calib.methods import Settings
from calib.pipeline import calibrate
from rigs.session.reader import Session


def test_errors_are_as_large_as_stated(tmp_path, simulated_description):
    """Corners, TDOAs, buzzers and the speed of sound are all wrong by as much as the rig description admits."""
    normalised = []
    for seed in range(16):
        path = write_measured_session(tmp_path / f"s{seed}.h5", simulated_description, n_poses=20, seed=10 * seed)
        with Session.open(path) as session:
            result = calibrate(session, Settings())
        errors_m = result.positions_m - MICROPHONES_M
        normalised += [
            error @ np.linalg.solve(covariance, error) / 3
            for error, covariance in zip(errors_m, result.covariance_m2, strict=True)
        ]
    assert 0.6 < np.mean(normalised) < 1.6  # 1 is exact; 16 sessions leave a spread of about 0.15
