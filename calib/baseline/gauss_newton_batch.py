"""Gauss-Newton of the paper on many repetitions at once; `gauss_newton` does the same with one.

With a batch's incidence A, distances d and directions u the normal equations of one repetition are those of the
Laplacian A'A: block (m, n) is (A'A)_mn sum_e u_em u_en', the gradient of microphone m is sum_e u_em (A'(cT - A d))_em.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.baseline.batch import FloatArray, PairBatch, distances
from calib.baseline.gauss_newton import MAX_ITERATIONS

RIDGE = 1e-13  # of the trace: keeps singular steps finite, where lstsq would take the shortest
MAX_REACH_M = 1e6  # far beyond this, squares overflow; such a run has long been lost


@dataclass(frozen=True)
class BatchRuns:
    """Where the runs ended (n, n_mics, 3), whether the last step was under the threshold, and the number of steps."""

    places_m: FloatArray
    settled: NDArray[np.bool_]
    n_iterations: NDArray[np.intp]


def gauss_newton_together(
    batch: PairBatch, start_m: FloatArray, step_threshold_m: float, max_iterations: int = MAX_ITERATIONS
) -> BatchRuns:
    """Minimise the sum of squared TDOA residuals in each repetition, from starts (n, n_mics, 3).

    Source: arXiv 2502.06196, section III-B.
    """
    n = len(batch.tdoa_s)
    places_m = np.broadcast_to(start_m, (n, batch.n_mics, 3)).copy()
    settled, n_iterations = np.zeros(n, dtype=bool), np.zeros(n, dtype=np.intp)
    alive = np.ones(n, dtype=bool)
    for _ in range(max_iterations):
        steps_m = _steps(batch.only(alive), places_m[alive])
        places_m[alive] += steps_m
        n_iterations[alive] += 1
        running = np.flatnonzero(alive)
        settled[running] = np.sqrt(np.sum(steps_m**2, axis=(1, 2))) < step_threshold_m
        lost = ~(np.abs(places_m).max(axis=(1, 2)) < MAX_REACH_M)
        alive &= ~settled & ~lost
        if not alive.any():
            break
    return BatchRuns(places_m, settled, n_iterations)


def _steps(batch: PairBatch, places_m: FloatArray) -> FloatArray:
    n, n_mics = places_m.shape[:2]
    lengths_m, units = distances(places_m, batch.sources_m)
    known_m, _ = distances(batch.known_m, batch.sources_m)
    all_m = np.concatenate([lengths_m, np.broadcast_to(known_m, (n, *known_m.shape[1:]))], axis=2)
    residuals_m = batch.tdoa_s * batch.speed_m_s - all_m @ batch.incidence.T
    own = batch.incidence[:, :n_mics]
    pull_m = residuals_m @ own
    columns = units.reshape(n, -1, 3 * n_mics)
    hessian = (columns.swapaxes(1, 2) @ columns) * np.kron(own.T @ own, np.ones((3, 3)))
    trace = np.trace(hessian, axis1=1, axis2=2)[:, None, None]
    gradient = np.einsum("kem,kemi->kmi", pull_m, units).reshape(n, -1)
    hessian += RIDGE * trace * np.eye(3 * n_mics)
    return np.asarray(np.linalg.solve(hessian, gradient[..., None])[..., 0].reshape(n, n_mics, 3))
