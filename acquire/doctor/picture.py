"""The picture: its size, the board in it, its light and its focus."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.devices.base import Camera, Clock
from acquire.doctor.row import Part, Row, State
from acquire.sharpness import edge_blur_px
from rigs.board import board_corners_m, estimate_pose, find_corners, movement_px
from rigs.description import Intrinsics, RigDescription
from rigs.geometry import Pose

FloatArray = NDArray[np.float64]
_LOOK_S = 3.0
_GUESSED_FOCAL = 0.85  # of the picture's width: a view of 61 degrees; webcams have 55 to 75
_SMALL_SQUARE_PX, _FAR_TILT_DEG = 9.0, 50.0
_BLACK, _SATURATED = 3, 252  # of 255
_SATURATED_SHARE = (0.01, 0.10)  # look, bad
_BLACK_SHARE = (0.10, 0.35)
_CONTRAST = (60.0, 25.0)
_BLUR_OF_SQUARE, _SOFT = 0.16, 0.7  # blurrier edges run into one another; of what is bad


@dataclass(frozen=True)
class View:
    """What the camera saw.

    Parameters
    ----------
    gray : (height, width) array of bytes
    corners_px : (n_corners, 2) array or None
        None where the board was not found.
    moved_px : float
        How far the board moved between the last two pictures.
    """

    gray: NDArray[np.uint8]
    corners_px: FloatArray | None
    moved_px: float


def look(camera: Camera, clock: Clock, description: RigDescription) -> View:
    """Take pictures until the board is found and stands still, but not for long. Raises DeviceError."""
    end_s, before_px, moved_px = clock.now_s() + _LOOK_S, None, float("inf")
    while True:
        image = camera.read().image
        corners_px = find_corners(image, description.board)
        if corners_px is not None and before_px is not None:
            moved_px = movement_px(corners_px, before_px)
        before_px = corners_px
        if clock.now_s() > end_s or moved_px < description.capture.still_px:
            gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
            return View(np.asarray(gray, dtype=np.uint8), corners_px, moved_px)


def board_pose(view: View, description: RigDescription) -> tuple[Pose | None, bool]:
    """Return `board_to_camera`, None where it is not found, and whether the intrinsics it rests on are a guess."""
    known = description.camera.intrinsics
    guessed = not isinstance(known, Intrinsics)
    if view.corners_px is None:
        return None, guessed
    return estimate_pose(view.corners_px, description.board, _guess(view) if guessed else known), guessed  # type: ignore[arg-type]


def judge_picture(view: View, description: RigDescription) -> Iterator[Row]:
    """Say how the picture is."""
    yield _size(view, description)
    yield _board(view, description)
    if view.corners_px is not None:
        yield _exposure(view, description, view.corners_px)
        yield _focus(view, description, view.corners_px)


def _guess(view: View) -> Intrinsics:
    height, width = view.gray.shape
    focal_px = _GUESSED_FOCAL * width
    return Intrinsics(focal_px=(focal_px, focal_px), principal_px=((width - 1) / 2, (height - 1) / 2))


def _size(view: View, description: RigDescription) -> Row:
    height, width = view.gray.shape
    wanted = description.camera.size_px
    figures = {"width_px": width, "height_px": height}
    finding = f"{width} x {height} pixels"
    if (width, height) == wanted:
        return Row(Part.PICTURE, "size", State.OK, finding, figures=figures)
    remedy = f"camera.size_px wants {wanted[0]} x {wanted[1]}: choose a size that the camera has"
    return Row(Part.PICTURE, "size", State.BAD, finding, remedy, figures)


def _board(view: View, description: RigDescription) -> Row:
    if view.corners_px is None:
        return Row(
            Part.PICTURE,
            "board",
            State.BAD,
            "not found in the picture",
            "bring the whole board into the picture, evenly lit, without glare and sharp; check board.corners",
        )
    n_seen, n_corners = int(np.isfinite(view.corners_px).all(axis=1).sum()), len(view.corners_px)
    square_px = _square_px(view.corners_px, description.board.corners)
    place, figures = _place(view, description)
    figures |= {"corners": n_seen, "square_px": square_px, "moved_px": view.moved_px}
    finding = f"{n_seen} of {n_corners} corners{place}, a square is {square_px:.0f} px"
    doubts = [
        (square_px < _SMALL_SQUARE_PX, "its squares are small in the picture", "bring it nearer"),
        (figures.get("tilt_deg", 0) > _FAR_TILT_DEG, "it is tilted far", "turn it towards the camera"),
        (not view.moved_px < description.capture.still_px, f"it moves ({view.moved_px:.1f} px)", "put it on a stand"),
    ]
    found = [(doubt, remedy) for applies, doubt, remedy in doubts if applies]
    finding = ", but ".join([finding, *(doubt for doubt, _ in found)])
    state = State.LOOK if found else State.OK
    return Row(Part.PICTURE, "board", state, finding, "; ".join(remedy for _, remedy in found), figures)


def _place(view: View, description: RigDescription) -> tuple[str, dict[str, float]]:
    """Say where the board is, as far as that can be told."""
    pose, guessed = board_pose(view, description)
    if pose is None:
        return "", {}
    middle_m = pose.apply(board_corners_m(description.board).mean(axis=0))
    distance_m = float(np.linalg.norm(middle_m))
    tilt_deg = float(np.degrees(np.arccos(np.clip(pose.rotation[2, 2], -1, 1))))
    about = "about " if guessed else ""
    text = f", {about}{distance_m:.2f} m away, tilted by {about}{tilt_deg:.0f} degrees"
    return text, {"distance_m": distance_m, "tilt_deg": tilt_deg, "focal_length_is_guessed": float(guessed)}


def _exposure(view: View, description: RigDescription, corners_px: FloatArray) -> Row:
    pixels = view.gray[_board_area(view.gray, corners_px)]
    dark, light = (float(value) for value in np.percentile(pixels, (10, 90)))
    black, saturated = float(np.mean(pixels <= _BLACK)), float(np.mean(pixels >= _SATURATED))
    figures = {"black_share": black, "saturated_share": saturated, "dark": dark, "light": light}
    finding = f"{black:.0%} black, {saturated:.0%} saturated, squares of brightness {dark:.0f} and {light:.0f} of 255"
    if saturated > _SATURATED_SHARE[0]:
        state = State.BAD if saturated > _SATURATED_SHARE[1] else State.LOOK
        return Row(Part.PICTURE, "exposure", state, finding, "less light, or a shorter exposure; mind glare", figures)
    if black > _BLACK_SHARE[0] or light - dark < _CONTRAST[0]:
        very = black > _BLACK_SHARE[1] or light - dark < _CONTRAST[1]
        state = State.BAD if very else State.LOOK
        return Row(Part.PICTURE, "exposure", state, finding, "more light, or a longer exposure", figures)
    return Row(Part.PICTURE, "exposure", State.OK, finding, figures=figures)


def _focus(view: View, description: RigDescription, corners_px: FloatArray) -> Row:
    blur_px, limit_px = edge_blur_px(view.gray, corners_px, description.board), description.capture.max_blur_px
    figures = {"blur_px": blur_px, "max_blur_px": limit_px}
    finding = f"the board's edges are blurred by {blur_px:.1f} px (standard deviation), capture takes {limit_px:g}"
    most_px = min(limit_px, _BLUR_OF_SQUARE * _square_px(corners_px, description.board.corners))
    if blur_px <= _SOFT * most_px:
        return Row(Part.PICTURE, "focus", State.OK, finding, figures=figures)
    remedy = "set the focus on the board, then lock it; hold the board still"
    return Row(Part.PICTURE, "focus", State.BAD if blur_px > most_px else State.LOOK, finding, remedy, figures)


def _square_px(corners_px: FloatArray, corners: tuple[int, int]) -> float:
    grid = corners_px.reshape(corners[1], corners[0], 2)
    return float(min(np.nanmedian(np.linalg.norm(np.diff(grid, axis=axis), axis=2)) for axis in (0, 1)))


def _board_area(gray: NDArray[np.uint8], corners_px: FloatArray) -> NDArray[np.bool_]:
    """Return which pixels (height, width) lie within the outline of the corners."""
    seen = corners_px[np.isfinite(corners_px).all(axis=1)].astype(np.float32)
    mask = np.zeros(gray.shape, np.uint8)
    cv2.fillConvexPoly(mask, np.rint(cv2.convexHull(seen)).astype(np.int32), 1)
    return mask.astype(bool)
