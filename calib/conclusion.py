"""The result: an answer, put beside what it rests on, what weakens it, and the truth where there is one."""

from __future__ import annotations

import numpy as np

from calib.answer import Answer
from calib.doubts import speed_doubts, spread_doubts, view_doubts
from calib.evaluation import Evaluation, evaluate
from calib.order import order_doubts
from calib.rejections import Rejection
from calib.result import Calibration, Recording, SessionShare
from calib.settings import Settings
from calib.together import Measured
from rigs.description import RigDescription


def conclude(parts: list[Measured], channels: tuple[int, ...], answer: Answer, settings: Settings) -> Calibration:
    """Return the result of one session, or of several together."""
    speeds = list(zip(answer.speeds_m_s, answer.speed_stds_m_s, strict=True))
    shares = [
        SessionShare(part.name, part.sha256, len(part.corners.pose), *speed)
        for part, speed in zip(parts, speeds, strict=False)
    ]
    return Calibration(
        session_name=" + ".join(part.name for part in parts),
        session_sha256=parts[0].sha256 if len(parts) == 1 else "",
        method=settings.method,
        held=settings.holds,
        channels=channels,
        positions_m=answer.microphones_m,
        array_covariance_m2=answer.array_covariance_m2,
        speed_of_sound_m_s=answer.speed_of_sound_m_s,
        speed_of_sound_std_m_s=answer.speed_of_sound_std_m_s,
        view=answer.view,
        recording=Recording.by(parts[0].description),
        residual=answer.residual,
        evaluation=_evaluation(parts[0], channels, answer),
        held_out=answer.held_out,
        suggestions=tuple(answer.suggestions),
        rejections=(*_early_rejections(parts), *answer.rejections),
        weakest=answer.weakest,
        evidence=answer.evidence,
        delays=answer.delays,
        sessions=tuple(shares) if len(parts) > 1 else (),
        sound=parts[0].sound if len(parts) == 1 else None,
        warnings=_doubts(parts, channels, answer),
        settings=settings,
    )


def _doubts(parts: list[Measured], channels: tuple[int, ...], answer: Answer) -> list[str]:
    doubts = []
    for part, speed_m_s in zip(parts, answer.speeds_m_s or (answer.speed_of_sound_m_s,), strict=True):
        own = [
            *part.doubts,
            *part.corners.warnings,
            *part.tdoas.warnings,
            *speed_doubts(speed_m_s, part.description.medium),
        ]
        doubts += own if len(parts) == 1 else [f"{part.name}: {doubt}" for doubt in own]
    return [
        *doubts,
        *view_doubts(answer.view),
        *answer.warnings,
        *_order_doubts(parts[0].description, channels, answer),
        *spread_doubts(answer.array_covariance_m2, channels),
    ]


def _early_rejections(parts: list[Measured]) -> list[Rejection]:
    """Return what was left out before the solve, with the session's name where there are several."""
    if len(parts) == 1:
        return parts[0].rejections
    return [rejection.of_session(part.name) for part in parts for rejection in part.rejections]


def _order_doubts(description: RigDescription, channels: tuple[int, ...], answer: Answer) -> list[str]:
    expected = description.audio.expected_positions_m
    if expected is None:
        return []
    rows = [description.audio.channels.index(channel) for channel in channels]
    return order_doubts(answer.microphones_m, np.array(expected)[rows], channels)


def _evaluation(part: Measured, channels: tuple[int, ...], answer: Answer) -> Evaluation | None:
    truth = part.truth
    if truth is None:
        return None
    columns = [part.description.audio.channels.index(channel) for channel in channels]
    return evaluate(answer.microphones_m, truth.microphones_m[columns], truth.source)
