"""Sounds located by the array alone: one place for each emission, from its arrivals at the calibrated microphones.

    a_n = T + |x_n - s| / c

When the emission began, T, is eliminated as in the joint problem; s is found by Levenberg-Marquardt under a Cauchy
loss from the best places of a coarse grid before the camera, all emissions at once. The speed of sound is that of the
session's air, not of the day of the calibration: what is known of it beforehand is corrected by what all emissions
together say. Nothing of what the camera saw enters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

MIN_ARRIVALS = 5
CAUCHY_WIDTH = 2.38
GRID_DEPTHS_M = (0.25, 0.4, 0.6, 0.9, 1.4, 2.2, 4.0)
GRID_SLOPES = np.linspace(-1.2, 1.2, 13)  # x / z and y / z
GRID_STD_S = 5e-5  # wide enough that neighbouring places of the grid share a basin
N_STARTS = 3
MAX_STEPS, MAX_ROUNDS = 30, 4
FARTHEST_M = 20.0
RIDGE = 1e-12  # keeps a place at infinity from being singular


@dataclass(frozen=True)
class Heard:
    """Arrivals to locate by, and the array that heard them.

    Parameters
    ----------
    microphones_m : (n_mics, 3) array
    covariance_m2 : (3 n_mics, 3 n_mics) array
    arrival_s, std_s : (n_emissions, n_mics) arrays
        Each emission on a time axis of its own; NaN where not heard.
    """

    microphones_m: FloatArray
    covariance_m2: FloatArray
    arrival_s: FloatArray
    std_s: FloatArray

    @property
    def present(self) -> NDArray[np.bool_]:
        """Which arrivals (n_emissions, n_mics) are there."""
        return np.asarray(np.isfinite(self.arrival_s) & np.isfinite(self.std_s))

    def expected_std_s(self, speed_m_s: float) -> FloatArray:
        """Return the standard deviations (n_emissions, n_mics) of arrivals, with those of the microphones' places."""
        place_m = np.sqrt(np.diag(self.covariance_m2).reshape(-1, 3).mean(axis=1))
        return np.asarray(np.sqrt(np.where(self.present, self.std_s, 1.0) ** 2 + (place_m / speed_m_s) ** 2))


@dataclass(frozen=True)
class Speed:
    """Speed of sound and its standard deviation, m/s."""

    m_s: float
    std_m_s: float


@dataclass(frozen=True)
class Located:
    """Where emissions came from by the array alone.

    Parameters
    ----------
    places_m : (n_emissions, 3) array
        Camera frame; NaN where there is none.
    covariance_m2 : (n_emissions, 3, 3) array
        From the scatter of arrivals, the microphones' places and the speed of sound.
    speed : Speed
    scale : float
        How far arrivals scatter, over what was expected.
    """

    places_m: FloatArray
    covariance_m2: FloatArray
    speed: Speed
    scale: float

    @property
    def found(self) -> NDArray[np.bool_]:
        """Which emissions (n_emissions,) were located."""
        return np.asarray(np.isfinite(self.places_m).all(axis=1))


def locate(heard: Heard, known: Speed) -> Located:
    """Locate every emission that enough microphones heard.

    Parameters
    ----------
    heard : Heard
    known : Speed
        What is known of the session's speed of sound beforehand.
    """
    enough = heard.present.sum(axis=1) >= MIN_ARRIVALS
    table = replace(heard, arrival_s=heard.arrival_s[enough], std_s=heard.std_s[enough])
    places_m = np.full((len(enough), 3), np.nan)
    covariance = np.full((len(enough), 3, 3), np.nan)
    speed, scale = known, 1.0
    if enough.any():
        fit = _Fit(table, known)
        fit.settle()
        found_m = np.where(fit.sane()[:, None], fit.places_m, np.nan)
        places_m[enough], covariance[enough] = found_m, fit.covariance()
        speed, scale = fit.speed, fit.scale
    return Located(places_m, covariance, speed, scale)


class _Fit:
    """Places of all emissions and the speed of sound, on the way to their best values."""

    def __init__(self, heard: Heard, known: Speed) -> None:
        self._heard, self._known = heard, known
        self.speed, self.scale = known, 1.0
        self._present = heard.present
        self._arrival_s = np.where(self._present, heard.arrival_s, 0.0)
        self._std_s = heard.expected_std_s(known.m_s)
        self.places_m = self._best_of_starts()

    def settle(self) -> None:
        """Let places, speed of sound and scatter follow one another until they agree."""
        for _ in range(MAX_ROUNDS):
            self.places_m = self._descended(self.places_m)
            self.scale = self._scatter()
            self.speed = self._corrected_speed()
        self.places_m = self._descended(self.places_m)

    def sane(self) -> NDArray[np.bool_]:
        """Tell which places (n_emissions,) are before the camera and within reach."""
        far = np.linalg.norm(self.places_m, axis=1) > FARTHEST_M
        return np.asarray((self.places_m[:, 2] > 0) & ~far & np.isfinite(self.places_m).all(axis=1))

    def covariance(self) -> FloatArray:
        """Return the covariances (n_emissions, 3, 3) of the places."""
        weights, units, gain = self._gains()
        by_microphone = gain[..., None] * units[:, None] / self.speed.m_s  # place by microphone: (e, 3, n, 3)
        by_microphone = by_microphone.reshape(*gain.shape[:2], -1)
        noise = np.where(weights > 0, (self.scale * np.where(self._present, self._heard.std_s, 0.0)) ** 2, 0.0)
        distances_m, _ = self._rays(self.places_m)
        by_speed = np.einsum("ein,en->ei", gain, distances_m) / self.speed.m_s**2 * self.speed.std_m_s
        return np.asarray(
            np.einsum("ein,en,ejn->eij", gain, noise, gain)
            + by_microphone @ self._heard.covariance_m2 @ by_microphone.swapaxes(1, 2)
            + by_speed[:, :, None] * by_speed[:, None]
        )

    def _gains(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return weights (e, n), units (e, n, 3) to microphones, and derivatives (e, 3, n) of places by arrivals."""
        _, units = self._rays(self.places_m)
        weights = self._weights(self._residuals(self.places_m), self.scale)
        slopes = self._centred(-units / self.speed.m_s, weights)
        normal = np.einsum("eni,en,enj->eij", slopes, weights, slopes)
        normal += RIDGE * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        gain = np.linalg.solve(normal, (slopes * weights[..., None]).swapaxes(1, 2))
        return weights, units, np.asarray(gain)

    def _rays(self, places_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        rays_m = self._heard.microphones_m - places_m[..., None, :]
        distances_m = np.linalg.norm(rays_m, axis=-1)
        return distances_m, rays_m / np.maximum(distances_m, 1e-9)[..., None]

    def _residuals(self, places_m: FloatArray) -> FloatArray:
        """Return arrivals minus flights, about their weighted mean under equal loss (e, n); 0 where missing."""
        offsets_s = self._arrival_s - self._rays(places_m)[0] / self.speed.m_s
        middle_s = np.nanmedian(np.where(self._present, offsets_s, np.nan), axis=1, keepdims=True)
        residuals_s = np.where(self._present, offsets_s - middle_s, 0.0)
        for _ in range(3):  # from the median to the robust mean
            residuals_s = self._centred(residuals_s[..., None], self._weights(residuals_s, self.scale))[..., 0]
        return np.where(self._present, residuals_s, 0.0)

    def _weights(self, residuals_s: FloatArray, scale: float) -> FloatArray:
        std_s = scale * self._std_s
        loose = 1 / (1 + (residuals_s / (CAUCHY_WIDTH * std_s)) ** 2)
        return np.where(self._present, loose / std_s**2, 0.0)

    def _centred(self, values: FloatArray, weights: FloatArray) -> FloatArray:
        """Return values (e, n, k) about their weighted means over the microphones."""
        shares = weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-300)
        return np.asarray(values - np.einsum("en,enk->ek", shares, values)[:, None])

    def _costs(self, places_m: FloatArray) -> FloatArray:
        deviations = self._residuals(places_m) / (CAUCHY_WIDTH * self.scale * self._std_s)
        return np.asarray(np.sum(np.log1p(deviations**2), axis=1))

    def _descended(self, places_m: FloatArray) -> FloatArray:
        """Return the places (e, 3) after Levenberg-Marquardt, each with a damping of its own."""
        damping, costs = np.full(len(places_m), 1e-3), self._costs(places_m)
        for _ in range(MAX_STEPS):
            residuals_s = self._residuals(places_m)
            weights = self._weights(residuals_s, self.scale)
            slopes = self._centred(-self._rays(places_m)[1] / self.speed.m_s, weights)
            normal = np.einsum("eni,en,enj->eij", slopes, weights, slopes)
            pull = np.einsum("eni,en,en->ei", slopes, weights, residuals_s)
            diagonal = np.einsum("eii->ei", normal)
            damped = normal + (damping[:, None] * diagonal + 1e-9)[..., None] * np.eye(3)
            steps_m = np.linalg.solve(damped, pull[..., None])[..., 0]
            moved_m = places_m + np.clip(steps_m, -0.5, 0.5)
            new_costs = self._costs(moved_m)
            better = new_costs <= costs
            places_m, costs = np.where(better[:, None], moved_m, places_m), np.where(better, new_costs, costs)
            damping = np.where(better, np.maximum(damping / 10, 1e-9), np.minimum(damping * 10, 1e9))
            if np.abs(steps_m).max() < 1e-7:
                break
        return places_m

    def _best_of_starts(self) -> FloatArray:
        grid_m = np.array([(x * z, y * z, z) for z in GRID_DEPTHS_M for x in GRID_SLOPES for y in GRID_SLOPES])
        flights_s = np.linalg.norm(self._heard.microphones_m - grid_m[:, None], axis=2) / self.speed.m_s
        offsets_s = np.where(self._present, self._heard.arrival_s, np.nan)[:, None] - flights_s
        offsets_s -= np.nanmedian(offsets_s, axis=2, keepdims=True)
        costs = np.nansum(np.log1p((offsets_s / GRID_STD_S) ** 2), axis=2)
        nearest = np.argsort(costs, axis=1)[:, :N_STARTS]
        ends_m = [self._descended(grid_m[nearest[:, number]]) for number in range(N_STARTS)]
        chosen = np.argmin([self._costs(end_m) for end_m in ends_m], axis=0)
        return np.asarray(np.array(ends_m)[chosen, np.arange(len(chosen))])

    def _scatter(self) -> float:
        """Return how far arrivals scatter over what was expected, never less than 1; blind to outliers."""
        ratios = (np.abs(self._residuals(self.places_m)) / self._std_s)[self._present]
        share = 1 - 4 / self._present.sum(axis=1).mean()  # three coordinates and the beginning are fitted
        return max(1.0, float(1.4826 * np.median(ratios) / np.sqrt(share)))

    def _corrected_speed(self) -> Speed:
        """Weigh what is known of the speed of sound against what all emissions together say."""
        weights, _, gain = self._gains()
        distances_m, units = self._rays(self.places_m)
        by_speed = -distances_m / self.speed.m_s**2
        slopes = self._centred(np.concatenate([-units / self.speed.m_s, by_speed[..., None]], axis=2), weights)
        alone = slopes[..., 3] - np.einsum("eni,eim,em->en", slopes[..., :3], gain, slopes[..., 3])
        prior = 1 / max(self._known.std_m_s, 1e-6) ** 2
        information = float(np.sum(weights * alone**2)) + prior
        pull = float(np.sum(weights * alone * self._residuals(self.places_m)))
        pull += prior * (self._known.m_s - self.speed.m_s)
        return Speed(self.speed.m_s + pull / information, information**-0.5)
