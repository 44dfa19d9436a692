"""The estimation problem: unknowns, residuals of the TDOAs, and their normal equations.

One emission e at a known place s_e gives each microphone n the time of flight tau_en = |x_n - s_e| / c. A TDOA of the
pair (i, j) measures tau_ej - tau_ei. Let a_p be the incidence row of a pair (-1 at i, +1 at j), w_ep its weight: then
the weighted sum of squares of an emission is a quadratic form in tau with the Laplacian sum_p w_ep a_p a_p'. So any
choice of pairs (one reference, all pairs, a known extra microphone, pairs missing) is the same code, and no microphone
is special. Source of the residual: arXiv 2502.06196, section III.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]


@dataclass(frozen=True)
class Estimate:
    """Values of the unknowns.

    Parameters
    ----------
    microphones_m : (n_mics, 3) array
        Camera frame.
    speed_of_sound_m_s : float
    """

    microphones_m: FloatArray
    speed_of_sound_m_s: float

    def vector(self) -> FloatArray:
        """Return the unknowns (3 n_mics + 1,): microphones in metres, then the speed of sound in m/s."""
        return np.append(self.microphones_m.ravel(), self.speed_of_sound_m_s)

    def moved(self, step: FloatArray) -> Estimate:
        """Return the estimate after a step (3 n_mics + 1,): microphones in metres, speed of sound in m/s."""
        return Estimate(
            self.microphones_m + step[:-1].reshape(-1, 3),
            self.speed_of_sound_m_s + float(step[-1]),
        )


@dataclass(frozen=True)
class NormalEquations:
    """`hessian @ step = gradient` is the Gauss-Newton step; `cost` is half the weighted sum of squares."""

    hessian: FloatArray
    gradient: FloatArray
    cost: float


@dataclass(frozen=True)
class TdoaProblem:
    """TDOAs of emissions from known places, at microphones to be found.

    Parameters
    ----------
    sources_m : (n_emissions, 3) array
        Where each emission came from, camera frame.
    pose : (n_emissions,) integer array
        Board position of each emission.
    tdoa_s : (n_emissions, n_pairs) array
        Arrival at j minus arrival at i; NaN where missing.
    pairs : (n_pairs, 2) integer array
        (i, j), numbers from 0: unknown microphones first, then known ones.
    n_mics : int
        Number of unknown microphones.
    known_m : (n_known, 3) array
        Places of known microphones, camera frame.
    arrival_std_s : (n_emissions, n_mics + n_known) array or None
        Standard deviations of the arrivals whose differences all pairs of TDOAs are; NaN where there is no arrival.
        None: TDOAs measured pair by pair, all alike.
    """

    sources_m: FloatArray
    pose: IntArray
    tdoa_s: FloatArray
    pairs: IntArray
    n_mics: int
    known_m: FloatArray
    arrival_std_s: FloatArray | None = None

    @cached_property
    def incidence(self) -> FloatArray:
        """Rows (n_pairs, n_mics + n_known) of -1 at i and +1 at j."""
        rows = np.zeros((len(self.pairs), self.n_mics + len(self.known_m)))
        rows[np.arange(len(self.pairs)), self.pairs[:, 0]] = -1.0
        rows[np.arange(len(self.pairs)), self.pairs[:, 1]] = 1.0
        return rows

    @cached_property
    def present(self) -> NDArray[np.bool_]:
        """Which TDOAs (n_emissions, n_pairs) are there."""
        return np.isfinite(self.tdoa_s)

    @cached_property
    def tdoa_std_s(self) -> FloatArray:
        """Stated standard deviations (n_emissions, n_pairs) of the TDOAs; 1 where none are stated."""
        if self.arrival_std_s is None:
            return np.ones_like(self.tdoa_s)
        variance = self.arrival_std_s[:, self.pairs[:, 0]] ** 2 + self.arrival_std_s[:, self.pairs[:, 1]] ** 2
        return np.where(self.present, np.sqrt(variance), 1.0)

    @cached_property
    def information(self) -> FloatArray:
        """Weights (n_emissions, n_pairs) with which pairs add up to what is known.

        Of arrivals with weights w the pair (i, j) has w_i w_j / sum(w): the sum of squares over all pairs is then that
        of the arrivals about their weighted mean. Of TDOAs measured pair by pair each has weight 1.
        """
        if self.arrival_std_s is None:
            return self.present.astype(float)
        weights = np.nan_to_num(1 / self.arrival_std_s**2)
        total = np.maximum(weights.sum(axis=1, keepdims=True), 1e-300)
        pairs = weights[:, self.pairs[:, 0]] * weights[:, self.pairs[:, 1]] / total
        return np.where(self.present, pairs, 0.0)

    @property
    def overcount(self) -> float:
        """How many times over the weighted pairs say the same: n/2 for all pairs of n arrivals, each of weight 1."""
        if self.arrival_std_s is not None:
            return 1.0
        return float(max(len(self.pairs) / (self.incidence.shape[1] - 1), 1.0))

    def only(self, emissions: NDArray[np.bool_]) -> TdoaProblem:
        """Return the problem of some of the emissions (n_emissions,)."""
        std_s = self.arrival_std_s
        return replace(
            self,
            sources_m=self.sources_m[emissions],
            pose=self.pose[emissions],
            tdoa_s=self.tdoa_s[emissions],
            arrival_std_s=None if std_s is None else std_s[emissions],
        )

    def distances(self, estimate: Estimate) -> tuple[FloatArray, FloatArray]:
        """Return distances (n_emissions, n_nodes) in metres, and unit vectors (..., 3) from source to microphone."""
        nodes_m = np.concatenate([estimate.microphones_m, self.known_m])
        rays = nodes_m - self.sources_m[:, None, :]
        distances_m = np.linalg.norm(rays, axis=2)
        return distances_m, rays / np.maximum(distances_m, 1e-12)[..., None]

    def residuals(self, estimate: Estimate) -> FloatArray:
        """Return measured minus modelled TDOAs (n_emissions, n_pairs) in seconds, NaN where missing."""
        distances_m, _ = self.distances(estimate)
        return self.tdoa_s - distances_m @ self.incidence.T / estimate.speed_of_sound_m_s

    def normal_equations(self, estimate: Estimate, weights: FloatArray) -> NormalEquations:
        """Linearise at an estimate.

        Parameters
        ----------
        estimate : Estimate
        weights : (n_emissions, n_pairs) array
            Weight of each TDOA; 0 leaves it out.

        Returns
        -------
        NormalEquations
            Of the unknowns (3 n_mics + 1,): microphones, then the speed of sound.
        """
        distances_m, units = self.distances(estimate)
        speed = estimate.speed_of_sound_m_s
        residual = np.where(self.present, self.tdoa_s - distances_m @ self.incidence.T / speed, 0.0)
        weights = np.where(self.present, weights, 0.0)
        jacobian = self._flight_jacobian(distances_m, units, speed)
        laplacian = np.tensordot(weights, self.incidence[:, :, None] * self.incidence[:, None, :], axes=1)
        n_unknowns = jacobian.shape[2]
        hessian = jacobian.reshape(-1, n_unknowns).T @ (laplacian @ jacobian).reshape(-1, n_unknowns)
        gradient = jacobian.reshape(-1, n_unknowns).T @ ((weights * residual) @ self.incidence).ravel()
        return NormalEquations(hessian, gradient, 0.5 * float(np.sum(weights * residual**2)))

    def _flight_jacobian(self, distances_m: FloatArray, units: FloatArray, speed_m_s: float) -> FloatArray:
        """Return derivatives (n_emissions, n_nodes, 3 n_mics + 1) of the times of flight by the unknowns."""
        n_emissions, n_nodes = distances_m.shape
        jacobian = np.zeros((n_emissions, n_nodes, 3 * self.n_mics + 1))
        for mic in range(self.n_mics):
            jacobian[:, mic, 3 * mic : 3 * mic + 3] = units[:, mic] / speed_m_s
        jacobian[:, :, -1] = -distances_m / speed_m_s**2
        return jacobian
