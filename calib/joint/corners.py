"""Residuals of the board's corners in the pictures and their derivatives.

A corner at q on the board, the printed squares m times as large as described, is seen at project(m R_p q + t_p): a
pinhole camera with Brown-Conrady distortion, as OpenCV has it. No print is perfect and no board flat, and such errors
are the same in every picture, so no number of pictures averages them away: q may be found along with the rest
(K. H. Strobl and G. Hirzinger, ICCV Workshops 2011, doi:10.1109/ICCVW.2011.6130369).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.joint.equations import NormalEquations
from calib.joint.unknowns import POSE_SIZE, Unknowns, cross_matrices

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class CornerTable:
    """Corners seen at each pose.

    Parameters
    ----------
    board_m : (n_corners, 3) array
        Board frame, as described.
    seen_px : (n_poses, n_corners, 2) array
        NaN where not seen.
    std_px : float
        Standard deviation of a corner, per axis.
    """

    board_m: FloatArray
    seen_px: FloatArray
    std_px: float

    @cached_property
    def present(self) -> NDArray[np.bool_]:
        """Which corners (n_poses, n_corners) were seen."""
        return np.asarray(np.isfinite(self.seen_px).all(axis=2))

    @cached_property
    def information(self) -> FloatArray:
        """Weights 1 / std^2 (n_poses, n_corners), 0 where not seen."""
        return self.present / self.std_px**2

    def only(self, poses: NDArray[np.bool_]) -> CornerTable:
        """Return the corners of some poses (n_poses,)."""
        return replace(self, seen_px=self.seen_px[poses])

    def residuals_px(self, at: Unknowns) -> FloatArray:
        """Return corners seen minus corners projected (n_poses, n_corners, 2), NaN where not seen."""
        return self.seen_px - project(self._places_m(at), at.camera)[0]

    def normal_equations(self, at: Unknowns, weights: FloatArray) -> NormalEquations:
        """Linearise at some values, with weights (n_poses, n_corners) in 1/px^2."""
        places_m = self._places_m(at)
        projected_px, by_place, by_camera = project(places_m, at.camera)
        arms_m = places_m - at.translations_m[:, None]
        by_pose = np.concatenate([by_place @ -cross_matrices(arms_m), by_place], axis=3)
        by_scale = by_place @ (arms_m / at.scale)[..., None]
        by_shared = np.concatenate([by_scale, by_camera], axis=3)
        weights = np.where(self.present, weights, 0.0)
        residuals_px = np.where(self.present[..., None], self.seen_px - projected_px, 0.0)
        equations = _assembled(at, by_shared, by_pose, residuals_px, weights)
        if at.blocks.n_corners:
            by_corner = by_place @ (at.scale * at.rotations[:, None])
            _add_own(equations, at, by_corner, by_shared, by_pose, weights[..., None] * residuals_px, weights)
        return equations

    def _places_m(self, at: Unknowns) -> FloatArray:
        turned_m = (self.board_m + at.corners_m) @ at.rotations.swapaxes(1, 2)
        return np.asarray(at.scale * turned_m + at.translations_m[:, None])


def project(places_m: FloatArray, camera: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Project places (..., 3) of the camera frame.

    Returns
    -------
    pixels (..., 2), their derivatives (..., 2, 3) by the places and (..., 2, 9) by the intrinsics
    """
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = camera
    depth = np.where(np.abs(places_m[..., 2]) < 1e-9, 1e-9, places_m[..., 2])
    x, y = places_m[..., 0] / depth, places_m[..., 1] / depth
    r2 = x**2 + y**2
    radial, slope = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), k1 + r2 * (2 * k2 + r2 * 3 * k3)
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    v = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    pixels = np.stack([fx * u + cx, fy * v + cy], axis=-1)
    crossed = 2 * (x * y * slope + p1 * x + p2 * y)
    u_by = (fx * (radial + 2 * x**2 * slope + 2 * p1 * y + 6 * p2 * x), fx * crossed)
    v_by = (fy * crossed, fy * (radial + 2 * y**2 * slope + 6 * p1 * y + 2 * p2 * x))
    by_place = np.empty((*pixels.shape, 3))
    for row, (by_x, by_y) in enumerate((u_by, v_by)):
        by_place[..., row, 0], by_place[..., row, 1] = by_x / depth, by_y / depth
        by_place[..., row, 2] = -(by_x * x + by_y * y) / depth
    by_camera = np.zeros((*pixels.shape, 9))
    by_camera[..., 0, 0], by_camera[..., 1, 1] = u, v
    by_camera[..., 0, 2] = by_camera[..., 1, 3] = 1.0
    for column, power in ((4, r2), (5, r2**2), (8, r2**3)):
        by_camera[..., 0, column], by_camera[..., 1, column] = fx * x * power, fy * y * power
    by_camera[..., 0, 6], by_camera[..., 1, 6] = fx * 2 * x * y, fy * (r2 + 2 * y**2)
    by_camera[..., 0, 7], by_camera[..., 1, 7] = fx * (r2 + 2 * x**2), fy * 2 * x * y
    return pixels, by_place, by_camera


def _assembled(
    at: Unknowns, by_shared: FloatArray, by_pose: FloatArray, residuals_px: FloatArray, weights: FloatArray
) -> NormalEquations:
    """Sum over the corners; the shared columns are the board's scale and the camera."""
    n_poses, size = len(at.rotations), at.blocks.size
    places = np.arange(at.blocks.scale.start, at.blocks.camera.stop)
    rows = (n_poses, -1)
    weight = np.repeat(weights, 2, axis=1)[..., None]  # of both coordinates of a corner
    by_shared = by_shared.reshape(*rows, len(places))
    by_pose = by_pose.reshape(*rows, POSE_SIZE)
    pull = weight * residuals_px.reshape(*rows, 1)
    shared, gradient = np.zeros((size, size)), np.zeros(size)
    border = np.zeros((n_poses, size, POSE_SIZE))
    flat = by_shared.reshape(-1, len(places))
    shared[np.ix_(places, places)] = flat.T @ (weight * by_shared).reshape(-1, len(places))
    gradient[places] = flat.T @ pull.ravel()
    turned = by_pose.swapaxes(1, 2)
    border[:, places] = by_shared.swapaxes(1, 2) @ (weight * by_pose)
    cost = 0.5 * float(np.sum(pull.ravel() * residuals_px.ravel()))
    return NormalEquations(shared, border, turned @ (weight * by_pose), gradient, (turned @ pull)[..., 0], cost)


def _add_own(
    equations: NormalEquations,
    at: Unknowns,
    by_corner: FloatArray,
    by_shared: FloatArray,
    by_pose: FloatArray,
    pull: FloatArray,
    weights: FloatArray,
) -> None:
    """Add what the pictures say of each corner's place on the board; it touches that corner alone."""
    own, others = at.blocks.corners, np.arange(at.blocks.scale.start, at.blocks.camera.stop)
    n_corners = at.blocks.n_corners
    weighted = (weights[..., None, None] * by_corner).transpose(0, 1, 3, 2)  # pose, corner, axis, pixel axis
    blocks = np.zeros((n_corners, 3, n_corners, 3))
    blocks[np.arange(n_corners), :, np.arange(n_corners)] = (weighted @ by_corner).sum(axis=0)
    equations.shared[own, own] = blocks.reshape(3 * n_corners, -1)
    crossed = (weighted @ by_shared).sum(axis=0).reshape(3 * n_corners, -1)
    equations.shared[own, others] = crossed
    equations.shared[others, own] = crossed.T
    equations.border[:, own] = (weighted @ by_pose).reshape(len(by_pose), 3 * n_corners, POSE_SIZE)
    equations.shared_gradient[own] = np.einsum("pqki,pqk->qi", by_corner, pull).ravel()
