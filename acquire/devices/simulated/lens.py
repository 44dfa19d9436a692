"""The camera's lens: where points of the camera frame come out in the picture, and which ray each pixel looks along."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from rigs.description import Intrinsics

FloatArray = NDArray[np.float64]
_GRID_PX = 16  # rays are found on this grid and interpolated: the lens is smooth


def picture_points_px(points_m: FloatArray, intrinsics: Intrinsics) -> FloatArray:
    """Return the pixels (n, 2) of points (n, 3) of the camera frame; pixel centres have whole numbers."""
    x, y = _distorted(points_m[:, 0] / points_m[:, 2], points_m[:, 1] / points_m[:, 2], intrinsics.distortion)
    return np.asarray(np.column_stack([x, y]) * intrinsics.focal_px + np.array(intrinsics.principal_px))


def pixel_rays(size_px: tuple[int, int], intrinsics: Intrinsics) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return x / z and y / z (height, width) of the ray that each pixel of a picture (width, height) looks along."""
    width, height = size_px
    columns = np.arange(-_GRID_PX, width + 2 * _GRID_PX, _GRID_PX, dtype=float)
    rows = np.arange(-_GRID_PX, height + 2 * _GRID_PX, _GRID_PX, dtype=float)
    x_seen = (columns[None, :] - intrinsics.principal_px[0]) / intrinsics.focal_px[0]
    y_seen = (rows[:, None] - intrinsics.principal_px[1]) / intrinsics.focal_px[1]
    coarse = _undistorted(np.stack(np.broadcast_arrays(x_seen, y_seen)), intrinsics.distortion)
    x, y = (RectBivariateSpline(rows, columns, grid)(np.arange(height), np.arange(width)) for grid in coarse)
    return x.astype(np.float32), y.astype(np.float32)


def _distorted(x: FloatArray, y: FloatArray, distortion: tuple[float, ...]) -> tuple[FloatArray, FloatArray]:
    """Bend rays as D. Brown has it (Photogrammetric Engineering 37 (1971) 855)."""
    k1, k2, p1, p2, k3 = distortion
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


def _undistorted(seen: FloatArray, distortion: tuple[float, ...]) -> FloatArray:
    """Straighten rays (2, ...) by fixed-point iteration."""
    ray = seen.copy()
    for _ in range(40):
        ray += seen - np.stack(_distorted(ray[0], ray[1], distortion))
    return ray
