"""What is drawn for each repetition: poses, first guesses, buzzers out of place, noise.

Each draw has a stream of its own, made from the study's seed, the situation and the repetition's number. So a
repetition is the same whoever computes it, in whatever company, and methods are tried on the same draws.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.baseline.batch import distances
from calib.study.description import MeasuredNoise, UniformNoise
from calib.study.scene import Scene

FloatArray = NDArray[np.float64]
SUBSET, START, BUZZERS, NOISE, OUTLIERS = range(5)
MAX_OUTLIER_S = 2e-3


@dataclass(frozen=True)
class Places:
    """Where emissions come from in several repetitions: what the solver is told, and what is true.

    Parameters
    ----------
    poses : (n, n_poses) integer array
        Rows of the scene's poses.
    told_m, true_m : (n or 1, n_emissions, 3) arrays
        Camera frame.
    """

    poses: NDArray[np.intp]
    told_m: FloatArray
    true_m: FloatArray


def generator(scene: Scene, repetition: int, stream: int) -> np.random.Generator:
    """Return the generator of one draw of one repetition."""
    return np.random.default_rng(np.random.SeedSequence(scene.seed, spawn_key=(scene.situation, repetition, stream)))


def draw_places(scene: Scene, repetitions: range) -> Places:
    """Draw subsets of poses and true places of the buzzers."""
    n_poses, n_subset = len(scene.rotations), scene.n_subset
    if n_subset is None:
        poses = np.arange(n_poses)[None]
    else:
        poses = np.array(
            [np.sort(generator(scene, number, SUBSET).permutation(n_poses)[:n_subset]) for number in repetitions]
        )
    told_m = _emissions(scene, poses, scene.buzzers_m[None])
    std_m = 0.0 if isinstance(scene.noise, MeasuredNoise) else scene.noise.buzzer_std_m
    if std_m == 0:
        return Places(poses, told_m, told_m)
    shape = scene.buzzers_m.shape
    errors_m = [std_m * generator(scene, number, BUZZERS).standard_normal(shape) for number in repetitions]
    return Places(poses, told_m, _emissions(scene, poses, scene.buzzers_m + np.array(errors_m)))


def draw_starts(scene: Scene, repetitions: range) -> tuple[FloatArray, FloatArray]:
    """Draw microphones (n, n_mics, 3) in the array's frame, and its origin (n, 3) in the camera frame."""
    start, low_m = scene.start, np.array(scene.start.low_m)
    boxes, origins = [], []
    for number in repetitions:
        drawn = generator(scene, 0 if start.drawn == "once" else number, START)
        boxes.append(drawn.uniform(low_m, np.array(start.high_m), scene.microphones_m.shape))
        origins.append(np.array(start.offset_m) + drawn.uniform(-start.jitter_m, start.jitter_m, 3))
    return np.array(boxes), np.array(origins)


def measure_pairs(scene: Scene, places: Places, repetitions: range, incidence: FloatArray) -> FloatArray:
    """Measure TDOAs (n, n_emissions, n_pairs) of the pairs of an incidence."""
    if scene.measured_s is not None:
        return _published(scene, places, repetitions)
    if not isinstance(scene.noise, MeasuredNoise) and scene.noise.adds_to == "pairs":
        exact_s = _flights(scene, places)[..., : incidence.shape[1]] @ incidence.T
        return _noisy(scene, repetitions, exact_s, 1.0)
    return measure_arrivals(scene, places, repetitions)[..., : incidence.shape[1]] @ incidence.T


def measure_arrivals(scene: Scene, places: Places, repetitions: range) -> FloatArray:
    """Measure arrivals (n, n_emissions, n_mics and the known one), times of emission being known.

    Published TDOAs against the known microphone become arrivals by its distance.
    """
    exact_s = _flights(scene, places)
    if scene.measured_s is not None:
        known_s = np.broadcast_to(exact_s[..., -1:], (len(repetitions), *exact_s.shape[1:2], 1))
        return np.concatenate([_published(scene, places, repetitions) + known_s, known_s], axis=2)
    share = np.sqrt(0.5) if not isinstance(scene.noise, MeasuredNoise) and scene.noise.adds_to == "pairs" else 1.0
    return _noisy(scene, repetitions, exact_s, float(share))


def noise_std_s(scene: Scene) -> float:
    """Return the standard deviation of the noise, of TDOAs or of arrivals, as the scene has it; NaN where measured."""
    noise = scene.noise
    if isinstance(noise, MeasuredNoise):
        return float("nan")
    variance = noise.scale_s**2 / (12 if isinstance(noise, UniformNoise) else 1)
    return float(np.sqrt(variance + noise.grid_s**2 / 12))


def _emissions(scene: Scene, poses: NDArray[np.intp], buzzers_m: FloatArray) -> FloatArray:
    rotations, translations_m = scene.rotations[poses], scene.translations_m[poses]
    turned_m = np.einsum("kpij,kbj->kpbi", *_together(rotations, buzzers_m)) + translations_m[:, :, None]
    return np.asarray(turned_m.reshape(len(turned_m), -1, 3))


def _together(first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
    n = max(len(first), len(second))
    return np.broadcast_to(first, (n, *first.shape[1:])), np.broadcast_to(second, (n, *second.shape[1:]))


def _flights(scene: Scene, places: Places) -> FloatArray:
    nodes_m = scene.microphones_m if scene.known_m is None else np.vstack([scene.microphones_m, scene.known_m])
    return distances(nodes_m[None], places.true_m)[0] / scene.speed_m_s


def _published(scene: Scene, places: Places, repetitions: range) -> FloatArray:
    assert scene.measured_s is not None
    by_pose = scene.measured_s.reshape(len(scene.rotations), len(scene.buzzers_m), -1)
    chosen = by_pose[places.poses].reshape(len(places.poses), -1, by_pose.shape[2])
    return np.broadcast_to(chosen, (len(repetitions), *chosen.shape[1:]))


def _noisy(scene: Scene, repetitions: range, exact_s: FloatArray, share: float) -> FloatArray:
    noise = scene.noise
    assert not isinstance(noise, MeasuredNoise)
    measured_s = np.empty((len(repetitions), *exact_s.shape[1:]))
    for row, number in enumerate(repetitions):
        drawn = generator(scene, number, NOISE)
        shape = exact_s.shape[1:]
        errors = drawn.random(shape) if isinstance(noise, UniformNoise) else drawn.standard_normal(shape)
        measured_s[row] = exact_s[row if len(exact_s) > 1 else 0] + share * noise.scale_s * errors
        if noise.outliers:
            wild = generator(scene, number, OUTLIERS)
            off_s = wild.uniform(-MAX_OUTLIER_S, MAX_OUTLIER_S, shape)
            measured_s[row] += np.where(wild.random(shape) < noise.outliers, off_s, 0.0)
    return np.round(measured_s / noise.grid_s) * noise.grid_s if noise.grid_s else measured_s
