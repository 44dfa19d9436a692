"""Pictures with the sound drawn over them: the steered-response map, the buzzer seen, and the place located."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.verification.pipeline import Verification

FloatArray = NDArray[np.float64]
Picture = NDArray[np.uint8]

# OpenCV's order: blue, green, red
SEEN, LOCATED, PLAIN, DARK = (255, 255, 255), (80, 255, 80), (230, 230, 230), (24, 24, 24)
GOOD, BAD = (120, 220, 120), (110, 110, 255)
HEAT_FROM = 0.5  # of the highest power: what is lower is left as the photo has it
LEVEL_RANGE_DB = -10 * float(np.log10(HEAT_FROM))
HEAT_OPACITY = 0.45  # the buzzer itself must be seen through it
PHOTO_BRIGHTNESS = 0.7
BASE_WIDTH_PX = 1280.0  # what sizes below are meant for
ZOOM, INSET_PX, INSET_RING_PX = 5, 220, 2
BAR_PX, BAR_LINES = 78, 3  # of words below the picture
LETTER_PX = 9.0  # of a line of words, each, on average
FONT = cv2.FONT_HERSHEY_SIMPLEX
SUBPIXEL_BITS = 4


@dataclass(frozen=True)
class _Ink:
    """Sizes for a picture of some width."""

    scale: float

    @property
    def line(self) -> int:
        return max(1, round(1.4 * self.scale))

    def text(self, picture: Picture, words: str, place: tuple[float, float], colour: tuple[int, int, int]) -> None:
        x, y = round(place[0]), round(place[1])
        offsets = [(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
        for (dx, dy), paint in [*((offset, DARK) for offset in offsets), ((0, 0), colour)]:
            cv2.putText(picture, words, (x + dx, y + dy), FONT, 0.5 * self.scale, paint, self.line, cv2.LINE_AA)


def overlay(photo: Picture, verification: Verification, emissions: NDArray[np.intp]) -> Picture:
    """Draw some emissions (n,) of one pose, numbered as in the verification, over its photo.

    Returns
    -------
    (height, width, 3) array of bytes, in OpenCV's order of colours. A single emission is shown magnified in a corner.
    """
    ink = _Ink(photo.shape[1] / BASE_WIDTH_PX)
    colour = photo if photo.ndim == 3 else cv2.cvtColor(photo, cv2.COLOR_GRAY2BGR)
    plain = np.asarray(cv2.convertScaleAbs(colour, alpha=PHOTO_BRIGHTNESS), dtype=np.uint8)
    picture = plain.copy()
    if verification.maps is not None:
        power = np.max([verification.maps[number].power for number in emissions], axis=0)
        picture = _with_heat(picture, power)
    for number in emissions:
        _mark(picture, verification, int(number), ink)
    if len(emissions) == 1:
        _inset(picture, plain, verification, int(emissions[0]), ink)
    return _with_bar(picture, verification, _caption(verification, emissions), ink)


def _with_heat(picture: Picture, power: Picture) -> Picture:
    size = (picture.shape[1], picture.shape[0])
    shares = np.asarray(cv2.resize(power.astype(np.float32) / 255, size, interpolation=cv2.INTER_CUBIC))
    share = np.clip(10 * np.log10(np.maximum(shares, HEAT_FROM)) / LEVEL_RANGE_DB + 1, 0.0, 1.0)
    opacity = (HEAT_OPACITY * np.sqrt(share))[..., None]
    return np.asarray((1 - opacity) * picture + opacity * _colours(share), dtype=np.uint8)


def _colours(share: FloatArray) -> Picture:
    """Return colours (height, width, 3) of a level, 0 at its lowest and 1 at its highest."""
    return np.asarray(cv2.applyColorMap((255 * (0.25 + 0.75 * share)).astype(np.uint8), cv2.COLORMAP_INFERNO))


def _mark(picture: Picture, verification: Verification, number: int, ink: _Ink) -> None:
    """Draw a ring where the buzzer was seen and a cross where it was located."""
    comparison = verification.comparison
    _ring(picture, comparison.seen_px[number], 13 * ink.scale, ink.line)
    if np.isfinite(comparison.located_px[number]).all():
        _cross(picture, comparison.located_px[number], 8 * ink.scale, ink.line)
    to_the_right = comparison.located_px[number, 0] > comparison.seen_px[number, 0]
    beside = comparison.seen_px[number] + ink.scale * np.array([-26.0 if to_the_right else 16.0, -10.0])
    ink.text(picture, str(verification.buzzer[number]), (beside[0], beside[1]), SEEN)


def _ring(picture: Picture, centre_px: FloatArray, radius_px: float, line: int) -> None:
    unit = 1 << SUBPIXEL_BITS
    centre = (round(float(centre_px[0]) * unit), round(float(centre_px[1]) * unit))
    for colour, width in ((DARK, line + 2), (SEEN, line)):
        cv2.circle(picture, centre, round(radius_px * unit), colour, width, cv2.LINE_AA, SUBPIXEL_BITS)


def _cross(picture: Picture, centre_px: FloatArray, arm_px: float, line: int) -> None:
    unit = 1 << SUBPIXEL_BITS
    for colour, width in ((DARK, line + 2), (LOCATED, line)):
        for arm in (np.array([arm_px, 0.0]), np.array([0.0, arm_px])):
            ends = [tuple(round(float(value) * unit) for value in centre_px + sign * arm) for sign in (-1, 1)]
            cv2.line(picture, ends[0], ends[1], colour, width, cv2.LINE_AA, SUBPIXEL_BITS)


def _inset(picture: Picture, plain: Picture, verification: Verification, number: int, ink: _Ink) -> None:
    """Magnify the surroundings of the buzzer seen into the corner that is farthest from it."""
    side = round(INSET_PX * ink.scale)
    seen, located = verification.comparison.seen_px[number], verification.comparison.located_px[number]
    height, width = picture.shape[:2]
    to_inset = np.array([[ZOOM, 0, side / 2 - ZOOM * seen[0]], [0, ZOOM, side / 2 - ZOOM * seen[1]]], dtype=float)
    inset = np.asarray(cv2.warpAffine(plain, to_inset, (side, side), flags=cv2.INTER_NEAREST), dtype=np.uint8)
    _ring(inset, np.array([side / 2, side / 2]), INSET_RING_PX * ZOOM, ink.line)
    if np.isfinite(located).all():
        _cross(inset, to_inset[:, :2] @ located + to_inset[:, 2], 12 * ink.scale, ink.line)
    ink.text(inset, f"x {ZOOM}, ring of {INSET_RING_PX} px", (8 * ink.scale, side - 10 * ink.scale), PLAIN)
    cv2.rectangle(inset, (0, 0), (side - 1, side - 1), PLAIN, ink.line)
    margin = round(12 * ink.scale)
    left = margin if seen[0] > width / 2 else width - side - margin
    top = margin if seen[1] > height / 2 else height - side - margin
    picture[top : top + side, left : left + side] = inset


def _caption(verification: Verification, emissions: NDArray[np.intp]) -> str:
    comparison, pose = verification.comparison, verification.pose[emissions[0]]
    errors_px = comparison.error_px[emissions]
    who = f"buzzer {verification.buzzer[emissions[0]]}" if len(emissions) == 1 else f"{len(emissions)} buzzers"
    if not np.isfinite(errors_px).any():
        return f"pose {pose}, {who}: not located"
    of = (errors_px, comparison.error_deg[emissions], 1e3 * comparison.error_m[emissions])
    error_px, error_deg, apart_mm = (float(np.nanmedian(values)) for values in of)
    median = "" if len(emissions) == 1 else "median "
    return f"pose {pose}, {who}: {median}{error_px:.2f} px, {error_deg:.3f} deg, {apart_mm:.2f} mm in space"


def _with_bar(picture: Picture, verification: Verification, caption: str, ink: _Ink) -> Picture:
    """Add lines of words below: what is shown and what the marks mean, of what, and the verdict."""
    height, width = bar_px(picture.shape[1]), picture.shape[1]
    bar = np.full((height, width, 3), DARK, dtype=np.uint8)
    lines = [(number + 0.68) * height / BAR_LINES for number in range(BAR_LINES)]
    left = 12 * ink.scale
    ink.text(bar, caption, (left, lines[0]), PLAIN)
    _legend(bar, lines[0], ink)
    of = f"session {verification.session_name}, calibration {verification.calibration.name}"
    ink.text(bar, _shortened(of, 0.7 * width / ink.scale), (left, lines[1]), PLAIN)
    if verification.maps is not None:
        _scale(bar, lines[1], ink)
    verdict = _shortened(_verdict(verification), width / ink.scale)
    ink.text(bar, verdict, (left, lines[2]), GOOD if verification.verdict.passed else BAD)
    return np.vstack([picture, bar])


def bar_px(width_px: int) -> int:
    """Return the height of the words below a picture of some width; even, as a film needs it."""
    return 2 * round(BAR_PX * width_px / BASE_WIDTH_PX / 2)


def _legend(bar: Picture, line: float, ink: _Ink) -> None:
    width, middle = bar.shape[1], line - 5 * ink.scale
    _ring(bar, np.array([width - 540 * ink.scale, middle]), 8 * ink.scale, ink.line)
    ink.text(bar, "computed: corners + rig description", (width - 526 * ink.scale, line), SEEN)
    _cross(bar, np.array([width - 190 * ink.scale, middle]), 7 * ink.scale, ink.line)
    ink.text(bar, "located by sound", (width - 174 * ink.scale, line), LOCATED)


def _scale(bar: Picture, line: float, ink: _Ink) -> None:
    """Draw what the map's colours mean, as opaque as they are there."""
    right, wide, high = bar.shape[1] - round(60 * ink.scale), round(120 * ink.scale), round(12 * ink.scale)
    top = round(line) - high
    levels = np.tile(np.linspace(0.0, 1.0, wide), (high, 1))
    bar[top : top + high, right - wide : right] = _colours(levels)
    ink.text(bar, f"map: -{LEVEL_RANGE_DB:.0f} dB", (right - wide - 106 * ink.scale, line), PLAIN)
    ink.text(bar, "0 dB", (right + 8 * ink.scale, line), PLAIN)


def _verdict(verification: Verification) -> str:
    """Say the verdict of the whole session in one line."""
    verdict, movement = verification.verdict, verification.movement
    if verdict.failures:
        return f"FAIL {verdict.failures[0]}"
    if movement.unseen(verdict.limits.moved_m):
        return "PASS for the sounds; whether the array has moved is not told"
    return f"PASS, and nothing has moved by more than {1e3 * verdict.limits.moved_m:g} mm"


def _shortened(words: str, room_px: float) -> str:
    """Cut words to what fits a line; OpenCV's letters are of ASCII alone."""
    words = words.encode("ascii", "replace").decode()
    most = int(room_px / LETTER_PX)
    return words if len(words) <= most else f"{words[: most - 3]}..."
