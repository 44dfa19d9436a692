"""Whether two results of one array differ by more than their uncertainties, and what moved.

With d the shifts of all microphones from the first result to the second and V = C_1 + C_2 their covariance, d' V^-1 d
follows a chi-square law if nothing moved. What moved is found by adding explanations one after the other, the best
first, as long as one makes the fit better than chance would: a rigid motion of the whole array (6 unknowns: the camera
or the array was moved) or a shift of a microphone (3 each).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.special import gammaln
from scipy.stats import chi2

from calib.errors import MethodError
from calib.joint.unknowns import cross_matrices
from calib.result_file import StoredCalibration
from rigs.geometry import Pose, rigid_alignment, rotation_matrix

FloatArray = NDArray[np.float64]

FALSE_ALARM = 0.01  # of two results of an array that did not change
MIN_MICS = 4  # fewer leave nothing to test once a rigid motion is taken out
N_ITERATIONS = 20
AT_REST = 1e-12
LARGE = 300.0
RIGID_UNKNOWNS = 6
SAME_PLACE = 0.1  # of the distance between two microphones: as near, one stands where the other did


@dataclass(frozen=True)
class ChiSquare:
    """A sum of squares over its covariance, and how many degrees of freedom it has."""

    value: float
    n_free: int

    @property
    def chance(self) -> float:
        """Probability of as much or more, if nothing differs."""
        return float(np.exp(self.log_chance))

    @property
    def log_chance(self) -> float:
        """Natural logarithm of that, which tells apart what is too unlikely for a number."""
        if self.n_free <= 0:
            return 0.0
        half, half_free = self.value / 2, self.n_free / 2
        if half > LARGE:  # the incomplete gamma function's first term alone
            return float(-half + (half_free - 1) * np.log(half) - gammaln(half_free))
        return float(chi2.logsf(self.value, self.n_free))


@dataclass(frozen=True)
class Fit:
    """The second result explained by the first one and something that moved.

    Parameters
    ----------
    motion : Pose or None
        About the array's centre.
    motion_covariance : (6, 6) array or None
        Of turn (radians) and shift (metres).
    moved : tuple of int
        Rows of the microphones that moved by themselves.
    shifts_m : (n_mics, 3) array
        What remains of the microphones' shifts when the motion is taken out.
    shift_covariance_m2 : (3 n_mics, 3 n_mics) array
        Of the shifts as measured.
    chi_square : ChiSquare
        Of the microphones that did not move by themselves.
    """

    motion: Pose | None
    motion_covariance: FloatArray | None
    moved: tuple[int, ...]
    shifts_m: FloatArray
    shift_covariance_m2: FloatArray
    chi_square: ChiSquare

    def own_shift_m(self, row: int) -> FloatArray:
        """Return how far (3,) a microphone that moved by itself did, its errors shared with the others taken out."""
        still = np.setdiff1d(np.arange(len(self.shifts_m)), self.moved)
        places, own = _places(still), slice(3 * row, 3 * row + 3)
        among = cho_factor(self.shift_covariance_m2[np.ix_(places, places)])
        shared_m = self.shift_covariance_m2[own][:, places] @ cho_solve(among, self.shifts_m[still].ravel())
        return np.asarray(self.shifts_m[row] - shared_m)

    @property
    def angle_deg(self) -> float:
        """How far the array turned."""
        if self.motion is None:
            return 0.0
        return float(np.degrees(np.arccos(np.clip((np.trace(self.motion.rotation) - 1) / 2, -1.0, 1.0))))

    @property
    def distance_m(self) -> float:
        """How far the array's centre moved."""
        return 0.0 if self.motion is None else float(np.linalg.norm(self.motion.translation_m))


@dataclass(frozen=True)
class Comparison:
    """Two results of one array.

    Parameters
    ----------
    first, second : StoredCalibration
        Of the channels that both have.
    unmoved, rigid : Fit
        If nothing moved; if the array moved as a whole, but for the microphones that `best` has moved by themselves.
    best : Fit
        With all that is needed to explain the difference; `unmoved` where they agree.
    """

    first: StoredCalibration
    second: StoredCalibration
    unmoved: Fit
    rigid: Fit
    best: Fit

    @property
    def is_explained(self) -> bool:
        """Whether what remains unexplained is no more than chance."""
        return self.best.chi_square.chance * (len(self.first.channels) + 2) > FALSE_ALARM

    @property
    def differ(self) -> bool:
        """Whether anything moved."""
        return self.best.motion is not None or bool(self.best.moved) or not self.is_explained

    @property
    def share_sessions(self) -> bool:
        """Whether both rest on the same measurements, in part."""
        return not self.first.sessions.keys().isdisjoint(self.second.sessions)

    def microphone_chi_squares(self, fit: Fit) -> list[ChiSquare]:
        """Return that of each microphone's shift alone."""
        out = []
        for row, shift_m in enumerate(fit.shifts_m):
            block = fit.shift_covariance_m2[3 * row : 3 * row + 3, 3 * row : 3 * row + 3]
            out.append(ChiSquare(float(shift_m @ np.linalg.solve(block, shift_m)), 3))
        return out


def compare(first: StoredCalibration, second: StoredCalibration) -> Comparison:
    """Compare two results by the channels that both have.

    Raises
    ------
    MethodError
        They have too few channels in common, or covariances that cannot be weighed against each other.
    """
    common = tuple(channel for channel in first.channels if channel in second.channels)
    if len(common) < MIN_MICS:
        raise MethodError(
            f"{first.name} and {second.name} have {len(common)} channels in common, at least {MIN_MICS} are needed: "
            "name two results of one array"
        )
    first, second = first.only(common), second.only(common)
    _check_weights(first, second)
    unmoved = fit(first, second)
    best = _explained(first, second, unmoved)
    return Comparison(first, second, unmoved, fit(first, second, rigid=True, moved=best.moved), best)


def swapped_rows(comparison: Comparison) -> list[tuple[int, int]]:
    """Return microphones that stand where another of them stood, and that one where they did: their plugs changed."""
    best, before_m = comparison.best, comparison.first.positions_m
    pairs = []
    for first, second in combinations(sorted(best.moved), 2):
        apart_m = before_m[second] - before_m[first]
        misses_m = best.own_shift_m(first) - apart_m, best.own_shift_m(second) + apart_m
        if max(np.linalg.norm(miss_m) for miss_m in misses_m) < SAME_PLACE * np.linalg.norm(apart_m):
            pairs.append((first, second))
    return pairs


def contradiction_of(comparison: Comparison) -> str:
    """Say what speaks for results of two different rigs; empty where a few motions explain how they differ."""
    channels, best = comparison.first.channels, comparison.best
    exchanged = {row for pair in swapped_rows(comparison) for row in pair}
    moved = [channels[row] for row in best.moved if row not in exchanged]
    if len(moved) < len(channels) / 2 and comparison.is_explained:
        return ""
    first_px, now_px = (np.mean(each.intrinsics.focal_px) for each in (comparison.first, comparison.second))
    shift_mm = 1e3 * np.linalg.norm(comparison.unmoved.shifts_m, axis=1)
    by_length = sorted(zip(shift_mm, channels, strict=True), reverse=True)
    shifts = ", ".join(f"{channel} by {length_mm:.1f}" for length_mm, channel in by_length)
    return f"microphone {shifts} mm; the focal length {first_px:.1f} px there, {now_px:.1f} px here"


def _check_weights(first: StoredCalibration, second: StoredCalibration) -> None:
    try:
        cho_factor(first.array_covariance_m2 + second.array_covariance_m2)
    except np.linalg.LinAlgError as error:
        raise MethodError(
            f"{first.name} and {second.name}: array_covariance_m2 of both together has no inverse: calibrate their "
            "sessions again"
        ) from error


def fit(
    first: StoredCalibration, second: StoredCalibration, *, rigid: bool = False, moved: tuple[int, ...] = ()
) -> Fit:
    """Explain the second result by the first one, moved as a whole or not, and some microphones moved by themselves."""
    still = np.setdiff1d(np.arange(len(first.channels)), moved)
    motion, motion_covariance = _rigid_motion(first, second, still) if rigid else (None, None)
    shifts_m, covariance = _shifts(first, second, motion)
    places, remaining = _places(still), shifts_m[still].ravel()
    value = float(remaining @ cho_solve(cho_factor(covariance[np.ix_(places, places)]), remaining))
    n_free = len(remaining) - (RIGID_UNKNOWNS if rigid else 0)
    return Fit(motion, motion_covariance, moved, shifts_m, covariance, ChiSquare(value, n_free))


def _rigid_motion(
    first: StoredCalibration, second: StoredCalibration, still: NDArray[np.intp]
) -> tuple[Pose, FloatArray]:
    """Return the most likely motion of the array about its centre, and its covariance, by Gauss-Newton."""
    centre_m, places = first.positions_m.mean(axis=0), _places(still)
    motion = rigid_alignment(first.positions_m[still] - centre_m, second.positions_m[still] - centre_m)
    for _ in range(N_ITERATIONS):
        shifts_m, covariance = _shifts(first, second, motion)
        turned_m = (first.positions_m[still] - centre_m) @ motion.rotation.T
        jacobian = np.concatenate([-cross_matrices(turned_m), np.tile(np.eye(3), (len(still), 1, 1))], axis=2)
        jacobian = jacobian.reshape(-1, RIGID_UNKNOWNS)
        weighted = cho_solve(cho_factor(covariance[np.ix_(places, places)]), jacobian)
        information = jacobian.T @ weighted
        step = np.linalg.solve(information, weighted.T @ shifts_m[still].ravel())
        motion = Pose(rotation_matrix(step[:3]) @ motion.rotation, motion.translation_m + step[3:])
        if float(step @ information @ step) < AT_REST:
            break
    return motion, np.linalg.inv(information)


def _places(rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return where the coordinates of some microphones stand."""
    return np.asarray((3 * rows[:, None] + np.arange(3)).ravel())


def _shifts(first: StoredCalibration, second: StoredCalibration, motion: Pose | None) -> tuple[FloatArray, FloatArray]:
    """Return the shifts (n_mics, 3) from the first result, moved, to the second, and their covariance."""
    if motion is None:
        return second.positions_m - first.positions_m, first.array_covariance_m2 + second.array_covariance_m2
    centre_m = first.positions_m.mean(axis=0)
    shifts_m = second.positions_m - centre_m - motion.apply(first.positions_m - centre_m)
    turn = np.kron(np.eye(len(shifts_m)), motion.rotation)
    return shifts_m, second.array_covariance_m2 + turn @ first.array_covariance_m2 @ turn.T


def _explained(first: StoredCalibration, second: StoredCalibration, unmoved: Fit) -> Fit:
    """Add explanations as long as one is better than chance would be."""
    n_mics = len(first.channels)
    now = unmoved
    while len(now.moved) <= n_mics - MIN_MICS:
        trials = [
            fit(first, second, rigid=now.motion is not None, moved=(*now.moved, row))
            for row in range(n_mics) if row not in now.moved
        ]  # fmt: skip
        if now.motion is None:
            trials.append(fit(first, second, rigid=True, moved=now.moved))
        chances = [_gain(now, trial).log_chance for trial in trials]
        best = int(np.argmin(chances))
        if chances[best] > np.log(FALSE_ALARM / (len(trials) + 1)):
            break
        now = trials[best]
    return now


def _gain(before: Fit, after: Fit) -> ChiSquare:
    return ChiSquare(
        before.chi_square.value - after.chi_square.value, before.chi_square.n_free - after.chi_square.n_free
    )
