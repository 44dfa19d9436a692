"""The whole way from a session to microphone positions, on one screen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from calib.cache import ArrivalCache
from calib.corners import find_pose_corners
from calib.doubts import fit_doubts, session_doubts, speed_doubts, spread_doubts, view_doubts
from calib.emissions import measure_tdoas
from calib.evaluation import Evaluation, evaluate
from calib.measurements import Measurements
from calib.methods import Settings, check_heard, microphone_channels, solve, speed_prior
from calib.result import Calibration, Residual
from calib.solve import Solution
from calib.sound_report import sound_report
from rigs.session.reader import Session

FloatArray = NDArray[np.float64]


def calibrate(session: Session, settings: Settings, tell: Callable[[str], None] = lambda _: None) -> Calibration:
    """Find every microphone of a session in the camera frame; `tell` is called with each step's name.

    Raises
    ------
    CalibrationError
        The method does not fit the session, or the session does not support an answer.
    """
    description = session.description
    channels = microphone_channels(description, settings)
    tell("finding the board in the pictures")
    corners = find_pose_corners(session)
    tell("measuring arrivals in the sound")
    session_sha256 = session.sha256()
    tdoas = measure_tdoas(session, settings.tdoa, ArrivalCache(session.path, session_sha256))
    measured = Measurements(description, corners, tdoas, settings)
    check_heard(measured.problem, channels)
    tell("solving")
    solution = solve(measured.problem, description, settings)
    tell("solving again and again for the standard deviations")
    covariance = measured.covariance(solution)
    covariance_m2 = np.array([covariance[mic : mic + 3, mic : mic + 3] for mic in range(0, 3 * len(channels), 3)])
    return Calibration(
        session_name=session.name,
        session_sha256=session_sha256,
        method=settings.method,
        channels=channels,
        positions_m=solution.estimate.microphones_m,
        covariance_m2=covariance_m2,
        speed_of_sound_m_s=solution.estimate.speed_of_sound_m_s,
        speed_of_sound_std_m_s=float(np.sqrt(covariance[-1, -1])),
        view=measured.view,
        residual=_residual(solution),
        evaluation=_evaluation(session, channels, solution),
        sound=sound_report(session, tdoas.sound) if tdoas.sound else None,
        warnings=[
            *session_doubts(session),
            *measured.corners.warnings,
            *measured.tdoas.warnings,
            *view_doubts(measured.view),
            *speed_doubts(solution.estimate.speed_of_sound_m_s, speed_prior(description)),
            *fit_doubts(measured, solution),
            *spread_doubts(covariance_m2, channels),
        ],
    )


def _residual(solution: Solution) -> Residual:
    n_present = int(np.isfinite(solution.residuals_s).sum())
    n_used = int(solution.used.sum())
    return Residual(solution.robust_sigma_s, solution.rms_s, n_used, n_present - n_used)


def _evaluation(session: Session, channels: tuple[int, ...], solution: Solution) -> Evaluation | None:
    truth = session.truth
    if truth is None:
        return None
    columns = [session.description.audio.channels.index(channel) for channel in channels]
    return evaluate(solution.estimate.microphones_m, truth.microphones_m[columns], truth.source)
