"""The whole way from a session to microphone positions, on one screen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from calib.answer import Answer
from calib.cache import ArrivalCache
from calib.corners import find_pose_corners
from calib.doubts import session_doubts, speed_doubts, spread_doubts, view_doubts
from calib.emissions import measure_tdoas
from calib.evaluation import Evaluation, evaluate
from calib.joint.session import answer_jointly
from calib.measurements import Measurements
from calib.methods import check_heard, microphone_channels
from calib.order import order_doubts
from calib.result import Calibration
from calib.settings import Settings
from calib.sound_report import sound_report
from rigs.description import RigDescription
from rigs.session.reader import Session


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
    check_heard(tdoas, channels)
    measured = Measurements(description, corners, tdoas, settings)
    tell("solving")
    if settings.method == "joint":
        answer = answer_jointly(description, measured.view, corners, tdoas, channels, settings)
    else:
        answer = measured.answer()
    return Calibration(
        session_name=session.name,
        session_sha256=session_sha256,
        method=settings.method,
        channels=channels,
        positions_m=answer.microphones_m,
        covariance_m2=answer.covariance_m2,
        speed_of_sound_m_s=answer.speed_of_sound_m_s,
        speed_of_sound_std_m_s=answer.speed_of_sound_std_m_s,
        view=answer.view,
        residual=answer.residual,
        evaluation=_evaluation(session, channels, answer),
        held_out=answer.held_out,
        suggestions=tuple(answer.suggestions),
        array_covariance_m2=answer.array_covariance_m2,
        sound=sound_report(session, tdoas.sound) if tdoas.sound else None,
        warnings=[
            *session_doubts(session),
            *corners.warnings,
            *tdoas.warnings,
            *view_doubts(answer.view),
            *speed_doubts(answer.speed_of_sound_m_s, description.medium),
            *answer.warnings,
            *_order_doubts(description, channels, answer),
            *spread_doubts(answer.covariance_m2, channels),
        ],
    )


def _order_doubts(description: RigDescription, channels: tuple[int, ...], answer: Answer) -> list[str]:
    expected = description.audio.expected_positions_m
    if expected is None:
        return []
    rows = [description.audio.channels.index(channel) for channel in channels]
    return order_doubts(answer.microphones_m, np.array(expected)[rows], channels)


def _evaluation(session: Session, channels: tuple[int, ...], answer: Answer) -> Evaluation | None:
    truth = session.truth
    if truth is None:
        return None
    columns = [session.description.audio.channels.index(channel) for channel in channels]
    return evaluate(answer.microphones_m, truth.microphones_m[columns], truth.source)
