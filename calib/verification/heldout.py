"""Poses that the calibration has not used, even where the session is the one that it was made from.

A session of its own is verified on all of its poses. Of the session that the calibration was made from, every third
pose is verified, with a calibration that is made again without these: by the same method, on the same channels.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.answer import Answer
from calib.errors import ResultFileError
from calib.joint.session import answer_jointly
from calib.measurements import Measurements
from calib.result_file import StoredCalibration
from calib.settings import Settings
from rigs.description import RigDescription

EVERY = 3
TOLERATED_SIGMAS, TOLERATED_M = 6.0, 0.001


def settings_of(calibration: StoredCalibration, description: RigDescription) -> Settings:
    """Return the settings that calibrate the same channels in the same way."""
    left_out = tuple(channel for channel in description.audio.channels if channel not in calibration.channels)
    return replace(calibration.settings, excluded_channels=left_out)


def held_out_poses(poses: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return every third of the poses' numbers (n_poses,)."""
    return np.sort(poses)[EVERY // 2 :: EVERY]


def check_alone(calibration: StoredCalibration, session_sha256: str) -> None:
    """Refuse to make a calibration of several sessions again from one of them.

    Raises
    ------
    ResultFileError
    """
    if len(calibration.sessions) > 1:
        raise ResultFileError(
            f"the calibration was made from {len(calibration.sessions)} sessions, "
            f"{calibration.sessions[session_sha256]} among them, so none of its poses is new: verify on another session"
        )


def check_unchanged(calibration: StoredCalibration, again: StoredCalibration) -> None:
    """Refuse a file whose microphones are not those that its session gives.

    Raises
    ------
    ResultFileError
        One stands farther off than the poses left out explain.
    """
    apart_m = np.linalg.norm(calibration.positions_m - again.positions_m, axis=1)
    std_m = np.sqrt(np.diag(again.array_covariance_m2).reshape(-1, 3).sum(axis=1))
    worst = int(np.argmax(apart_m - TOLERATED_SIGMAS * std_m))
    if apart_m[worst] > TOLERATED_SIGMAS * std_m[worst] + TOLERATED_M:
        raise ResultFileError(
            f"the calibration has microphone {calibration.channels[worst]} {1e3 * apart_m[worst]:.1f} mm from where "
            "its own session puts it: was it edited by hand, or made by an earlier version with --hold or "
            "--find-delays? Verify on another session"
        )


def calibrate_without(
    measured: Measurements, held_out: NDArray[np.int32], calibration: StoredCalibration
) -> StoredCalibration:
    """Make a calibration again without some poses (n,).

    Raises
    ------
    CalibrationError
        What is left does not support an answer.
    """
    answer = answer_of(measured.without(held_out), calibration.channels)
    return replace(
        calibration,
        positions_m=answer.microphones_m,
        array_covariance_m2=answer.array_covariance_m2,
        speed_of_sound_m_s=answer.speed_of_sound_m_s,
        speed_of_sound_std_m_s=answer.speed_of_sound_std_m_s,
        intrinsics=answer.view.intrinsics,
    )


def answer_of(measured: Measurements, channels: tuple[int, ...]) -> Answer:
    """Solve by the method that the settings name."""
    if measured.settings.method != "joint":
        return measured.answer()
    return answer_jointly(
        measured.description, measured.view, measured.corners, measured.tdoas, channels, measured.settings
    )
