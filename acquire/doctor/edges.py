"""The edges between the board's squares: how wide they are in the picture, which tells focus and smear."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
_REACH = 0.35  # of a square, to either side of an edge
_ALONG = np.linspace(0.35, 0.65, 7)  # places on an edge, clear of its corners
_N_STEPS = 81
_LOW, _HIGH = 0.1, 0.9


def edge_widths_px(gray: NDArray[np.uint8], corners_px: FloatArray, corners: tuple[int, int]) -> tuple[float, float]:
    """Measure how wide (10 to 90 % of the step in brightness) the edges between squares are.

    Parameters
    ----------
    gray : (height, width) array of bytes
    corners_px : (n_corners, 2) array
        NaN where not seen.
    corners : (columns, rows)

    Returns
    -------
    along_rows_px, along_columns_px : float
        Medians over the edges that run along the rows, and along the columns; NaN where none is seen.
    """
    grid = corners_px.reshape(corners[1], corners[0], 2)
    along_rows = _width_px(gray, grid[:, :-1].reshape(-1, 2), grid[:, 1:].reshape(-1, 2))
    along_columns = _width_px(gray, grid[:-1].reshape(-1, 2), grid[1:].reshape(-1, 2))
    return along_rows, along_columns


def _width_px(gray: NDArray[np.uint8], start_px: FloatArray, end_px: FloatArray) -> float:
    """Return the median width of edges that run from `start_px` to `end_px`, both (n_edges, 2)."""
    seen = np.isfinite(start_px + end_px).all(axis=1)
    if not seen.any():
        return float("nan")
    start_px, way_px = start_px[seen], (end_px - start_px)[seen]
    across_px = _REACH * way_px @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    offset = np.linspace(-1, 1, _N_STEPS)
    places = (start_px[:, None] + _ALONG[:, None] * way_px[:, None])[:, :, None] + offset[:, None] * across_px[
        :, None, None
    ]
    maps = places.reshape(len(start_px), -1, 2).astype(np.float32)
    brightness = cv2.remap(gray.astype(np.float32), maps[..., 0], maps[..., 1], cv2.INTER_LINEAR)
    profiles = brightness.reshape(len(start_px), len(_ALONG), _N_STEPS).mean(axis=1)
    step_px = np.linalg.norm(across_px, axis=1) * (offset[1] - offset[0])
    return float(np.median(_rise_steps(profiles) * step_px))


def _rise_steps(profiles: FloatArray) -> FloatArray:
    """Return over how many steps each profile (n, n_steps) goes from 10 to 90 % of the way between its two ends."""
    ends = profiles.shape[1] // 6
    low, high = profiles[:, :ends].mean(axis=1, keepdims=True), profiles[:, -ends:].mean(axis=1, keepdims=True)
    share = (profiles - low) / np.where(high == low, 1.0, high - low)
    return np.array([_first_above(each, _HIGH) - _first_above(each, _LOW) for each in share])


def _first_above(share: FloatArray, level: float) -> float:
    """Return where a profile first reaches a level, between the steps."""
    k = int(np.argmax(share >= level))
    if k == 0:
        return 0.0 if share[0] >= level else float(len(share))
    return float(k - 1 + (level - share[k - 1]) / (share[k] - share[k - 1]))
