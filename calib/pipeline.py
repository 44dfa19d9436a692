"""The whole way from sessions to microphone positions, on one screen."""

from __future__ import annotations

from collections.abc import Callable

from calib.answer import Answer
from calib.cache import ArrivalCache
from calib.camera import look
from calib.conclusion import conclude
from calib.corners import find_pose_corners
from calib.doubts import buzzer_doubts, noise_doubts, session_doubts
from calib.emissions import EmissionTdoas, measure_tdoas
from calib.errors import MethodError
from calib.joint.session import answer_jointly
from calib.measurements import Measurements
from calib.memory import Memory
from calib.methods import check_heard, microphone_channels
from calib.rejections import session_rejections
from calib.result import Calibration
from calib.settings import Settings
from calib.sound_report import sound_report
from calib.together import Measured, check_joinable, check_one_rig, put_together
from calib.unmoved import check_unmoved
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
    channels = microphone_channels(session.description, settings)
    measured = measure(session, settings, tell, memory)
    tell("solving")
    return conclude([measured], channels, _answer(measured, channels, settings, memory), settings)


def calibrate_together(sessions: list[Session], settings: Settings, tell: Callable[[str], None]) -> Calibration:
    """Find every microphone from several sessions of one rig: they share all but poses, speed of sound and delays.

    Raises
    ------
    CalibrationError
        They are not of one rig, the array moved in between, or they do not support an answer.
    """
    if settings.method != "joint":
        raise MethodError(f"{settings.method} solves one session at a time: several go together by joint only")
    check_one_rig(sessions)
    parts = [measure(session, settings, tell) for session in sessions]
    check_joinable(parts)
    description, channels = parts[0].description, microphone_channels(parts[0].description, settings)
    tell("solving each alone")
    check_unmoved(parts, channels, settings)
    tell("solving together")
    corners, tdoas = put_together(parts)
    view = look(description.camera, description.board, corners)
    media = tuple(part.description.medium for part in parts)
    answer = answer_jointly(description, view, corners, tdoas, channels, settings, media=media)
    return conclude(parts, channels, answer, settings)


def measure(
    session: Session, settings: Settings, tell: Callable[[str], None], memory: Memory | None = None
) -> Measured:
    """Find corners and arrivals of a session.

    Raises
    ------
    CalibrationError
    """
    tell(f"{session.name}: finding the board in the pictures")
    corners = find_pose_corners(session, memory.poses if memory else None)
    tell(f"{session.name}: measuring arrivals in the sound")
    growing = memory if memory and not memory.is_over else None
    session_sha256 = "" if growing else session.sha256()
    cache = None if growing else ArrivalCache(session.path, session_sha256)
    tdoas = measure_tdoas(session, settings.tdoa, cache, growing.ear if growing else None)
    check_heard(tdoas, microphone_channels(session.description, settings))
    return Measured(
        name=session.name,
        sha256=session_sha256,
        description=session.description,
        corners=corners,
        tdoas=tdoas,
        truth=session.truth,
        sound=sound_report(session, tdoas.sound) if tdoas.sound else None,
        doubts=[] if growing else [*session_doubts(session), *_hearing_doubts(session, tdoas)],
        rejections=session_rejections(session, corners, tdoas),
    )


def _hearing_doubts(session: Session, tdoas: EmissionTdoas) -> list[str]:
    return [*buzzer_doubts(session, tdoas.sound), *(noise_doubts(tdoas.sound) if tdoas.sound else ())]


def _answer(measured: Measured, channels: tuple[int, ...], settings: Settings, memory: Memory | None) -> Answer:
    measurements = Measurements(measured.description, measured.corners, measured.tdoas, settings)
    if settings.method != "joint":
        return measurements.answer()
    growing = memory if memory and not memory.is_over else None
    answer = answer_jointly(
        measured.description, measurements.view, measured.corners, measured.tdoas, channels, settings,
        before=growing.continuation if growing else None, is_last=growing is None,
    )  # fmt: skip
    if growing:
        growing.continuation = answer.continuation
    return answer
