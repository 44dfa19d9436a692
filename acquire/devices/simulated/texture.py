"""The board's face: squares, markers, buzzers and the white plate around, drawn flat."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from rigs.board import charuco_board
from rigs.description import Board
from rigs.errors import DescriptionError

TEXELS_PER_SQUARE = 64
_DARK, _WHITE, _BUZZER = 30, 215, 45  # of 255
_BUZZER_RADIUS_M = 0.008


def plate_squares(board: Board) -> tuple[int, int, int, int]:
    """Return the plate's left, top, right and bottom edge in squares from the first inner corner."""
    places = np.array([buzzer.position_m[:2] for buzzer in board.buzzers])
    reach_m = _BUZZER_RADIUS_M + 0.1 * board.square_size_m
    low = np.floor((places.min(axis=0) - reach_m) / board.square_size_m).astype(int)
    high = np.ceil((places.max(axis=0) + reach_m) / board.square_size_m).astype(int)
    left, top = np.minimum(low, -2)
    right, bottom = np.maximum(high, np.array(board.corners) + 1)
    return int(left), int(top), int(right), int(bottom)


def plate_corners_m(board: Board) -> NDArray[np.float64]:
    """Return the corners of the plate (4, 3) in the board frame, going round."""
    left, top, right, bottom = plate_squares(board)
    corners = [[left, top, 0], [right, top, 0], [right, bottom, 0], [left, bottom, 0]]
    return np.array(corners) * board.square_size_m


def board_texture(board: Board) -> NDArray[np.uint8]:
    """Draw the plate (height, width), TEXELS_PER_SQUARE to a square; its corner is that of `plate_squares`.

    Raises
    ------
    DescriptionError
        The ChArUco dictionary is too small for the board.
    """
    left, top, right, bottom = plate_squares(board)
    face = np.full(((bottom - top) * TEXELS_PER_SQUARE, (right - left) * TEXELS_PER_SQUARE), _WHITE, np.uint8)
    _draw_buzzers(face, board)
    pattern = _charuco(board) if board.pattern == "charuco" else _checkerboard(board)
    y, x = (-top - 1) * TEXELS_PER_SQUARE, (-left - 1) * TEXELS_PER_SQUARE
    face[y : y + pattern.shape[0], x : x + pattern.shape[1]] = pattern
    return face


def _checkerboard(board: Board) -> NDArray[np.uint8]:
    columns, rows = board.corners
    light = np.add.outer(np.arange(rows + 1), np.arange(columns + 1)) % 2 == 1  # the outermost square is dark
    squares = np.where(light, _WHITE, _DARK).astype(np.uint8)
    return np.kron(squares, np.ones((TEXELS_PER_SQUARE, TEXELS_PER_SQUARE), np.uint8))


def _charuco(board: Board) -> NDArray[np.uint8]:
    columns, rows = board.corners
    size = ((columns + 1) * TEXELS_PER_SQUARE, (rows + 1) * TEXELS_PER_SQUARE)
    try:
        drawn = np.asarray(charuco_board(board).generateImage(size, marginSize=0))
    except cv2.error as error:
        raise DescriptionError(
            "board.charuco.dictionary: too few markers for so many squares; take a larger one, such as DICT_5X5_1000"
        ) from error
    return np.where(drawn > 127, _WHITE, _DARK).astype(np.uint8)


def _draw_buzzers(face: NDArray[np.uint8], board: Board) -> None:
    left, top, _, _ = plate_squares(board)
    texels_per_m = TEXELS_PER_SQUARE / board.square_size_m
    for buzzer in board.buzzers:
        x, y = np.array(buzzer.position_m[:2]) * texels_per_m - np.array([left, top]) * TEXELS_PER_SQUARE
        cv2.circle(face, (round(x), round(y)), round(_BUZZER_RADIUS_M * texels_per_m), float(_BUZZER), cv2.FILLED)
