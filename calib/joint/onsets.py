"""When emissions began, where a channel wired to the board's sync output tells: absolute times of flight.

The arrivals of an emission leave its beginning open, T_e; their best value for it is the weighted mean of the arrivals
less their times of flight, with the variance 1 / sum w. The sync output says when the pin began, t_e, and the sound
follows later by what a buzzer and its filter take, l_b, the same in all its emissions. So each emission adds a residual

    T_e - (t_e + l_b)        of variance  std_e^2 + 1 / sum w

which is exactly what leaving T_e in the problem and eliminating it afterwards would give.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.joint.arrivals import ArrivalTable, sum_by_pose
from calib.joint.equations import NormalEquations
from calib.joint.unknowns import POSE_SIZE, Unknowns

FloatArray = NDArray[np.float64]

LOSS_WIDTH = 4.0  # standard deviations: an onset further off counts for less and less


@dataclass(frozen=True)
class OnsetTable:
    """Known beginnings of the emissions of an arrival table.

    Parameters
    ----------
    onset_s, std_s : (n_emissions,) arrays
        On the time axis of the emission's arrivals; NaN where not known.
    latency : (n_emissions,) integer array
        Row of the latency, in its block, that goes with each.
    """

    onset_s: FloatArray
    std_s: FloatArray
    latency: NDArray[np.intp]

    def only(self, emissions: NDArray[np.bool_]) -> OnsetTable:
        """Return the beginnings of some emissions (n_emissions,)."""
        return OnsetTable(self.onset_s[emissions], self.std_s[emissions], self.latency[emissions])

    def residuals_s(self, arrivals: ArrivalTable, at: Unknowns, weights: FloatArray) -> FloatArray:
        """Return when emissions began by their arrivals, less when by the sync output (n_emissions,); NaN: unknown."""
        shares = _shares(arrivals, weights)
        began_s = np.sum(shares * np.nan_to_num(arrivals.offsets_s(at)), axis=1)
        latency_s = at.shared[at.blocks.latencies][self.latency]
        return np.where(shares.any(axis=1), began_s - self.onset_s - latency_s, np.nan)

    def weights(self, arrivals: ArrivalTable, at: Unknowns, weights: FloatArray) -> FloatArray:
        """Return the weights (n_emissions,) of a robust loss whose width follows the scatter."""
        total = np.maximum(np.where(arrivals.present, weights, 0.0).sum(axis=1), 1e-300)
        information = 1 / (self.std_s**2 + 1 / total)
        deviations = np.abs(self.residuals_s(arrivals, at, weights)) * np.sqrt(information)
        known = np.isfinite(deviations)
        if not known.any():
            return np.zeros(len(deviations))
        scale = max(1.4826 * float(np.median(deviations[known])), 1.0)
        return np.where(known, information / scale**2 / (1 + (np.nan_to_num(deviations) / scale / LOSS_WIDTH) ** 2), 0)

    def normal_equations(
        self, arrivals: ArrivalTable, at: Unknowns, weights: FloatArray, own_weights: FloatArray
    ) -> NormalEquations:
        """Linearise at some values, with the weights of the arrivals and the onsets' own (n_emissions,)."""
        places, by_shared, by_pose = self._columns(arrivals, at, _shares(arrivals, weights))
        residuals_s = np.nan_to_num(self.residuals_s(arrivals, at, weights))
        size, n_poses = at.blocks.size, len(at.rotations)
        weighted, pull = own_weights[:, None] * by_shared, own_weights * residuals_s
        shared, gradient, border = np.zeros((size, size)), np.zeros(size), np.zeros((n_poses, size, POSE_SIZE))
        shared[np.ix_(places, places)] = weighted.T @ by_shared
        gradient[places] = by_shared.T @ pull
        border[:, places] = sum_by_pose(weighted[:, :, None] * by_pose[:, None], arrivals.pose, n_poses)
        squares = own_weights[:, None, None] * by_pose[:, :, None] * by_pose[:, None]
        poses = sum_by_pose(squares, arrivals.pose, n_poses)
        pose_gradient = sum_by_pose(pull[:, None] * by_pose, arrivals.pose, n_poses)
        return NormalEquations(shared, border, poses, gradient, pose_gradient, 0.5 * float(np.sum(pull * residuals_s)))

    def _columns(
        self, arrivals: ArrivalTable, at: Unknowns, shares: FloatArray
    ) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
        """Return derivatives of the mean flight and the latency: where they stand, by shared unknowns, and by pose."""
        blocks, rows = at.blocks, np.arange(len(shares))
        flights = arrivals.flights(at)
        common = np.einsum("en,enk->ek", shares, arrivals.common_columns(at, flights))
        by_all = np.zeros((len(shares), blocks.size))
        session = np.zeros(len(shares), dtype=np.intp) if arrivals.session is None else arrivals.session
        by_place = shares[..., None] * flights.units / arrivals.speeds_m_s(at)[..., None]
        by_all[:, blocks.microphones] = by_place.reshape(len(shares), -1)
        delays = blocks.delays.start + session[:, None] * blocks.n_mics + np.arange(blocks.n_mics)
        by_all[rows[:, None], delays] = shares
        by_all[rows[:, None], blocks.buzzers.start + 3 * arrivals.buzzer[:, None] + np.arange(3)] = common[:, 6:9]
        by_all[rows, blocks.speed.start + session] = common[:, 9]
        by_all[rows, blocks.latencies.start + self.latency] = 1.0
        places = np.r_[0 : blocks.scale.start, blocks.latencies.start : blocks.latencies.stop]
        return places, by_all[:, places], common[:, :6]


def _shares(arrivals: ArrivalTable, weights: FloatArray) -> FloatArray:
    """Return the share of each arrival (n_emissions, n_mics) in the mean of its emission; 0 where none counts."""
    weights = np.where(arrivals.present, weights, 0.0)
    return np.asarray(weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-300))
