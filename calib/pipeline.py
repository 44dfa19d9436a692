"""The whole way from a session to microphone positions, on one screen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from calib.answer import Answer
from calib.cache import ArrivalCache
from calib.camera import look
from calib.corners import find_pose_corners
from calib.doubts import session_doubts, speed_doubts, spread_doubts, view_doubts
from calib.emissions import measure_tdoas
from calib.errors import MethodError
from calib.evaluation import Evaluation, evaluate
from calib.joint.session import answer_jointly
from calib.measurements import Measurements
from calib.memory import Memory
from calib.methods import check_heard, microphone_channels
from calib.order import order_doubts
from calib.rejections import session_rejections
from calib.result import Calibration, SessionShare
from calib.settings import Settings
from calib.sound_report import sound_report
from calib.together import Measured, check_one_rig, put_together
from calib.unmoved import check_unmoved
from rigs.description import RigDescription
from rigs.session.reader import Session


def calibrate(
    session: Session,
    settings: Settings,
    tell: Callable[[str], None] = lambda _: None,
    memory: Memory | None = None,
) -> Calibration:
    """Find every microphone of a session in the camera frame.

    Parameters
    ----------
    session : Session
    settings : Settings
    tell : callable
        Called with each step's name.
    memory : Memory or None
        Of a session that grows: what was found before. What it takes to judge a whole session is then left for later.

    Raises
    ------
    CalibrationError
        The method does not fit the session, or the session does not support an answer.
    """
    description = session.description
    channels = microphone_channels(description, settings)
    tell("finding the board in the pictures")
    corners = find_pose_corners(session, memory.poses if memory else None)
    tell("measuring arrivals in the sound")
    growing = memory if memory and not memory.is_over else None
    session_sha256 = "" if growing else session.sha256()
    cache = None if growing else ArrivalCache(session.path, session_sha256)
    tdoas = measure_tdoas(session, settings.tdoa, cache, growing.ear if growing else None)
    check_heard(tdoas, channels)
    measured = Measurements(description, corners, tdoas, settings)
    tell("solving")
    if settings.method == "joint":
        before = growing.continuation if growing else None
        answer = answer_jointly(
            description, measured.view, corners, tdoas, channels, settings, before=before, is_last=growing is None
        )
    else:
        answer = measured.answer()
    if growing:
        growing.continuation = answer.continuation
    return Calibration(
        session_name=session.name,
        session_sha256=session_sha256,
        method=settings.method,
        channels=channels,
        positions_m=answer.microphones_m,
        array_covariance_m2=answer.array_covariance_m2,
        speed_of_sound_m_s=answer.speed_of_sound_m_s,
        speed_of_sound_std_m_s=answer.speed_of_sound_std_m_s,
        view=answer.view,
        residual=answer.residual,
        evaluation=_evaluation(session, channels, answer),
        held_out=answer.held_out,
        suggestions=tuple(answer.suggestions),
        rejections=(*session_rejections(session, corners, tdoas), *answer.rejections),
        weakest=answer.weakest,
        sound=sound_report(session, tdoas.sound) if tdoas.sound else None,
        warnings=[
            *([] if growing else session_doubts(session)),
            *corners.warnings,
            *tdoas.warnings,
            *view_doubts(answer.view),
            *speed_doubts(answer.speed_of_sound_m_s, description.medium),
            *answer.warnings,
            *_order_doubts(description, channels, answer),
            *spread_doubts(answer.array_covariance_m2, channels),
        ],
    )


def measure(session: Session, settings: Settings) -> Measured:
    """Return what was measured in one of several sessions.

    Raises
    ------
    CalibrationError
    """
    channels = microphone_channels(session.description, settings)
    corners = find_pose_corners(session)
    session_sha256 = session.sha256()
    tdoas = measure_tdoas(session, settings.tdoa, ArrivalCache(session.path, session_sha256))
    check_heard(tdoas, channels)
    left_out = [rejection.of_session(session.name) for rejection in session_rejections(session, corners, tdoas)]
    return Measured(
        session.name, session_sha256, session.description, corners, tdoas, session_doubts(session), left_out
    )


def calibrate_together(sessions: list[Session], settings: Settings, tell: Callable[[str], None]) -> Calibration:
    """Find every microphone from several sessions of one rig: they share all but poses, speed of sound and delays.

    Raises
    ------
    CalibrationError
        They are not of one rig, the array moved in between, or they do not support an answer.
    """
    if settings.method != "joint":
        raise MethodError(f"{settings.method} solves one session at a time: several go together by joint only")
    parts = []
    for session in sessions:
        tell(f"{session.name}: corners and arrivals")
        parts.append(measure(session, settings))
    check_one_rig(parts)
    description, channels = parts[0].description, microphone_channels(parts[0].description, settings)
    tell("solving each alone")
    check_unmoved(parts, channels, settings)
    tell("solving together")
    corners, tdoas = put_together(parts)
    view = look(description.camera, description.board, corners)
    media = tuple(part.description.medium for part in parts)
    answer = answer_jointly(description, view, corners, tdoas, channels, settings, media=media)
    speeds = list(zip(answer.speeds_m_s, answer.speed_stds_m_s, strict=True))
    return Calibration(
        session_name=" + ".join(part.name for part in parts),
        session_sha256="",
        method=settings.method,
        channels=channels,
        positions_m=answer.microphones_m,
        array_covariance_m2=answer.array_covariance_m2,
        speed_of_sound_m_s=answer.speed_of_sound_m_s,
        speed_of_sound_std_m_s=answer.speed_of_sound_std_m_s,
        view=answer.view,
        residual=answer.residual,
        evaluation=_evaluation(sessions[0], channels, answer),
        held_out=answer.held_out,
        suggestions=tuple(answer.suggestions),
        rejections=(*(each for part in parts for each in part.rejections), *answer.rejections),
        weakest=answer.weakest,
        sessions=tuple(
            SessionShare(part.name, part.sha256, len(part.corners.pose), *speed)
            for part, speed in zip(parts, speeds, strict=True)
        ),
        warnings=[
            *(
                f"{part.name}: {doubt}"
                for part, (speed_m_s, _) in zip(parts, speeds, strict=True)
                for doubt in (
                    *part.doubts, *part.corners.warnings, *part.tdoas.warnings,
                    *speed_doubts(speed_m_s, part.description.medium),
                )
            ),
            *view_doubts(answer.view),
            *answer.warnings,
            *_order_doubts(description, channels, answer),
            *spread_doubts(answer.array_covariance_m2, channels),
        ],
    )  # fmt: skip


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
