"""The sharpness of the board: how blurred its edges are, whether by focus, movement or the lens."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import trapezoid

from rigs.description import Board

FloatArray = NDArray[np.float64]

_REACH_SHARE = 0.35  # of the shortest square, on either side of an edge
_N_ACROSS, _N_END = 41, 4
_ALONG = (-0.15, 0.0, 0.15)  # of a square, from the middle of an edge
_INTERPOLATION_PX2 = 1 / 6  # variance that reading between pixels adds
_MIN_CONTRAST = 10.0


def edge_blur_px(image: NDArray[np.uint8], corners_px: FloatArray, board: Board) -> float:
    """Measure the blur of the edges between the board's corners.

    Where a Gaussian of standard deviation sigma blurs a step, the light that it spills over the dark side is the step's
    height times sigma / sqrt(2 pi), and at the edge itself half of the height is reached. Only the dark side is looked
    at: light squares may hold markers. Rows and columns are taken apart, since movement blurs only what it crosses.

    Parameters
    ----------
    image : (height, width) or (height, width, 3) array of bytes
    corners_px : (n_corners, 2) array
        NaN where not seen.
    board : Board

    Returns
    -------
    Standard deviation in pixels, the sensor's own 0.3 included; median over the edges of the worse of the two
    directions. At most 0.2 of a square can be told. NaN where no edge is seen.
    """
    gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    grid = corners_px.reshape(board.corners[1], board.corners[0], 2)
    starts_ends = [(grid[:, :-1], grid[:, 1:]), (grid[:-1], grid[1:])]
    edges = [(start.reshape(-1, 2), end.reshape(-1, 2)) for start, end in starts_ends]
    lengths_px = np.concatenate([np.linalg.norm(end - start, axis=1) for start, end in edges])
    if np.isnan(lengths_px).all():
        return float("nan")
    reach_px = _REACH_SHARE * float(np.nanmin(lengths_px))
    blurs_px = [_median_blur_px(np.asarray(gray, np.float32), start, end, reach_px) for start, end in edges]
    return max((blur_px for blur_px in blurs_px if np.isfinite(blur_px)), default=float("nan"))


def _median_blur_px(gray: NDArray[np.float32], start_px: FloatArray, end_px: FloatArray, reach_px: float) -> float:
    seen = np.isfinite(start_px).all(axis=1) & np.isfinite(end_px).all(axis=1)
    if not seen.any():
        return float("nan")
    profiles = _profiles(gray, start_px[seen], end_px[seen], reach_px)
    middle = _N_ACROSS // 2
    falls = profiles[:, : middle + 1].mean(axis=1) > profiles[:, middle:].mean(axis=1)
    dark_side = np.where(falls[:, None], profiles[:, ::-1], profiles)[:, : middle + 1]
    dark = dark_side[:, :_N_END].mean(axis=1)
    height = 2 * (dark_side[:, -1] - dark)
    clear = height >= _MIN_CONTRAST
    if not clear.any():
        return float("nan")
    spilt_px = trapezoid(dark_side[clear] - dark[clear, None], dx=reach_px / middle, axis=1) / height[clear]
    sigma_px = float(np.sqrt(2 * np.pi) * np.median(spilt_px))
    return float(np.sqrt(max(sigma_px**2 - _INTERPOLATION_PX2, 0.0)))


def _profiles(gray: NDArray[np.float32], start_px: FloatArray, end_px: FloatArray, reach_px: float) -> FloatArray:
    """Return the brightness (n_edges, _N_ACROSS) on lines across the middle of each edge, a few for each."""
    along = end_px - start_px
    across = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
    middles = (start_px + end_px)[:, None] / 2 + np.array(_ALONG)[:, None] * along[:, None]
    offsets = np.linspace(-reach_px, reach_px, _N_ACROSS)
    points = middles[:, :, None] + offsets[:, None] * across[:, None, None]
    x, y = points.astype(np.float32).reshape(len(along), -1, 2).transpose(2, 0, 1)
    read = cv2.remap(gray, np.ascontiguousarray(x), np.ascontiguousarray(y), cv2.INTER_LINEAR)
    profiles = np.asarray(read, dtype=float).reshape(len(along), len(_ALONG), _N_ACROSS)
    return np.asarray(profiles.mean(axis=1))
