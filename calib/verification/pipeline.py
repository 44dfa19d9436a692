"""Verification as its steps: a session and a calibration in, errors and a verdict out."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.cache import ArrivalCache
from calib.camera import View, look
from calib.corners import PoseCorners, find_pose_corners
from calib.emissions import EmissionTdoas, accepted_rows, measure_tdoas
from calib.errors import NotEnoughDataError
from calib.joint.assemble import arrival_table, emission_rows
from calib.measurements import Measurements
from calib.result_file import StoredCalibration
from calib.sound import windows_of
from calib.verification.comparison import Comparison, compare, see_buzzers
from calib.verification.heldout import calibrate_without, check_alone, check_unchanged, held_out_poses, settings_of
from calib.verification.location import Heard, Located, Speed, locate
from calib.verification.movement import SAME_MOMENT, MovementCheck, check_movement
from calib.verification.steering import ResponseMap, SteeredResponse
from calib.verification.verdict import Limits, Verdict, judge
from rigs.description import RigDescription
from rigs.session.reader import Session

FloatArray = NDArray[np.float64]

MIN_POSES = 1
USUAL_DISTANCE_M = 1.0  # of sounds that could not be located, for their map


@dataclass(frozen=True)
class Verification:
    """What a session says of a calibration.

    Parameters
    ----------
    session_name : str
    calibration : StoredCalibration
        As it was verified.
    made_again : bool
        The session is the one that it was made from, so it was made again without the poses verified.
    size_px : (int, int)
        Of the pictures.
    row, pose, buzzer : (n_emissions,) integer arrays
        Row in the session's table, number of the pose, id of the buzzer.
    located : Located
    comparison : Comparison
    maps : list of ResponseMap or None
        One for each emission; None where the session has no sound.
    movement : MovementCheck
    verdict : Verdict
    unchecked : list of int
        Channels of the session whose microphones the calibration lacks, or which heard nothing.
    warnings : list of str
    """

    session_name: str
    calibration: StoredCalibration
    made_again: bool
    size_px: tuple[int, int]
    row: NDArray[np.intp]
    pose: NDArray[np.int32]
    buzzer: NDArray[np.int32]
    located: Located
    comparison: Comparison
    maps: list[ResponseMap] | None
    movement: MovementCheck
    verdict: Verdict
    unchecked: list[int]
    warnings: list[str]

    @property
    def steered_error_px(self) -> FloatArray | None:
        """How far each map's peak lies from the buzzer seen (n_emissions,)."""
        if self.maps is None:
            return None
        peaks_px = np.array([one.peak_px for one in self.maps]).reshape(-1, 2)
        return np.asarray(np.linalg.norm(peaks_px - self.comparison.seen_px, axis=1))


def verify(
    session: Session, calibration: StoredCalibration, limits: Limits, tell: Callable[[str], None] = lambda _: None
) -> Verification:
    """Locate the sounds of poses that a calibration has not used, and compare them with what the camera saw.

    Raises
    ------
    CalibrationError
        The session does not support a verification.
    """
    description = session.description
    tell("finding the board in the pictures")
    corners = find_pose_corners(session, min_poses=MIN_POSES)
    tell("measuring arrivals in the sound")
    session_sha256 = session.sha256()
    made_again = session_sha256 in calibration.sessions
    tdoas = measure_tdoas(session, calibration.settings.tdoa, ArrivalCache(session.path, session_sha256))
    known = Speed(description.medium.speed_m_s(), description.medium.speed_std_m_s())
    if made_again:
        check_alone(calibration, session_sha256)
        tell("calibrating without the poses to verify")
        held_out = held_out_poses(corners.pose)
        measured = Measurements(description, corners, tdoas, settings_of(calibration, description))
        again = calibrate_without(measured, held_out, calibration)
        check_unchanged(calibration, again)
        calibration = again
        corners = corners.only(np.isin(corners.pose, held_out))
        known = Speed(calibration.speed_of_sound_m_s, calibration.speed_of_sound_std_m_s)
    view = calibrated_view(calibration, description, corners)
    tell("locating the sounds")
    rows = emission_rows(view, tdoas)
    located, comparison = locate_emissions(calibration, description, view, corners, tdoas, known)
    tell("asking whether the array has moved")
    if made_again:
        movement = MovementCheck.untold(SAME_MOMENT)
    else:
        movement = check_movement(calibration, description, view, corners, tdoas)
    tell("steering the array over the pictures")
    session_rows = accepted_rows(session)[rows]
    maps = None if session.tdoas is not None else _maps(session, session_rows, calibration, located)
    return Verification(
        session.name,
        calibration,
        made_again,
        description.camera.size_px,
        session_rows,
        tdoas.pose[rows],
        tdoas.buzzer[rows],
        located,
        comparison,
        maps,
        movement,
        judge(located, comparison, movement, limits),
        _unchecked(calibration, description, movement),
        [*corners.warnings, *tdoas.warnings, *_name_doubts(session, calibration, made_again=made_again)],
    )


def calibrated_view(calibration: StoredCalibration, description: RigDescription, corners: PoseCorners) -> View:
    """Return the board's poses by the calibrated camera, in the order of their numbers.

    Raises
    ------
    NotEnoughDataError
    """
    camera = description.camera.model_copy(update={"intrinsics": calibration.intrinsics})
    order = np.argsort(corners.pose)
    return look(camera, description.board, replace(corners, pose=corners.pose[order],
                                                   corners_px=corners.corners_px[order]))  # fmt: skip


def locate_emissions(
    calibration: StoredCalibration,
    description: RigDescription,
    view: View,
    corners: PoseCorners,
    tdoas: EmissionTdoas,
    known: Speed,
) -> tuple[Located, Comparison]:
    """Locate the emissions of the poses of `view`, in the order of `emission_rows`, and compare them.

    Raises
    ------
    NotEnoughDataError
        There are none.
    """
    rows = emission_rows(view, tdoas)
    if len(rows) == 0:
        raise NotEnoughDataError("no emission belongs to a pose at which the board was seen: capture again")
    table = arrival_table(description, view, tdoas, calibration.channels)
    heard = Heard(calibration.positions_m, calibration.array_covariance_m2, table.arrival_s, table.std_s)
    located = locate(heard, known)
    seen = see_buzzers(view, corners, description.board, tdoas.pose[rows], tdoas.buzzer[rows])
    return located, compare(located, seen, view)


def _maps(
    session: Session,
    rows: NDArray[np.intp],
    calibration: StoredCalibration,
    located: Located,
) -> list[ResponseMap]:
    description = session.description
    columns = [description.audio.channels.index(channel) for channel in calibration.channels]
    waveform = description.signal.waveform()
    windows = windows_of(session, rows, waveform)
    steered = SteeredResponse(
        calibration.positions_m,
        calibration.intrinsics,
        description.camera.size_px,
        waveform.band_hz(),
        session.sample_rate_hz,
        located.speed.m_s,
    )
    distances_m = np.linalg.norm(located.places_m, axis=1)
    distances_m = np.where(np.isfinite(distances_m), distances_m, USUAL_DISTANCE_M)

    def mapped(number: int) -> ResponseMap:
        samples = windows.read(np.array([number])).samples[0, columns]
        return steered.map(samples, float(distances_m[number]))

    with ThreadPoolExecutor(os.cpu_count()) as pool:  # the FFT lets other threads run meanwhile
        return list(pool.map(mapped, range(len(rows))))


def _unchecked(calibration: StoredCalibration, description: RigDescription, movement: MovementCheck) -> list[int]:
    checked = movement.resolutions_m or calibration.channels
    return [channel for channel in description.audio.channels if channel not in checked]


def _name_doubts(session: Session, calibration: StoredCalibration, *, made_again: bool) -> list[str]:
    if made_again or session.name not in calibration.sessions.values():
        return []
    doubt = (
        f"the calibration was made from a session of this name, {session.name}, with another content: if this is that "
        "session, continued or copied, its poses are not all new to the calibration"
    )
    return [doubt]
