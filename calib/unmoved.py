"""Whether several sessions may be solved together: the array must not have moved against the camera in between."""

from __future__ import annotations

from dataclasses import replace

from calib.camera import look
from calib.comparison import MIN_MICS, compare, fit
from calib.comparison_screen import verdict
from calib.errors import CalibrationError, NotEnoughDataError
from calib.joint.session import answer_jointly
from calib.result import SOFTWARE, Recording
from calib.result_file import StoredCalibration
from calib.settings import Settings
from calib.together import Measured

CHANCE = 1e-4  # below, sessions are not of one array; --compare asks for much less


def check_unmoved(sessions: list[Measured], channels: tuple[int, ...], settings: Settings) -> None:
    """Solve each session alone, as far as it can be, and refuse to join what differs.

    Raises
    ------
    NotEnoughDataError
        Saying what moved.
    """
    alone = [result for session in sessions if (result := _alone(session, channels, settings)) is not None]
    for other in alone[1:]:
        if fit(alone[0], other).chi_square.chance < CHANCE:
            raise NotEnoughDataError(
                f"{alone[0].name} and {other.name} cannot be solved together: {_what_moved(alone[0], other)}; solve "
                "them one by one"
            )


def _what_moved(first: StoredCalibration, other: StoredCalibration) -> str:
    if len(first.channels) < MIN_MICS:
        return "the microphones moved against the camera"
    return verdict(compare(first, other))


def _alone(session: Measured, channels: tuple[int, ...], settings: Settings) -> StoredCalibration | None:
    """Solve one session; None where it is too short for that."""
    view = look(session.description.camera, session.description.board, session.corners)
    brief = replace(settings, suggest_poses=0)
    try:
        answer = answer_jointly(
            session.description, view, session.corners, session.tdoas, channels, brief, is_last=False
        )
    except CalibrationError:
        return None
    return StoredCalibration(
        session.name,
        {session.sha256: session.name},
        settings,
        SOFTWARE,
        channels,
        answer.microphones_m,
        answer.array_covariance_m2,
        answer.speed_of_sound_m_s,
        answer.speed_of_sound_std_m_s,
        answer.view.intrinsics,
        Recording.by(session.description),
    )
