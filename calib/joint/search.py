"""Microphones with all else held, from many first guesses at once: the paper's problem, and the joint one's start.

All candidates take Levenberg-Marquardt steps together, as one batch. After some steps of least squares the loss turns
robust (Cauchy), its width following each candidate's own residuals, so that it narrows as the candidate gets better.
"""

from __future__ import annotations

from dataclasses import dataclass

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

    def offsets_m(self, places_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return ranges minus distances (n, n_emissions, n_mics) for places (n, n_mics, 3), and unit vectors."""
        rays_m = places_m[:, None] - self.sources_m[:, None, :]
        distances_m = np.sqrt(np.einsum("kemi,kemi->kem", rays_m, rays_m))
        return self.ranges_m - distances_m, rays_m / np.maximum(distances_m, 1e-9)[..., None]


@dataclass(frozen=True)
class Candidates:
    """Where a batch of descents stands.

    Parameters
    ----------
    places_m : (n, n_mics, 3) array
    scale : (n,) array
        Robust standard deviation of residuals over their stated ones.
    residuals : (n, n_emissions, n_mics) array
        Over their stated standard deviations.
    """

    places_m: FloatArray
    scale: FloatArray
    residuals: FloatArray

    def scores(self) -> FloatArray:
        """Return a robust misfit (n,) of each, on the scale of the best."""
        width = CAUCHY_WIDTH * np.maximum(self.scale.min(), 1e-9)
        return np.asarray(np.log1p((self.residuals / width) ** 2).sum(axis=(1, 2)) * CAUCHY_WIDTH**2)


def descend_together(
    table: RangeTable, places_m: FloatArray, *, least_squares: int = 15, robust: int = 25
) -> Candidates:
    """Descend from places (n, n_mics, 3): so many steps of least squares, then so many of a robust loss."""
    damping = np.full(len(places_m), 1e-3)
    for iteration in range(least_squares + robust):
        weights = _weights(table, places_m, iteration >= least_squares)
        hessian, gradient, cost = _equations(table, places_m, weights)
        step_m = _damped(hessian, gradient, damping)
        moved_m = places_m + step_m
        better = _cost(table, moved_m, weights) <= cost
        places_m = np.where(better[:, None, None], moved_m, places_m)
        damping = np.clip(np.where(better, damping / 10, damping * 10), 1e-12, 1e12)
        if (
            iteration != least_squares
            and np.abs(step_m).max() < AT_REST_M
            and (iteration > least_squares or not robust)
        ):
            break
    residuals = _deviations(table, places_m, _weights(table, places_m, robust > 0))
    return Candidates(places_m, _scales(table, residuals), residuals)


def _weights(table: RangeTable, places_m: FloatArray, robust: bool) -> FloatArray:
    """Return weights (n, n_emissions, n_mics)."""
    weights = np.broadcast_to(table.weights, (len(places_m), *table.weights.shape))
    if not robust:
        return weights
    deviations = _deviations(table, places_m, None)
    for _ in range(2):
        scale = np.maximum(_scales(table, deviations), 1e-9)[:, None, None]
        weights = table.weights / (1 + (deviations / (CAUCHY_WIDTH * scale)) ** 2)
        deviations = _deviations(table, places_m, weights)
    return weights


def _deviations(table: RangeTable, places_m: FloatArray, weights: FloatArray | None) -> FloatArray:
    """Return residuals over their standard deviations, about the weighted mean or, without weights, the median."""
    offsets_m, _ = table.offsets_m(places_m)
    if weights is None:
        present = np.where(table.weights > 0, offsets_m, np.nan)
        heard = (table.weights > 0).any(axis=1)
        centre = np.zeros(offsets_m.shape[:2])
        centre[:, heard] = np.nanmedian(present[:, heard], axis=2)
    else:
        centre = (weights * offsets_m).sum(axis=2) / np.maximum(weights.sum(axis=2), 1e-300)
    return np.asarray((offsets_m - centre[..., None]) * np.sqrt(table.weights))


def _scales(table: RangeTable, deviations: FloatArray) -> FloatArray:
    """Return robust standard deviations (n,) of residuals."""
    return np.asarray(1.4826 * np.median(np.abs(deviations[:, table.weights > 0]), axis=1))


def _cost(table: RangeTable, places_m: FloatArray, weights: FloatArray) -> FloatArray:
    offsets_m, _ = table.offsets_m(places_m)
    mean = (weights * offsets_m).sum(axis=2) / np.maximum(weights.sum(axis=2), 1e-300)
    return np.asarray(0.5 * np.sum(weights * (offsets_m - mean[..., None]) ** 2, axis=(1, 2)))


def _equations(
    table: RangeTable, places_m: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return normal equations of the batch: (n, 3 n_mics, 3 n_mics), (n, 3 n_mics), (n,)."""
    n, n_mics = places_m.shape[:2]
    offsets_m, units = table.offsets_m(places_m)
    total = np.maximum(weights.sum(axis=2), 1e-300)
    centred_m = offsets_m - ((weights * offsets_m).sum(axis=2) / total)[..., None]
    pull = weights * centred_m
    weighted = (weights[..., None] * units).transpose(0, 2, 3, 1)  # candidate, microphone, axis, emission
    own = weighted @ units.transpose(0, 2, 1, 3)
    means = weighted.reshape(n, 3 * n_mics, -1) / np.sqrt(total)[:, None]
    hessian = -(means @ means.swapaxes(1, 2))
    mics = np.arange(n_mics)
    hessian.reshape(n, n_mics, 3, n_mics, 3)[:, mics, :, mics] += own.swapaxes(0, 1)
    gradient = np.einsum("kem,kemi->kmi", pull, units).reshape(n, -1)
    return hessian, gradient, 0.5 * np.sum(pull * centred_m, axis=(1, 2))


def _damped(hessian: FloatArray, gradient: FloatArray, damping: FloatArray) -> FloatArray:
    scale = np.sqrt(np.maximum(np.diagonal(hessian, axis1=1, axis2=2), 1e-300))
    scaled = hessian / (scale[:, :, None] * scale[:, None, :])
    scaled += (damping[:, None, None] + 1e-13) * np.eye(scale.shape[1])
    step = np.linalg.solve(scaled, (gradient / scale)[..., None])[..., 0] / scale
    return np.asarray(step.reshape(len(step), -1, 3))
