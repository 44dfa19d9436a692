"""The authors' search, their reading of Legg and Bradley 2013, as published with arXiv 2502.06196.

Unknown are the array's pose (rotation vector, translation) and the microphones in the array's frame. A coordinate is
stepped while the squared error falls. The first step that raises it is undone; then the direction turns round if only a
few errors have been logged in that pass, else the next coordinate's turn comes. The direction is shared by all
coordinates, and the pose can move by 0.11 m and 11 mrad at most: so it was published, and that explains its results.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.baseline.batch import FloatArray, PairBatch, distances
from calib.joint.unknowns import rotation_matrices

POSE_PASSES, POSE_TRIALS, POSE_EARLY = 10, 10, 4
FIRST_TURN_RAD, FIRST_SHIFT_M, POSE_SHRINK, LAST_SHIFT_M = 1e-3, 1e-2, 10.0, 1e-5
MIC_PASSES, MIC_TRIALS, MIC_EARLY = 50, 20, 10
FIRST_MIC_STEP_M, MIC_SHRINK, LAST_MIC_STEP_M = 1e-2, 1.1, 1e-3

ErrorAt = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class ArrayState:
    """Rotation vector (n, 3) and translation (n, 3) of the array's frame, microphones (n, n_mics, 3) in it."""

    turn_rad: FloatArray
    shift_m: FloatArray
    microphones_m: FloatArray

    def places_m(self) -> FloatArray:
        """Return the microphones (n, n_mics, 3) in the camera frame."""
        return np.asarray(self.microphones_m @ rotation_matrices(self.turn_rad).swapaxes(1, 2) + self.shift_m[:, None])


@dataclass
class _Pass:
    """What one pass has seen: the last error, how many were logged, and the direction that all coordinates share."""

    error: FloatArray
    n_logged: NDArray[np.intp]
    sign: FloatArray


def search_coordinates(batch: PairBatch, start: ArrayState) -> ArrayState:
    """Search pose, then microphones, in all repetitions; `batch` holds TDOAs against one known microphone each."""
    known_m, _ = distances(batch.known_m, batch.sources_m)
    targets_m = batch.tdoa_s * batch.speed_m_s + known_m
    return _search_microphones(batch.sources_m, targets_m, _search_pose(batch.sources_m, targets_m, start))


def _search_pose(sources_m: FloatArray, targets_m: FloatArray, state: ArrayState) -> ArrayState:
    pose = np.concatenate([state.turn_rad, state.shift_m], axis=1)
    steps = np.repeat([FIRST_TURN_RAD, FIRST_SHIFT_M], 3)
    sign = -np.ones(len(pose))
    for _ in range(POSE_PASSES):
        seen = _Pass(_error(sources_m, targets_m, _posed(state, pose)), np.ones(len(pose), dtype=np.intp), sign)
        for index in range(6):
            error_at = _over_pose(sources_m, targets_m, state, pose, index)
            pose[:, index] = _stepped(pose[:, index], steps[index], seen, error_at, POSE_TRIALS, POSE_EARLY)
        sign, steps = seen.sign, steps / POSE_SHRINK
        if steps[-1] < LAST_SHIFT_M:
            break
    return _posed(state, pose)


def _search_microphones(sources_m: FloatArray, targets_m: FloatArray, state: ArrayState) -> ArrayState:
    """Search microphone by microphone: only its own residuals change, the others' errors stay as they are."""
    axes, microphones_m = rotation_matrices(state.turn_rad), state.microphones_m.copy()
    errors_m2 = np.sum(_residuals(sources_m, targets_m, state) ** 2, axis=1)
    sign, step_m = np.ones(len(axes)), FIRST_MIC_STEP_M / MIC_SHRINK
    for _ in range(MIC_PASSES):
        if step_m < LAST_MIC_STEP_M:  # the authors search such a pass too, but report the one before
            break
        seen = _Pass(errors_m2.sum(axis=1), np.ones(len(sign), dtype=np.intp), sign)
        for mic in range(microphones_m.shape[1]):
            others_m2 = errors_m2.sum(axis=1) - errors_m2[:, mic]
            for axis in range(3):
                place_m = np.einsum("kij,kj->ki", axes, microphones_m[:, mic]) + state.shift_m
                rays_m, old_m = place_m[:, None] - sources_m, microphones_m[:, mic, axis].copy()
                error_at = _over_line(rays_m, axes[:, :, axis], targets_m[:, :, mic], old_m, others_m2)
                microphones_m[:, mic, axis] = _stepped(old_m, step_m, seen, error_at, MIC_TRIALS, MIC_EARLY)
            errors_m2[:, mic] = seen.error - others_m2
        sign, step_m = seen.sign, step_m / MIC_SHRINK
    return replace(state, microphones_m=microphones_m)


def _stepped(value: FloatArray, step: float, seen: _Pass, error_at: ErrorAt, trials: int, early: int) -> FloatArray:
    """Step one coordinate (n,) of all repetitions while their errors fall."""
    active = np.ones(len(value), dtype=bool)
    for _ in range(trials):
        tried = value + step * seen.sign
        error = error_at(tried)
        falls = active & ~(error > seen.error)
        rises = active & ~falls
        value = np.where(falls, tried, value)
        seen.error = np.where(falls, error, seen.error)
        seen.n_logged = seen.n_logged + falls
        turns = rises & (seen.n_logged < early)
        seen.sign = np.where(turns, -seen.sign, seen.sign)
        active &= falls | turns
        if not active.any():
            break
    return value


def _over_pose(
    sources_m: FloatArray, targets_m: FloatArray, state: ArrayState, pose: FloatArray, index: int
) -> ErrorAt:
    def error_at(value: FloatArray) -> FloatArray:
        moved = pose.copy()
        moved[:, index] = value
        return _error(sources_m, targets_m, _posed(state, moved))

    return error_at


def _over_line(
    rays_m: FloatArray, axis: FloatArray, target_m: FloatArray, old_m: FloatArray, others_m2: FloatArray
) -> ErrorAt:
    """Return the error of a microphone that moves along an axis: |ray + t axis|^2 = |ray|^2 + 2 t ray.axis + t^2."""
    squares_m2 = np.einsum("kei,kei->ke", rays_m, rays_m)
    slopes_m = 2 * np.einsum("kei,ki->ke", rays_m, axis)

    def error_at(value_m: FloatArray) -> FloatArray:
        moved_m = (value_m - old_m)[:, None]
        lengths_m = np.sqrt(np.maximum(squares_m2 + moved_m * (slopes_m + moved_m), 0.0))
        return np.asarray(others_m2 + np.sum((lengths_m - target_m) ** 2, axis=1))

    return error_at


def _posed(state: ArrayState, pose: FloatArray) -> ArrayState:
    return replace(state, turn_rad=pose[:, :3], shift_m=pose[:, 3:])


def _residuals(sources_m: FloatArray, targets_m: FloatArray, state: ArrayState) -> FloatArray:
    return distances(state.places_m(), sources_m)[0] - targets_m


def _error(sources_m: FloatArray, targets_m: FloatArray, state: ArrayState) -> FloatArray:
    return np.asarray(np.sum(_residuals(sources_m, targets_m, state) ** 2, axis=(1, 2)))
