"""The blur of the board's edges, measured in pictures whose blur is known."""

import cv2
import numpy as np
import pytest
from simulated import make_description, open_rig

from acquire.sharpness import edge_blur_px
from rigs.board import charuco_board, estimate_pose, find_corners
from rigs.description import Intrinsics

BOARD = make_description().board
SQUARE_PX, FINE = 32, 8
PIXEL_PX = np.sqrt(1 / 12)  # a pixel's own blur


def board_picture(turn_deg: float = 7.0) -> np.ndarray:
    """Draw a board, each pixel the mean of its area."""
    columns, rows = BOARD.corners
    light = np.add.outer(np.arange(rows + 1), np.arange(columns + 1)) % 2 == 1
    face = np.pad(np.where(light, 215, 30).astype(np.uint8), 1, constant_values=215)
    fine = np.kron(face, np.ones((SQUARE_PX * FINE, SQUARE_PX * FINE), np.uint8))
    centre = (fine.shape[1] / 2, fine.shape[0] / 2)
    turned = cv2.warpAffine(fine, cv2.getRotationMatrix2D(centre, turn_deg, 0.9), fine.shape[::-1], borderValue=215)
    return cv2.resize(turned, None, fx=1 / FINE, fy=1 / FINE, interpolation=cv2.INTER_AREA)


def with_noise(picture: np.ndarray, noise: float) -> np.ndarray:
    drawn = np.random.default_rng(0).normal(0, noise, picture.shape)
    return np.clip(np.rint(picture + drawn), 0, 255).astype(np.uint8)


def blur_px(picture: np.ndarray) -> float:
    corners_px = find_corners(picture, BOARD)
    assert corners_px is not None
    return edge_blur_px(picture, corners_px, BOARD)


@pytest.mark.parametrize("noise", [0.0, 2.0, 8.0])
@pytest.mark.parametrize("sigma_px", [0.5, 1.0, 2.0, 3.0])
def test_blur_is_measured_in_pixels(sigma_px, noise):
    picture = with_noise(cv2.GaussianBlur(board_picture().astype(np.float32), (0, 0), sigma_px), noise)
    assert blur_px(picture) == pytest.approx(np.hypot(sigma_px, PIXEL_PX), rel=0.1, abs=0.05)


def test_light_and_contrast_do_not_count_as_blur():
    picture = board_picture()
    assert blur_px(picture // 4 + 60) == pytest.approx(blur_px(picture), abs=0.05)


def test_a_colour_picture_is_as_sharp_as_its_gray_one():
    picture = board_picture()
    assert blur_px(cv2.merge([picture] * 3)) == pytest.approx(blur_px(picture))


@pytest.mark.parametrize("turn_deg", [0.0, 90.0])
def test_movement_that_blurs_one_direction_only_is_not_averaged_away(turn_deg):
    picture = cv2.blur(board_picture(turn_deg), (9, 1))
    assert blur_px(picture) == pytest.approx(9 / np.sqrt(12), rel=0.15)


@pytest.mark.parametrize(
    "board",
    [{}, {"pattern": "charuco", "corners": (8, 5), "square_size_m": 0.03, "charuco": {"marker_size_m": 0.018}}],
)
def test_the_simulated_lens_is_as_sharp_as_it_is_made(board):
    image = open_rig(board=board).camera.read().image
    found = make_description(board=board).board
    corners_px = find_corners(image, found)
    assert corners_px is not None
    assert edge_blur_px(image, corners_px, found) == pytest.approx(np.hypot(0.7, PIXEL_PX), rel=0.12)


def test_hidden_corners_are_left_out_and_none_at_all_is_unknown():
    picture = board_picture()
    corners_px = find_corners(picture, BOARD)
    hidden_px = corners_px.copy()
    hidden_px[5:20] = np.nan
    assert edge_blur_px(picture, hidden_px, BOARD) == pytest.approx(blur_px(picture), abs=0.05)
    assert np.isnan(edge_blur_px(picture, np.full_like(corners_px, np.nan), BOARD))


def test_a_board_of_which_one_line_of_corners_is_seen_is_measured_in_that_direction_and_has_no_pose():
    picture = cv2.blur(board_picture(0.0), (9, 1))
    columns, rows = BOARD.corners
    grid = find_corners(picture, BOARD).reshape(rows, columns, 2)
    only = [np.full_like(grid, np.nan) for _ in range(2)]
    only[0][2], only[1][:, 3] = grid[2], grid[:, 3]
    row_px, column_px = (edge_blur_px(picture, each.reshape(-1, 2), BOARD) for each in only)
    assert row_px < 1.0
    assert column_px == pytest.approx(9 / np.sqrt(12), rel=0.15)
    camera = Intrinsics(focal_px=(800.0, 800.0), principal_px=(320.0, 240.0))
    assert [estimate_pose(each.reshape(-1, 2), BOARD, camera) for each in only] == [None, None]


@pytest.mark.parametrize(("n_rows", "n_seen"), [(2, None), (3, 16)])
def test_a_charuco_board_of_which_one_row_of_corners_is_seen_is_not_found(n_rows, n_seen):
    charuco = {"marker_size_m": 0.022}
    board = make_description(board={"pattern": "charuco", "corners": (8, 5), "charuco": charuco}).board
    picture = np.pad(charuco_board(board).generateImage((540, 360)), 40, constant_values=255)
    picture[40 + n_rows * 60 :] = 255
    corners_px = find_corners(picture, board)
    assert n_seen == (None if corners_px is None else np.isfinite(corners_px).all(axis=1).sum())
