"""The Cramer-Rao bound: what no unbiased method can do better, for Gaussian noise of the same variance.

Buzzers out of place are unknowns with a prior. Times of emission are unknown, but for the method that measures them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.baseline.batch import all_pairs, distances
from calib.study.description import MeasuredNoise
from calib.study.draws import Places, noise_std_s
from calib.study.scene import Scene

FloatArray = NDArray[np.float64]


def rms_bound_m(scene: Scene, places: Places, counted: int | None = None) -> FloatArray:
    """Return the bound (n or 1,) of the root mean square error of the microphones; NaN where there is none.

    Only the first `counted` microphones' squared errors are summed, but still divided by the number of all: so the
    paper counts 7 of 8. None: all of them.
    """
    std_s = noise_std_s(scene)
    if not std_s > 0 or isinstance(scene.noise, MeasuredNoise):
        return np.full(len(places.told_m), np.nan)
    laplacian = _laplacian(scene) / (std_s * scene.speed_m_s) ** 2
    n_values = 3 * (counted or len(scene.microphones_m))
    return np.array([_bound_m(scene, sources_m, poses, laplacian, n_values) for sources_m, poses in _each(places)])


def _each(places: Places) -> list[tuple[FloatArray, NDArray[np.intp]]]:
    poses = np.broadcast_to(places.poses, (len(places.told_m), places.poses.shape[1]))
    return list(zip(places.told_m, poses, strict=True))


def _laplacian(scene: Scene) -> FloatArray:
    """Return what one emission tells of the ranges (n_mics, n_mics), over the variance."""
    n_mics, on_pairs = len(scene.microphones_m), getattr(scene.noise, "adds_to", "") == "pairs"
    if scene.method == "legg-2013":
        return np.eye(n_mics) * (2 if on_pairs else 1)
    if scene.method in ("ours-3", "search"):
        return np.eye(n_mics) if on_pairs else np.eye(n_mics) - 1 / (n_mics + 1)
    if not on_pairs:
        return np.eye(n_mics) - 1 / n_mics
    if scene.method == "ours-1":
        against_first = np.hstack([-np.ones((n_mics - 1, 1)), np.eye(n_mics - 1)])
        return np.asarray(against_first.T @ against_first)
    pairs = all_pairs(n_mics)
    return np.asarray(pairs.T @ pairs)


def _bound_m(
    scene: Scene, sources_m: FloatArray, poses: NDArray[np.intp], laplacian: FloatArray, n_values: int
) -> float:
    n_mics, n_buzzers = scene.microphones_m.shape[0], len(scene.buzzers_m)
    units = distances(scene.microphones_m[None], sources_m[None])[1][0]
    by_source = -np.einsum("emi,eij->emj", units, np.repeat(scene.rotations[poses], n_buzzers, axis=0))
    jacobian = np.zeros((len(units), n_mics, 3 * (n_mics + n_buzzers)))
    for mic in range(n_mics):
        jacobian[:, mic, 3 * mic : 3 * mic + 3] = units[:, mic]
    for buzzer in range(n_buzzers):
        columns = slice(3 * (n_mics + buzzer), 3 * (n_mics + buzzer + 1))
        jacobian[buzzer::n_buzzers, :, columns] = by_source[buzzer::n_buzzers]
    free = slice(None) if _buzzer_std_m(scene) else slice(3 * n_mics)
    jacobian = jacobian[..., free]
    flat = jacobian.reshape(-1, jacobian.shape[2])
    information = flat.T @ (laplacian @ jacobian).reshape(flat.shape)
    if _buzzer_std_m(scene):
        information[3 * n_mics :, 3 * n_mics :] += np.eye(3 * n_buzzers) / _buzzer_std_m(scene) ** 2
    try:
        covariance = np.linalg.inv(information)
    except np.linalg.LinAlgError:
        return float("nan")
    variance_m2 = float(np.trace(covariance[:n_values, :n_values])) / n_mics
    return float(np.sqrt(variance_m2)) if variance_m2 > 0 else float("nan")


def _buzzer_std_m(scene: Scene) -> float:
    return 0.0 if isinstance(scene.noise, MeasuredNoise) else scene.noise.buzzer_std_m
