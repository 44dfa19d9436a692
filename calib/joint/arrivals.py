"""Residuals of arrival times and their derivatives.

Emission e of buzzer b at pose p reaches microphone n at

    a_en = T_e + |x_n - (R_p s_b + t_p)| / c + d_n

with T_e, when the emission began, unknown. Its best value is the weighted mean of what the microphones say, so it is
eliminated in closed form: with weights w the sum of squares of an emission is sum w r^2 - (sum w r)^2 / sum w, the same
as over all pairs of microphones (arXiv 2502.06196, section III, with the pairs' weights w_i w_j / sum w).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, reduce
from operator import add

import numpy as np
from numpy.typing import NDArray

from calib.joint.equations import NormalEquations
from calib.joint.unknowns import POSE_SIZE, Unknowns, cross_matrices

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]


@dataclass(frozen=True)
class Flights:
    """Where emissions come from, and their way to the microphones.

    Parameters
    ----------
    arms_m : (n_emissions, 3) array
        From the board's origin to the buzzer, camera frame.
    distances_m : (n_emissions, n_mics) array
    units : (n_emissions, n_mics, 3) array
        From source to microphone.
    times_s : (n_emissions, n_mics) array
        Times of flight, with the channels' delays.
    """

    arms_m: FloatArray
    distances_m: FloatArray
    units: FloatArray
    times_s: FloatArray


@dataclass(frozen=True)
class ArrivalTable:
    """Arrivals of all emissions, sorted by pose.

    Parameters
    ----------
    pose, buzzer : (n_emissions,) integer arrays
        Rows of the poses and buzzers of `Unknowns`.
    arrival_s : (n_emissions, n_mics) array
        Each emission on a time axis of its own; NaN where not heard.
    std_s : (n_emissions, n_mics) array
        Standard deviations of the arrivals.
    session : (n_emissions,) integer array or None
        Row of the session that each belongs to; None: there is one only.
    """

    pose: IndexArray
    buzzer: IndexArray
    arrival_s: FloatArray
    std_s: FloatArray
    session: IndexArray | None = None

    @cached_property
    def present(self) -> NDArray[np.bool_]:
        """Which arrivals (n_emissions, n_mics) are there and of use: of an emission heard once nothing follows."""
        heard = np.isfinite(self.arrival_s) & np.isfinite(self.std_s)
        return np.asarray(heard & (heard.sum(axis=1, keepdims=True) > 1))

    @cached_property
    def information(self) -> FloatArray:
        """Weights 1 / std^2 (n_emissions, n_mics), 0 where there is no arrival."""
        return np.where(self.present, 1 / np.where(self.present, self.std_s, 1.0) ** 2, 0.0)

    def only(self, emissions: NDArray[np.bool_]) -> ArrivalTable:
        """Return the arrivals of some emissions (n_emissions,)."""
        return replace(
            self,
            pose=self.pose[emissions],
            buzzer=self.buzzer[emissions],
            arrival_s=self.arrival_s[emissions],
            std_s=self.std_s[emissions],
            session=None if self.session is None else self.session[emissions],
        )

    def speeds_m_s(self, at: Unknowns) -> FloatArray:
        """Return the speed of sound (n_emissions, 1) of each emission."""
        session = np.zeros(len(self.pose), dtype=np.intp) if self.session is None else self.session
        return at.shared[at.blocks.speed][session][:, None]

    def delays_s(self, at: Unknowns) -> FloatArray:
        """Return the delays (n_emissions, n_mics) of the channels at each emission."""
        session = np.zeros(len(self.pose), dtype=np.intp) if self.session is None else self.session
        return at.delays_s.reshape(-1, at.blocks.n_mics)[session]

    def flights(self, at: Unknowns) -> Flights:
        """Trace every emission to every microphone."""
        arms_m = np.einsum("eij,ej->ei", at.rotations[self.pose], at.buzzers_m[self.buzzer])
        rays_m = at.microphones_m - (arms_m + at.translations_m[self.pose])[:, None]
        distances_m = np.sqrt(np.einsum("eni,eni->en", rays_m, rays_m))
        units = rays_m / np.maximum(distances_m, 1e-12)[..., None]
        return Flights(arms_m, distances_m, units, distances_m / self.speeds_m_s(at) + self.delays_s(at))

    def offsets_s(self, at: Unknowns) -> FloatArray:
        """Return arrivals minus times of flight (n_emissions, n_mics): when the emission began; NaN where missing."""
        return np.where(self.present, self.arrival_s - self.flights(at).times_s, np.nan)

    def residuals_s(self, at: Unknowns, weights: FloatArray) -> FloatArray:
        """Return the offsets about their weighted mean; where all of an emission's weights are 0, about the median."""
        offsets_s = self.offsets_s(at)
        return offsets_s - _centres(offsets_s, weights)[:, None]

    def normal_equations(self, at: Unknowns, weights: FloatArray) -> NormalEquations:
        """Linearise at some values, with weights (n_emissions, n_mics) in 1/s^2."""
        if self.session is not None and at.blocks.n_sessions > 1:
            return self._session_by_session(at, self.session, weights)
        flights = self.flights(at)
        weights = np.where(self.present, weights, 0.0)
        total = np.maximum(weights.sum(axis=1), 1e-300)
        offsets_s = np.where(self.present, self.arrival_s - flights.times_s, 0.0)
        centred_s = offsets_s - ((weights * offsets_s).sum(axis=1) / total)[:, None]
        pull = weights * centred_s
        own = np.concatenate(
            [flights.units / self.speeds_m_s(at)[..., None], np.ones_like(flights.distances_m)[..., None]], axis=2
        )
        common = self.common_columns(at, flights)
        common -= np.einsum("en,enk->ek", weights / total[:, None], common)[:, None]
        equations = _Assembly(at, self, weights, total)
        equations.add_own(own, pull)
        equations.add_crossed(own, common)
        equations.add_common(common, pull)
        return equations.result(0.5 * float(np.sum(pull * centred_s)))

    def _session_by_session(self, at: Unknowns, session: IndexArray, weights: FloatArray) -> NormalEquations:
        """Sum the equations of each session, which know of their own speed of sound and delays only."""
        parts = []
        for number in range(at.blocks.n_sessions):
            own = session == number
            alone = replace(self.only(own), session=None)
            equations = alone.normal_equations(at.of_session(number), weights[own])
            parts.append(equations.spread(at.blocks.of_session(number), at.blocks.size))
        return reduce(add, parts)

    def common_columns(self, at: Unknowns, flights: Flights) -> FloatArray:
        """Return derivatives (n_emissions, n_mics, 10) of the flights by pose (6), buzzer (3) and speed of sound."""
        speeds_m_s = self.speeds_m_s(at)[..., None]
        by_source = -flights.units / speeds_m_s
        source_by = np.concatenate(
            [
                -cross_matrices(flights.arms_m),
                np.broadcast_to(np.eye(3), (len(self.pose), 3, 3)),
                at.rotations[self.pose],
            ],
            axis=2,
        )
        by_speed = -flights.distances_m[..., None] / speeds_m_s**2
        return np.concatenate([by_source @ source_by, by_speed], axis=2)


class _Assembly:
    """Sums the emissions' shares into normal equations.

    `own` columns (3 of a microphone's place, 1 of its delay) touch one microphone only, and are kept apart from the 10
    `common` columns (centred) that touch all microphones of an emission.
    """

    def __init__(self, at: Unknowns, table: ArrivalTable, weights: FloatArray, total: FloatArray) -> None:
        self._blocks, self._table, self._weights, self._total = at.blocks, table, weights, total
        n_poses, size = len(at.rotations), at.blocks.size
        self._n_poses = n_poses
        self._shared = np.zeros((size, size))
        self._border = np.zeros((n_poses, size, POSE_SIZE))
        self._poses = np.zeros((n_poses, POSE_SIZE, POSE_SIZE))
        self._gradient = np.zeros(size)
        self._pose_gradient = np.zeros((n_poses, POSE_SIZE))
        mics = np.arange(at.blocks.n_mics)
        self._own = np.column_stack([3 * mics[:, None] + np.arange(3), at.blocks.delays.start + mics])
        self._of_buzzer = (table.buzzer == np.arange(at.blocks.n_buzzers)[:, None]).astype(float)

    def add_own(self, own: FloatArray, pull: FloatArray) -> None:
        """Add what microphones and delays say among themselves."""
        weighted = self._weights[..., None] * own
        for mic, places in enumerate(self._own):
            self._shared[np.ix_(places, places)] += weighted[:, mic].T @ own[:, mic]
            self._gradient[places] += pull[:, mic] @ own[:, mic]
        means = (weighted / np.sqrt(self._total)[:, None, None]).reshape(len(own), -1)
        places = self._own.ravel()
        self._shared[np.ix_(places, places)] -= means.T @ means

    def add_crossed(self, own: FloatArray, common: FloatArray) -> None:
        """Add what ties microphones and delays to poses, buzzers and speed of sound."""
        crossed = ((self._weights[..., None] * own)[..., None] * common[:, :, None, :]).reshape(len(own), -1, 10)
        places = self._own.ravel()
        self._border[:, places] += self._by_pose(crossed[..., :6])
        by_buzzer = np.tensordot(self._of_buzzer, crossed[..., 6:9], axes=1)
        self._add_shared(places, self._buzzer_places(), by_buzzer.swapaxes(0, 1).reshape(len(places), -1))
        self._add_shared(places, self._speed_place(), crossed[..., 9:].sum(axis=0))

    def add_common(self, common: FloatArray, pull: FloatArray) -> None:
        """Add what poses, buzzers and speed of sound say among themselves."""
        squares = common.swapaxes(1, 2) @ (self._weights[..., None] * common)
        pulls = np.einsum("en,enk->ek", pull, common)
        buzzers, speed, n_buzzers = self._buzzer_places(), self._speed_place(), self._blocks.n_buzzers
        self._poses += self._by_pose(squares[:, :6, :6])
        self._pose_gradient += self._by_pose(pulls[:, :6])
        self._gradient[buzzers] += (self._of_buzzer @ pulls[:, 6:9]).ravel()
        self._gradient[speed] += pulls[:, 9].sum()
        self._border[:, speed[0]] += self._by_pose(squares[:, 9, :6])
        by_both = np.einsum("be,eij->ebij", self._of_buzzer, squares[:, 6:9, :6]).reshape(len(common), -1, 6)
        self._border[:, buzzers] += self._by_pose(by_both)
        by_buzzer = np.tensordot(self._of_buzzer, squares[:, 6:9, 6:], axes=1)
        for buzzer in range(n_buzzers):
            places = buzzers[3 * buzzer : 3 * buzzer + 3]
            self._shared[np.ix_(places, places)] += by_buzzer[buzzer, :, :3]
        self._add_shared(buzzers, speed, by_buzzer[..., 3].reshape(-1, 1))
        self._shared[speed[0], speed[0]] += squares[:, 9, 9].sum()

    def result(self, cost: float) -> NormalEquations:
        """Return the sums."""
        return NormalEquations(self._shared, self._border, self._poses, self._gradient, self._pose_gradient, cost)

    def _buzzer_places(self) -> IndexArray:
        return np.arange(self._blocks.buzzers.start, self._blocks.buzzers.stop)

    def _speed_place(self) -> IndexArray:
        return np.array([self._blocks.speed.start])

    def _add_shared(self, rows: IndexArray, columns: IndexArray, values: FloatArray) -> None:
        self._shared[np.ix_(rows, columns)] += values
        self._shared[np.ix_(columns, rows)] += values.T

    def _by_pose(self, values: FloatArray) -> FloatArray:
        return sum_by_pose(values, self._table.pose, self._n_poses)


def sum_by_pose(values: FloatArray, pose: IndexArray, n_poses: int) -> FloatArray:
    """Sum values (n_emissions, ...) over the emissions of each pose; emissions are sorted by pose."""
    out = np.zeros((n_poses, *values.shape[1:]))
    starts = np.flatnonzero(np.diff(pose, prepend=-1))
    if len(starts):
        out[pose[starts]] = np.add.reduceat(values, starts, axis=0)
    return out


def _centres(offsets_s: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the weighted means (n_emissions,) of offsets, medians where nothing has weight, 0 where nothing is."""
    present = np.isfinite(offsets_s)
    weights = np.where(present, weights, 0.0)
    total = weights.sum(axis=1)
    centres = (weights * np.nan_to_num(offsets_s)).sum(axis=1) / np.maximum(total, 1e-300)
    alone = (total == 0) & present.any(axis=1)
    centres[alone] = np.nanmedian(offsets_s[alone], axis=1)
    return np.asarray(centres)
