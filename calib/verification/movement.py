"""Whether the array has moved since it was calibrated, and which microphones.

The session under test places the microphones anew, on its own, with the whole joint problem (board, buzzers, squares,
intrinsics and speed of sound all as uncertain as ever). The difference to the calibration,

    d = x_now - x_then,    cov(d) = C_now + C_then,

is zero but for errors where nothing moved. Each way of moving is a few columns of unknowns: a microphone on its own
(three), or the array as one body against the camera (six). They are taken in one by one, each time the one that
explains most for the unknowns it takes, as long as it explains more than chance would in one of a hundred checks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from calib.camera import View
from calib.corners import PoseCorners
from calib.emissions import EmissionTdoas
from calib.errors import NotConvergedError, NotEnoughDataError
from calib.joint.assemble import assemble
from calib.joint.robust import solve_robustly
from calib.joint.uncertainty import shared_covariance
from calib.joint.unknowns import cross_matrices
from calib.verification.stored import ArrayCalibration
from rigs.description import RigDescription

FloatArray = NDArray[np.float64]

FALSE_ALARMS = 0.01  # of checks of an array that has not moved
MAX_STD_M = 0.01  # of a microphone against the others: a session that knows less cannot tell
WHOLE_ARRAY = -1


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
    resolution_m : float
        The shift of a single microphone, in its worst direction, that is as long as three standard deviations; NaN
        where the session cannot tell.
    doubt : str
        Why the session cannot tell; empty where it can.
    """

    motions: list[Motion]
    resolution_m: float
    doubt: str = ""


def check_movement(
    calibration: ArrayCalibration,
    description: RigDescription,
    view: View,
    corners: PoseCorners,
    tdoas: EmissionTdoas,
) -> MovementCheck:
    """Compare where the microphones are now with where they were.

    Parameters
    ----------
    calibration : ArrayCalibration
    description : RigDescription
        The session's.
    view : View
        The board's poses by the calibrated camera.
    corners : PoseCorners
    tdoas : EmissionTdoas
    """
    try:
        now_m, covariance = _placed_anew(calibration, description, view, corners, tdoas)
    except (NotEnoughDataError, NotConvergedError):
        return MovementCheck([], float("nan"), "too few or too similar poses to place the microphones anew")
    difference_m = (now_m - calibration.positions_m).ravel()
    return explain(difference_m, covariance + calibration.covariance_m2, calibration)


def explain(difference_m: FloatArray, covariance_m2: FloatArray, calibration: ArrayCalibration) -> MovementCheck:
    """Find what moved from the differences (3 n_mics,) and their covariance."""
    roots = np.linalg.inv(np.linalg.cholesky(covariance_m2))  # after it all errors are alike and independent
    ways = {name: roots @ columns for name, columns in _ways(calibration).items()}
    resolution_m = _resolution_m(ways)
    if resolution_m > 3 * MAX_STD_M:
        return MovementCheck([], float("nan"), f"it would miss a microphone that moved by {1e3 * resolution_m:.0f} mm")
    difference = roots @ difference_m
    motions = _motions(_chosen(difference, ways), difference, ways, calibration)
    return MovementCheck(motions, resolution_m)


def _placed_anew(
    calibration: ArrayCalibration,
    description: RigDescription,
    view: View,
    corners: PoseCorners,
    tdoas: EmissionTdoas,
) -> tuple[FloatArray, FloatArray]:
    camera = description.camera.model_copy(update={"intrinsics": calibration.intrinsics})
    audio = description.audio.model_copy(update={"reference_microphone": None})
    description = description.model_copy(update={"camera": camera, "audio": audio})
    problem, guess = assemble(description, view, corners, tdoas, calibration.channels)
    solution = solve_robustly(problem, guess.placed(calibration.positions_m))
    covariance = shared_covariance(problem, solution.at, solution.weights())
    size = 3 * len(calibration.channels)
    return solution.at.microphones_m, covariance[:size, :size]


def _ways(calibration: ArrayCalibration) -> dict[int, FloatArray]:
    """Return the columns (3 n_mics, k) of every way to move, by the microphone's row or WHOLE_ARRAY."""
    n_mics = len(calibration.channels)
    eye = np.eye(3 * n_mics)
    ways = {row: eye[:, 3 * row : 3 * row + 3] for row in range(n_mics)}
    arms_m = calibration.positions_m - calibration.positions_m.mean(axis=0)
    turned = -cross_matrices(arms_m).reshape(-1, 3)
    ways[WHOLE_ARRAY] = np.hstack([np.tile(np.eye(3), (n_mics, 1)), turned])
    return ways


def _chosen(difference: FloatArray, ways: dict[int, FloatArray]) -> list[int]:
    """Take in ways to move as long as one explains more than chance, then let off what the others explain as well."""
    chosen: list[int] = []
    limit = FALSE_ALARMS / len(ways)
    while len(chosen) < len(ways) - 3:
        left = {name: _surprise(difference, ways, chosen, name) for name in ways if name not in chosen}
        best = min(left, key=left.__getitem__)
        if left[best] > np.log(limit):
            break
        chosen.append(best)
    for name in list(chosen):
        others = [other for other in chosen if other != name]
        if others and _surprise(difference, ways, others, name) > np.log(limit):
            chosen = others
    return chosen


def _surprise(difference: FloatArray, ways: dict[int, FloatArray], known: list[int], name: int) -> float:
    """Return the logarithm of the chance that a way to move explains as much as it does where it did not happen."""
    gain = _misfit(difference, ways, known) - _misfit(difference, ways, [*known, name])
    return float(chi2.logsf(max(gain, 0.0), ways[name].shape[1]))


def _misfit(difference: FloatArray, ways: dict[int, FloatArray], names: list[int]) -> float:
    if not names:
        return float(difference @ difference)
    columns = np.hstack([ways[name] for name in names])
    rest = difference - columns @ np.linalg.lstsq(columns, difference, rcond=None)[0]
    return float(rest @ rest)


def _estimates(
    chosen: list[int], difference: FloatArray, ways: dict[int, FloatArray]
) -> dict[int, tuple[FloatArray, FloatArray]]:
    """Return how far each chosen way went and the covariance of that, all estimated together."""
    columns = np.hstack([ways[name] for name in chosen])
    covariance = np.asarray(np.linalg.pinv(columns.T @ columns), dtype=float)
    values = covariance @ columns.T @ difference
    out, begin = {}, 0
    for name in chosen:
        place = slice(begin, begin + ways[name].shape[1])
        out[name], begin = (values[place], covariance[place, place]), place.stop
    return out


def _motions(
    chosen: list[int], difference: FloatArray, whitened: dict[int, FloatArray], calibration: ArrayCalibration
) -> list[Motion]:
    """Put what was chosen into words of motion, the farthest first."""
    if not chosen:
        return []
    motions, plain = [], _ways(calibration)
    for name, (values, covariance) in _estimates(chosen, difference, whitened).items():
        turn_deg = float(np.degrees(np.linalg.norm(values[3:])))
        channel = WHOLE_ARRAY if name == WHOLE_ARRAY else calibration.channels[name]
        farthest_m = float(np.linalg.norm((plain[name] @ values).reshape(-1, 3), axis=1).max())
        motions.append(Motion(channel, values[:3], covariance[:3, :3], turn_deg, farthest_m))
    return sorted(motions, key=lambda motion: -motion.farthest_m)


def _resolution_m(ways: dict[int, FloatArray]) -> float:
    """Return three standard deviations of the worst microphone in its worst direction, were it alone to move."""
    worst = [np.linalg.eigvalsh(np.linalg.inv(columns.T @ columns))[-1] for name, columns in ways.items() if name >= 0]
    return float(3 * np.sqrt(max(worst)))
