"""Whether the array has moved since it was calibrated, and which microphones.

The session under test places the microphones anew, on its own, with the whole joint problem (board, buzzers, squares,
intrinsics and speed of sound all as uncertain as ever). The two results are then compared as `rig-calibrate --compare`
does: what differs by more than both uncertainties is explained by as few motions as chance allows.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from calib.camera import View
from calib.comparison import MIN_MICS, Comparison, Fit, compare, contradiction_of, swapped_rows
from calib.corners import PoseCorners
from calib.emissions import EmissionTdoas
from calib.errors import NotConvergedError, NotEnoughDataError
from calib.joint.assemble import arrival_table, assemble
from calib.joint.robust import solve_robustly
from calib.joint.session import refined_view
from calib.joint.uncertainty import shared_covariance
from calib.result_file import StoredCalibration
from rigs.description import RigDescription

FloatArray = NDArray[np.float64]

MAX_STD_M = 0.01  # of a microphone against the others: a session that knows less cannot tell
WHOLE_ARRAY = -1
SAME_MOMENT = "these poses were captured when it was calibrated; capture a later session and verify that"


@dataclass(frozen=True)
class Motion:
    """Something that moved.

    Parameters
    ----------
    channel : int
        Input channel of the microphone; WHOLE_ARRAY for the array against the camera.
    shift_m : (3,) array
        Camera frame; of the whole array: of its middle.
    covariance_m2 : (3, 3) array
    turn_deg : float
        Of the whole array; 0 for a microphone.
    farthest_m : float
        How far the microphone that moved most did so; for a single one the length of the shift.
    """

    channel: int
    shift_m: FloatArray
    covariance_m2: FloatArray
    turn_deg: float
    farthest_m: float

    @property
    def length_m(self) -> float:
        """How far."""
        return float(np.linalg.norm(self.shift_m))

    @property
    def std_m(self) -> float:
        """Standard deviation along the shift."""
        along = self.shift_m / max(self.length_m, 1e-12)
        return float(np.sqrt(along @ self.covariance_m2 @ along))

    def sentence(self) -> str:
        """Say it in words."""
        far = f"{1e3 * self.length_m:.1f} mm (+- {max(1e3 * self.std_m, 0.1):.1f})"
        if self.channel == WHOLE_ARRAY:
            return f"the whole array by {far} and {self.turn_deg:.2f} degrees against the camera"
        x, y, z = 1e3 * self.shift_m
        return f"microphone {self.channel} by {far}: x {x:+.1f}, y {y:+.1f}, z {z:+.1f} mm"


@dataclass(frozen=True)
class MovementCheck:
    """What moved.

    Parameters
    ----------
    motions : list of Motion
        Empty where nothing did.
    resolutions_m : dict of int to float
        By input channel: the shift of that microphone alone, in its least visible direction, that is as long as three
        standard deviations; empty where the session cannot tell.
    swapped : list of (int, int)
        Channels whose microphones have exchanged places exactly: plugs, not microphones, were moved.
    contradiction : str
        What speaks for another rig's calibration; empty where nothing does.
    contradiction_m : float
        How far microphones stand from where it has them, what is explained taken out.
    doubt : str
        Why the session cannot tell, and what would; empty where it can.
    """

    motions: list[Motion]
    resolutions_m: dict[int, float]
    swapped: list[tuple[int, int]] = field(default_factory=list)
    contradiction: str = ""
    contradiction_m: float = 0.0
    doubt: str = ""

    @classmethod
    def untold(cls, doubt: str) -> MovementCheck:
        """Return the check of a session that cannot tell."""
        return cls([], {}, doubt=doubt)

    @property
    def resolution_m(self) -> float:
        """That of the least visible microphone; NaN where the session cannot tell."""
        return max(self.resolutions_m.values(), default=float("nan"))

    def unseen(self, limit_m: float) -> str:
        """Say why it is not told whether something moved by more than a limit; empty where it is."""
        if self.doubt:
            return self.doubt
        if self.motions_beyond(limit_m) or self.is_foreign(limit_m) or self.resolution_m <= limit_m:
            return ""
        return (
            f"a microphone could have moved by up to {1e3 * self.resolution_m:.1f} mm unseen, the limit is "
            f"{1e3 * limit_m:g} mm; more poses or less noise help"
        )

    def is_foreign(self, limit_m: float) -> bool:
        """Whether this looks like another rig's calibration, by more than a limit."""
        return bool(self.contradiction) and self.contradiction_m > limit_m

    def motions_beyond(self, limit_m: float) -> list[Motion]:
        """Return what moved farther than a limit."""
        return [motion for motion in self.motions if motion.farthest_m > limit_m]


def check_movement(
    calibration: StoredCalibration,
    description: RigDescription,
    view: View,
    corners: PoseCorners,
    tdoas: EmissionTdoas,
) -> MovementCheck:
    """Compare where the microphones are now with where they were.

    Parameters
    ----------
    calibration : StoredCalibration
    description : RigDescription
        The session's.
    view : View
        The board's poses by the calibrated camera.
    corners : PoseCorners
    tdoas : EmissionTdoas
    """
    calibration = _of_heard_channels(calibration, description, view, tdoas)
    if len(calibration.channels) < MIN_MICS:
        return MovementCheck.untold(f"fewer than {MIN_MICS} of its microphones heard anything")
    try:
        now = _placed_anew(calibration, description, view, corners, tdoas)
    except (NotEnoughDataError, NotConvergedError):
        return MovementCheck.untold(
            "the microphones could not be placed anew: the poses are too few or too similar, or this is another rig's "
            "calibration"
        )
    resolutions_m = _resolutions_m(calibration, calibration.array_covariance_m2 + now.array_covariance_m2)
    worst_m = max(resolutions_m.values())
    if worst_m > 3 * MAX_STD_M:
        return MovementCheck.untold(
            f"it would miss a microphone that moved by {1e3 * worst_m:.0f} mm; more poses or less noise help"
        )
    comparison = compare(calibration, now)
    swapped = [
        (calibration.channels[first], calibration.channels[second]) for first, second in swapped_rows(comparison)
    ]
    apart_m = float(np.linalg.norm(comparison.best.shifts_m, axis=1).max())
    return MovementCheck(motions_of(comparison), resolutions_m, swapped, contradiction_of(comparison), apart_m)


def motions_of(comparison: Comparison) -> list[Motion]:
    """Return what explains how two results of one array differ, the farthest motion first."""
    best, channels = comparison.best, comparison.first.channels
    motions = [_own_motion(best, row, channels[row]) for row in best.moved]
    if best.motion is not None and best.motion_covariance is not None:
        arms_m = comparison.first.positions_m - comparison.first.positions_m.mean(axis=0)
        farthest_m = float(np.linalg.norm(best.motion.apply(arms_m) - arms_m, axis=1).max())
        shift_covariance = best.motion_covariance[3:, 3:]
        whole = Motion(WHOLE_ARRAY, best.motion.translation_m, shift_covariance, best.angle_deg, farthest_m)
        motions.append(whole)
    return sorted(motions, key=lambda motion: -motion.farthest_m)


def _placed_anew(
    calibration: StoredCalibration,
    description: RigDescription,
    view: View,
    corners: PoseCorners,
    tdoas: EmissionTdoas,
) -> StoredCalibration:
    """Return the calibration as this session alone would have it, but for the speed of sound.

    Raises
    ------
    CalibrationError
    """
    camera = description.camera.model_copy(update={"intrinsics": calibration.intrinsics})
    audio = description.audio.model_copy(update={"reference_microphone": None})
    description = description.model_copy(update={"camera": camera, "audio": audio})
    problem, guess = assemble(description, view, corners, tdoas, calibration.channels)
    solution = solve_robustly(problem, guess.placed(calibration.positions_m))
    covariance = shared_covariance(problem, solution.at, solution.weights())
    size = 3 * len(calibration.channels)
    return replace(
        calibration,
        positions_m=solution.at.microphones_m,
        array_covariance_m2=covariance[:size, :size],
        intrinsics=refined_view(view, solution).intrinsics,
    )


def _of_heard_channels(
    calibration: StoredCalibration, description: RigDescription, view: View, tdoas: EmissionTdoas
) -> StoredCalibration:
    """Leave out microphones that heard nothing: nobody can say where these are."""
    arrival_s = arrival_table(description, view, tdoas, calibration.channels).arrival_s
    heard = np.isfinite(arrival_s).any(axis=0)
    return calibration.only(tuple(np.array(calibration.channels)[heard].tolist()))


def _own_motion(best: Fit, row: int, channel: int) -> Motion:
    """Return how a microphone moved by itself, with the errors that it shares with the still ones taken out."""
    shift_m = best.own_shift_m(row)
    still = np.setdiff1d(np.arange(len(best.shifts_m)), best.moved)
    places = np.concatenate([np.arange(3 * mic, 3 * mic + 3) for mic in (*still, row)])
    information = np.linalg.inv(best.shift_covariance_m2[np.ix_(places, places)])
    return Motion(channel, shift_m, np.linalg.inv(information[-3:, -3:]), 0.0, float(np.linalg.norm(shift_m)))


def _resolutions_m(calibration: StoredCalibration, covariance_m2: FloatArray) -> dict[int, float]:
    """Return three standard deviations of each microphone in its worst direction, were it alone to move."""
    information = np.linalg.inv(covariance_m2)
    blocks = [information[start : start + 3, start : start + 3] for start in range(0, len(information), 3)]
    return {
        channel: float(3 / np.sqrt(np.linalg.eigvalsh(block)[0]))
        for channel, block in zip(calibration.channels, blocks, strict=True)
    }
