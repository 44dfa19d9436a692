"""Microphones with all else held, from many first guesses at once: the paper's problem, and the joint one's start.

All candidates take Levenberg-Marquardt steps together, as one batch. After some steps of least squares the loss turns
robust (Cauchy), its width following each candidate's own residuals, so that it narrows as the candidate gets better.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

CAUCHY_WIDTH = 2.385  # 95 % efficient for Gaussian noise (Holland and Welsch 1977, doi:10.1080/03610927708827533)
AT_REST_M = 1e-7


@dataclass(frozen=True)
class RangeTable:
    """Arrivals of emissions from places taken as known.

    Parameters
    ----------
    sources_m : (n_emissions, 3) array
    ranges_m : (n_emissions, n_mics) array
        Arrivals times the speed of sound, each emission on an axis of its own; any number where the weight is 0.
    weights : (n_emissions, n_mics) array
        1 / std^2 in 1/m^2; 0 where there is no arrival.
    """

    sources_m: FloatArray
    ranges_m: FloatArray
    weights: FloatArray

    @cached_property
    def by_microphone(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return sources (3, n_emissions), ranges and weights (n_mics, n_emissions), each in one row of memory."""
        sources_m, ranges_m, weights = (
            np.ascontiguousarray(values.T) for values in (self.sources_m, self.ranges_m, self.weights)
        )
        return sources_m, ranges_m, weights

    def offsets_m(self, places_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return ranges minus distances (n, n_mics, n_emissions) for places (n, n_mics, 3), and unit vectors.

        The unit vectors (n, n_mics, 3, n_emissions) point from the sources.
        """
        sources_m, ranges_m, _ = self.by_microphone
        rays_m = places_m[..., None] - sources_m
        distances_m = np.sqrt(rays_m[:, :, 0] ** 2 + rays_m[:, :, 1] ** 2 + rays_m[:, :, 2] ** 2)
        rays_m /= np.maximum(distances_m, 1e-9)[:, :, None]
        return ranges_m - distances_m, rays_m


@dataclass(frozen=True)
class Candidates:
    """Where a batch of descents stands.

    Parameters
    ----------
    places_m : (n, n_mics, 3) array
    scale : (n,) array
        Robust standard deviation of residuals over their stated ones.
    residuals : (n, n_mics, n_emissions) array
        Over their stated standard deviations.
    """

    places_m: FloatArray
    scale: FloatArray
    residuals: FloatArray

    def scores(self) -> FloatArray:
        """Return a robust misfit (n,) of each, on the scale of the best."""
        width = CAUCHY_WIDTH * np.maximum(self.scale.min(), 1e-9)
        return np.asarray(np.log1p((self.residuals / width) ** 2).sum(axis=(1, 2)) * CAUCHY_WIDTH**2)


@dataclass(frozen=True)
class _Linearised:
    """Normal equations of a batch: (n, 3 n_mics, 3 n_mics), (n, 3 n_mics), and half the sums of squares (n,)."""

    hessian: FloatArray
    gradient: FloatArray
    cost: FloatArray

    def step_m(self, damping: FloatArray) -> FloatArray:
        """Return steps (n, n_mics, 3) with Marquardt's scaling."""
        scale = np.sqrt(np.maximum(np.diagonal(self.hessian, axis1=1, axis2=2), 1e-300))
        scaled = self.hessian / (scale[:, :, None] * scale[:, None, :])
        scaled += (damping[:, None, None] + 1e-13) * np.eye(scale.shape[1])
        step = np.linalg.solve(scaled, (self.gradient / scale)[..., None])[..., 0] / scale
        return np.asarray(step.reshape(len(step), -1, 3))

    def where(self, better: NDArray[np.bool_], other: _Linearised) -> _Linearised:
        """Return these equations where they are better, else the others."""
        if better.all():
            return self
        return _Linearised(
            np.where(better[:, None, None], self.hessian, other.hessian),
            np.where(better[:, None], self.gradient, other.gradient),
            np.where(better, self.cost, other.cost),
        )


def descend_together(
    table: RangeTable, places_m: FloatArray, *, least_squares: int = 15, robust: int = 25
) -> Candidates:
    """Descend from places (n, n_mics, 3): so many steps of least squares, then so many of a robust loss."""
    damping = np.full(len(places_m), 1e-3)
    weights = np.broadcast_to(table.by_microphone[2], (len(places_m), *table.weights.T.shape))
    here = _linearised(table, places_m, weights)
    for iteration in range(least_squares + robust):
        if iteration >= least_squares:
            weights = _robust_weights(table, places_m)
            here = _linearised(table, places_m, weights)
        step_m = here.step_m(damping)
        moved_m = places_m + step_m
        there = _linearised(table, moved_m, weights)
        better = there.cost <= here.cost
        places_m, here = np.where(better[:, None, None], moved_m, places_m), there.where(better, here)
        damping = np.clip(np.where(better, damping / 10, damping * 10), 1e-12, 1e12)
        # what the robust loss starts from need not be at rest
        if np.abs(step_m).max() < AT_REST_M and (iteration > least_squares or not robust):
            break
    weights = _robust_weights(table, places_m) if robust else weights
    residuals = _deviations(table, places_m, weights)
    return Candidates(places_m, _scales(table, residuals), residuals)


def _robust_weights(table: RangeTable, places_m: FloatArray) -> FloatArray:
    """Return weights (n, n_mics, n_emissions) of a Cauchy loss."""
    weights = None
    for _ in range(2):
        deviations = _deviations(table, places_m, weights)
        scale = np.maximum(_scales(table, deviations), 1e-9)[:, None, None]
        weights = table.by_microphone[2] / (1 + (deviations / (CAUCHY_WIDTH * scale)) ** 2)
    assert weights is not None
    return weights


def _deviations(table: RangeTable, places_m: FloatArray, weights: FloatArray | None) -> FloatArray:
    """Return residuals over their standard deviations, about the weighted mean or, without weights, the median."""
    offsets_m, _ = table.offsets_m(places_m)
    stated = table.by_microphone[2]
    if weights is None:
        heard = np.asarray((stated > 0).any(axis=0))
        centre = np.zeros((len(places_m), len(heard)))
        centre[:, heard] = np.nanmedian(np.where(stated > 0, offsets_m, np.nan)[:, :, heard], axis=1)
    else:
        centre = (weights * offsets_m).sum(axis=1) / np.maximum(weights.sum(axis=1), 1e-300)
    return np.asarray((offsets_m - centre[:, None]) * np.sqrt(stated))


def _scales(table: RangeTable, deviations: FloatArray) -> FloatArray:
    """Return robust standard deviations (n,) of residuals."""
    return np.asarray(1.4826 * np.median(np.abs(deviations[:, table.by_microphone[2] > 0]), axis=1))


def _linearised(table: RangeTable, places_m: FloatArray, weights: FloatArray) -> _Linearised:
    n, n_mics = places_m.shape[:2]
    offsets_m, units = table.offsets_m(places_m)
    total = np.maximum(weights.sum(axis=1), 1e-300)
    centred_m = offsets_m - ((weights * offsets_m).sum(axis=1) / total)[:, None]
    pull = weights * centred_m
    weighted = weights[:, :, None] * units
    means = weighted.reshape(n, 3 * n_mics, -1) / np.sqrt(total)[:, None]
    hessian = -(means @ means.swapaxes(1, 2))
    mics = np.arange(n_mics)
    own = weighted @ units.swapaxes(2, 3)
    hessian.reshape(n, n_mics, 3, n_mics, 3)[:, mics, :, mics] += own.swapaxes(0, 1)
    gradient = (units @ pull[..., None]).reshape(n, -1)
    return _Linearised(hessian, gradient, 0.5 * np.einsum("kme,kme->k", pull, centred_m))
