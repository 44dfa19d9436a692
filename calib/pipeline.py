"""The whole way from a session to microphone positions, on one screen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from calib.camera import GOOD_RMS_PX, View
from calib.corners import find_pose_corners
from calib.emissions import measure_tdoas
from calib.evaluation import Evaluation, evaluate
from calib.measurements import Measurements
from calib.methods import Settings, check_heard, microphone_channels, solve, speed_prior
from calib.result import Calibration, Residual
from calib.solve import Solution, SpeedPrior
from rigs.session.reader import Session

FloatArray = NDArray[np.float64]

LARGE_STD_M = 0.005
DOUBTFUL_SIGMAS = 2.0


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
    measured = Measurements(description, corners, measure_tdoas(session), settings)
    check_heard(measured.problem, channels)
    tell("solving")
    solution = solve(measured.problem, description, settings)
    tell("solving again and again for the standard deviations")
    covariance = measured.covariance(solution)
    covariance_m2 = np.array([covariance[mic : mic + 3, mic : mic + 3] for mic in range(0, 3 * len(channels), 3)])
    return Calibration(
        session_name=session.name,
        session_sha256=session.sha256(),
        method=settings.method,
        channels=channels,
        positions_m=solution.estimate.microphones_m,
        covariance_m2=covariance_m2,
        speed_of_sound_m_s=solution.estimate.speed_of_sound_m_s,
        speed_of_sound_std_m_s=float(np.sqrt(covariance[-1, -1])),
        view=measured.view,
        residual=_residual(solution),
        evaluation=_evaluation(session, channels, solution),
        warnings=[
            *measured.corners.warnings,
            *measured.tdoas.warnings,
            *_doubts(measured.view, covariance_m2, channels),
            *_speed_doubts(solution.estimate.speed_of_sound_m_s, speed_prior(description)),
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


def _doubts(view: View, covariance_m2: FloatArray, channels: tuple[int, ...]) -> list[str]:
    """Say in words what makes the answer weak."""
    doubts = []
    if view.rms_px > GOOD_RMS_PX:
        doubts.append(
            f"corners fit the camera to {view.rms_px:.2f} px only (good: under {GOOD_RMS_PX}): check focus, that the "
            "board is flat, and camera.intrinsics"
        )
    std_m = np.sqrt(np.linalg.eigvalsh(covariance_m2)[:, -1])
    worst = int(np.argmax(std_m))
    if std_m[worst] > LARGE_STD_M:
        doubts.append(
            f"channel {channels[worst]} is uncertain by {1e3 * std_m[worst]:.1f} mm in its weakest direction: capture "
            "more poses, tilted both ways and at several distances"
        )
    return doubts


def _speed_doubts(speed_m_s: float, prior: SpeedPrior) -> list[str]:
    """Say when sound and pictures do not agree on the scale of the world."""
    deviation = (speed_m_s - prior.mean_m_s) / prior.std_m_s
    if abs(deviation) < DOUBTFUL_SIGMAS:
        return []
    doubt = (
        f"the speed of sound came out at {speed_m_s:.1f} m/s, {abs(deviation):.1f} standard deviations from the rig's "
        f"{prior.mean_m_s:.1f} m/s: check medium in the rig description, board.square_size_m, and that the board was "
        "printed to scale"
    )
    return [doubt]
