"""The picture that the camera's lens throws on its sensor, before the sensor's noise."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.devices.simulated.draws import draws
from acquire.devices.simulated.lens import picture_points_px, pixel_rays
from acquire.devices.simulated.scene import Scene
from acquire.devices.simulated.texture import TEXELS_PER_SQUARE, board_texture, plate_corners_m, plate_squares
from rigs.geometry import Pose

Picture = NDArray[np.float32]
_BLUR_PX = 0.7
_MOTION_BLUR_PX = 1.5
_PAD_PX = 4


class Painter:
    """Paints the scene's board into the picture by casting rays, several to a pixel."""

    def __init__(self, scene: Scene) -> None:
        self._board = scene.board
        self._intrinsics = scene.intrinsics
        self._size_px = scene.description.camera.size_px
        self._rays = pixel_rays(self._size_px, scene.intrinsics)
        self._texture = _with_cover(board_texture(self._board))
        self._light = _uneven_light(self._size_px, scene.seed)
        self._background = _background(self._size_px, scene.seed) * self._light

    def picture(self, board_to_camera: Pose, *, moving: bool) -> Picture:
        """Paint the board where it is, (height, width), 255 = full scale; coarser and more blurred while it moves."""
        picture = self._background.copy()
        box = self._bounding_box(board_to_camera)
        if box is not None:
            board, cover = self._painted_board(board_to_camera, box, rays_per_side=2 if moving else 8)
            shade = 0.8 + 0.2 * float(board_to_camera.rotation[2, 2])
            picture[box] = picture[box] * (1 - cover) + shade * board * self._light[box]
        return np.asarray(cv2.GaussianBlur(picture, (0, 0), _MOTION_BLUR_PX if moving else _BLUR_PX))

    def _bounding_box(self, board_to_camera: Pose) -> tuple[slice, slice] | None:
        """Return the rows and columns that the plate may touch, None where it is out of view."""
        edge = np.linspace(0, 1, 20)[:, None]
        corners_m = plate_corners_m(self._board)
        sides_m = corners_m[:, None] + edge * (np.roll(corners_m, -1, axis=0) - corners_m)[:, None]
        outline_m = board_to_camera.apply(sides_m.reshape(-1, 3))
        if outline_m[:, 2].min() < 0.05:
            return None
        pixels = picture_points_px(outline_m, self._intrinsics)
        low = np.clip(pixels.min(axis=0) - _PAD_PX, 0, self._size_px).astype(int)
        high = np.clip(pixels.max(axis=0) + _PAD_PX, 0, self._size_px).astype(int)
        return (slice(low[1], high[1]), slice(low[0], high[0])) if (high - low).min() > 1 else None

    def _painted_board(
        self, board_to_camera: Pose, box: tuple[slice, slice], rays_per_side: int
    ) -> tuple[Picture, Picture]:
        """Return brightness (where covered) and cover of each pixel in the box, means over rays through it.

        Within a pixel the board's coordinates are taken as linear; what is left out is under 0.001 pixel.
        """
        x, y = self._board_texels(board_to_camera, box)
        (x_down, x_right), (y_down, y_right) = np.gradient(x), np.gradient(y)
        total = np.zeros((*x.shape, 2), np.float32)
        offsets = (np.arange(rays_per_side, dtype=np.float32) + 0.5) / rays_per_side - 0.5
        for down in offsets:
            for right in offsets:
                x_ray, y_ray = x + down * x_down + right * x_right, y + down * y_down + right * y_right
                cv2.accumulate(cv2.remap(self._texture, x_ray, y_ray, cv2.INTER_NEAREST), total)
        total /= np.float32(rays_per_side**2)
        return total[..., 0], np.asarray(total[..., 1] / 255, dtype=np.float32)

    def _board_texels(self, board_to_camera: Pose, box: tuple[slice, slice]) -> tuple[Picture, Picture]:
        """Return the texture's column and row (texel centres have whole numbers) that each pixel's ray meets."""
        left, top, _, _ = plate_squares(self._board)
        texel_m = self._board.square_size_m / TEXELS_PER_SQUARE
        corner = np.array([left, top]) * TEXELS_PER_SQUARE + 0.5
        texel_to_board = np.array([[texel_m, 0, corner[0] * texel_m], [0, texel_m, corner[1] * texel_m], [0, 0, 1.0]])
        plane = np.column_stack([board_to_camera.rotation[:, :2], board_to_camera.translation_m])
        to_texel = np.linalg.inv(plane @ texel_to_board).astype(np.float32)
        x, y = self._rays[0][box], self._rays[1][box]
        column, row, depth = (line[0] * x + line[1] * y + line[2] for line in to_texel)
        return column / depth, row / depth


def _with_cover(texture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Add the cover, 255 on the plate; beyond its border both are 0."""
    return np.dstack([texture, np.full_like(texture, 255)])


def _uneven_light(size_px: tuple[int, int], seed: int) -> Picture:
    """Return the light (height, width), 0.7 to 1: a gradient, and darker corners."""
    width, height = size_px
    direction = draws(seed, "light").uniform(0, 2 * np.pi)
    x, y = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
    slope = 0.1 * (np.cos(direction) * x + np.sin(direction) * y)
    return np.asarray(0.9 + slope - 0.05 * (x**2 + y**2), dtype=np.float32)


def _background(size_px: tuple[int, int], seed: int) -> Picture:
    """Return a wall (height, width) with large and small stains."""
    rng, picture = draws(seed, "background"), np.full(size_px[::-1], 105.0, np.float32)
    for cell_px, contrast in ((160, 18.0), (24, 5.0)):
        shape = (size_px[1] // cell_px + 2, size_px[0] // cell_px + 2)
        stains = contrast * rng.standard_normal(shape, dtype=np.float32)
        picture += np.asarray(cv2.resize(stains, size_px, interpolation=cv2.INTER_CUBIC))
    return picture
