"""The method of Legg and Bradley 2013, as its description has it; not the search that arXiv 2502.06196 compares with.

It takes arrival times, not their differences, and a reference microphone at a known place. The speed of sound and the
latency of the sound system come from a straight line through the reference's arrival times over distance. Then the
microphones are moved, one coordinate after the other with steps that shrink, until they fit the arrivals; then the
sources in the same way; and measurements that fit badly are weighted down. All of this is repeated.

Source: M. Legg, S. Bradley, "A combined microphone and camera calibration technique with application to acoustic
imaging", IEEE Transactions on Image Processing 22 (2013), doi:10.1109/TIP.2013.2268974. Step sizes, number of rounds
and the form of the weights are ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.baseline.batch import FloatArray

N_ROUNDS = 4
FIRST_STEP_M, NEXT_STEP_M, LAST_STEP_M = 0.1, 0.01, 2e-5
MAX_STEPS, STEPS_AT_ONCE = 240, 8
CAUCHY_WIDTH = 2.385
MAX_SPEED_ERROR = 0.3  # of 343 m/s: a line through mere noise is no measurement of the speed of sound
USUAL_SPEED_M_S = 343.0


@dataclass(frozen=True)
class FlightBatch:
    """Arrival times of emissions whose time of emission is known but for a latency, in several repetitions.

    Parameters
    ----------
    sources_m : (n, n_emissions, 3) array
        Where the camera has them.
    arrival_s : (n, n_emissions, n_mics) array
    reference_s : (n, n_emissions) array
        At the reference microphone.
    reference_m : (n or 1, 3) array
    """

    sources_m: FloatArray
    arrival_s: FloatArray
    reference_s: FloatArray
    reference_m: FloatArray


def legg_2013(batch: FlightBatch, start_m: FloatArray) -> FloatArray:
    """Find the microphones (n, n_mics, 3) of all repetitions, from starts of the same shape."""
    latency_s, speed_m_s = _latency_and_speed(batch)
    ranges_m = (batch.arrival_s - latency_s[:, None, None]) * speed_m_s[:, None, None]
    places_m, sources_m, weights = start_m, batch.sources_m, np.ones_like(ranges_m)
    for number in range(N_ROUNDS):
        step_m = FIRST_STEP_M if number == 0 else NEXT_STEP_M
        places_m = _adjusted(places_m, sources_m, ranges_m.swapaxes(1, 2), weights.swapaxes(1, 2), step_m)
        sources_m = _adjusted(sources_m, places_m, ranges_m, weights, NEXT_STEP_M)
        weights = _weights(_misfits(sources_m, places_m, ranges_m))
    return _adjusted(places_m, sources_m, ranges_m.swapaxes(1, 2), weights.swapaxes(1, 2), NEXT_STEP_M)


def _latency_and_speed(batch: FlightBatch) -> tuple[FloatArray, FloatArray]:
    """Fit arrival at the reference = latency + distance / speed; both (n,)."""
    distance_m = np.linalg.norm(batch.sources_m - batch.reference_m[:, None], axis=2)
    centred_m = distance_m - distance_m.mean(axis=1, keepdims=True)
    centred_s = batch.reference_s - batch.reference_s.mean(axis=1, keepdims=True)
    slowness = np.sum(centred_m * centred_s, axis=1) / np.sum(centred_m**2, axis=1)
    likely = np.abs(slowness * USUAL_SPEED_M_S - 1) < MAX_SPEED_ERROR
    slowness = np.where(likely, slowness, 1 / USUAL_SPEED_M_S)
    return batch.reference_s.mean(axis=1) - slowness * distance_m.mean(axis=1), 1 / slowness


def _adjusted(
    points_m: FloatArray, anchors_m: FloatArray, ranges_m: FloatArray, weights: FloatArray, step_m: float
) -> FloatArray:
    """Move points (n, p, 3) until they fit their ranges (n, p, a) from anchors (n, a, 3)."""
    shape = points_m.shape
    repetition = np.repeat(np.arange(shape[0]), shape[1])
    n_anchors = anchors_m.shape[1]
    ranges_m, weights = ranges_m.reshape(-1, n_anchors), weights.reshape(-1, n_anchors)
    places_m, steps_m = points_m.reshape(-1, 3).copy(), np.full(len(repetition), step_m)
    active = np.arange(len(repetition))
    for _ in range(0, MAX_STEPS, STEPS_AT_ONCE):
        ball = _Ranges(anchors_m[repetition[active]], ranges_m[active], weights[active])
        places_m[active], steps_m[active] = _steps(ball, places_m[active], steps_m[active])
        active = np.flatnonzero(steps_m >= LAST_STEP_M)
        if not len(active):
            break
    return places_m.reshape(shape)


@dataclass(frozen=True)
class _Ranges:
    """What each of p points is to fit: anchors (p, a, 3), ranges and weights (p, a)."""

    anchors_m: FloatArray
    ranges_m: FloatArray
    weights: FloatArray

    def cost(self, places_m: FloatArray) -> FloatArray:
        squares_m2 = sum((places_m[:, None, axis] - self.anchors_m[..., axis]) ** 2 for axis in range(3))
        return np.asarray(np.sum(self.weights * (np.sqrt(squares_m2) - self.ranges_m) ** 2, axis=1))


def _steps(ball: _Ranges, places_m: FloatArray, steps_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    cost = ball.cost(places_m)
    for _ in range(STEPS_AT_ONCE):
        moved = np.zeros(len(steps_m), dtype=bool)
        for axis in range(3):
            for side in (1.0, -1.0):
                tried_m = places_m.copy()
                tried_m[:, axis] += side * steps_m
                tried_cost = ball.cost(tried_m)
                better: NDArray[np.bool_] = tried_cost < cost
                places_m, cost = np.where(better[:, None], tried_m, places_m), np.where(better, tried_cost, cost)
                moved |= better
        steps_m = np.where(moved, steps_m, steps_m / 2)
    return places_m, steps_m


def _misfits(points_m: FloatArray, anchors_m: FloatArray, ranges_m: FloatArray) -> FloatArray:
    """Return distances minus ranges (n, p, a)."""
    squares_m2 = sum((points_m[:, :, None, axis] - anchors_m[:, None, :, axis]) ** 2 for axis in range(3))
    return np.asarray(np.sqrt(squares_m2) - ranges_m)


def _weights(misfits_m: FloatArray) -> FloatArray:
    """Return Cauchy weights whose width follows each repetition's own misfits."""
    width_m = CAUCHY_WIDTH * 1.4826 * np.median(np.abs(misfits_m), axis=(1, 2), keepdims=True)
    return np.asarray(1 / (1 + (misfits_m / np.maximum(width_m, 1e-9)) ** 2))
