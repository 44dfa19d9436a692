"""Draw the bench guide's figures from the shipped rig description: `make figures`.

`board-a3.svg` is the board itself, to be printed at 100 %; the others explain.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from svg import BLUE, GRAY, GREEN, INK, PALE, SOUND, Drawing

from rigs.description import Board
from rigs.library import find_description

FOLDER = Path(__file__).parent
A3_MM = (420.0, 297.0)


def main() -> None:
    """Draw everything."""
    board = find_description("bench8").description.board
    for name, draw in {"board": draw_board, "scale": draw_scale}.items():
        draw(board).save(FOLDER / f"bench-{name}.svg")
    for name, picture in {"wiring": draw_wiring(), "room": draw_room(), "poses": draw_poses()}.items():
        picture.save(FOLDER / f"bench-{name}.svg")
    draw_print(board).save(FOLDER / "board-a3.svg")


def squares(sheet: Drawing, board: Board, x: float, y: float, scale: float) -> None:
    """Draw the checkerboard, its first inner corner at (x, y); the outermost square beside that corner is dark."""
    side = 1e3 * board.square_size_m * scale
    columns, rows = board.corners
    for row in range(rows + 1):
        for column in range(columns + 1):
            if (row + column) % 2 == 0:
                sheet.rect(
                    x + (column - 1) * side, y + (row - 1) * side, side, side, fill="#000000", ink="none", line=0
                )


def buzzers_mm(board: Board) -> list[tuple[int, float, float]]:
    return [(one.id, 1e3 * one.position_m[0], 1e3 * one.position_m[1]) for one in board.buzzers]


def draw_print(board: Board) -> Drawing:
    """Return the board in its own size on A3, with crosses for the buzzers and a rule to check the print by."""
    sheet = Drawing(*A3_MM, "Board for printing at 100 %")
    x, y = 110.0, 86.0
    squares(sheet, board, x, y, 1.0)
    for number, right, down in buzzers_mm(board):
        for dx, dy in ((4, 0), (0, 4)):
            sheet.line(x + right - dx, y + down - dy, x + right + dx, y + down + dy, GRAY, 0.2)
        sheet.circle(x + right, y + down, 6, ink=GRAY, line=0.2)
        sheet.text(x + right + 7.5, y + down + 1.4, f"buzzer {number}", 4, GRAY)
    left, level = 60.0, 285.0
    for tick in range(0, 301, 10):
        sheet.line(left + tick, level, left + tick, level - (5 if tick % 50 == 0 else 3), GRAY, 0.2)
    sheet.line(left, level, left + 300, level, GRAY, 0.2)
    sheet.text(left + 304, level, "300 mm", 4, GRAY)
    size_mm = 1e3 * board.square_size_m
    sheet.text(
        left,
        20,
        f"Print at 100 % (not: fit to page). Squares of {size_mm:g} mm; measure eight of them both ways.",
        4,
        GRAY,
    )
    return sheet


def draw_board(board: Board) -> Drawing:
    """Return the board with its frame, its buzzers and their measures."""
    sheet, scale = Drawing(190, 122, "The board: frame, corners and buzzers"), 0.36
    x, y = 50.0, 34.0
    sheet.rect(x - 28, y - 24, 128, 96, fill="#f8fafc")
    squares(sheet, board, x, y, scale)
    for number, right, down in buzzers_mm(board):
        sheet.circle(x + scale * right, y + scale * down, 3.2, fill="#ffffff", ink=SOUND, line=0.8)
        sheet.text(x + scale * right, y + scale * down + 1.4, str(number), 4, SOUND, "middle", bold=True)
    sheet.circle(x, y, 1.6, ink=GREEN, line=0.8)
    sheet.arrow(x, y, x + 27, y, GREEN, 0.8)
    sheet.arrow(x, y, x, y + 27, GREEN, 0.8)
    sheet.text(x + 28, y + 1.4, "x", 5, GREEN, bold=True)
    sheet.text(x - 1.5, y + 32, "y", 5, GREEN, bold=True)
    first = buzzers_mm(board)[2]
    sheet.size(x, y - 27, x + scale * first[1], y - 27, f"buzzer 3: x = {first[1]:g} mm")
    sheet.line(x, y - 29, x, y - 1.6, GRAY, 0.2, "1 1")
    sheet.line(x + scale * first[1], y - 29, x + scale * first[1], y - 20, GRAY, 0.2, "1 1")
    sheet.size(x + 104, y, x + 104, y + scale * buzzers_mm(board)[5][2], "buzzer 6:")
    sheet.text(x + 105.8, y + 36.5, f"y = {buzzers_mm(board)[5][2]:g} mm", 3.6, GRAY)
    sheet.text(22, 112, "Origin: the first inner corner, beside the dark corner square of the print.", 4, GREEN)
    sheet.text(22, 118, "z points away from the camera: what stands out of the print towards it has z < 0.", 4, GREEN)
    return sheet


def draw_scale(board: Board) -> Drawing:
    """Return how the print's scale is measured."""
    sheet, side = Drawing(190, 92, "Measuring the print"), 13.0
    x, y, n = 30.0, 30.0, 8
    size_mm = 1e3 * board.square_size_m
    for row in range(3):
        for column in range(n + 1):
            if (row + column) % 2 == 0:
                sheet.rect(x + column * side, y + row * side, side, side, fill="#000000", ink="none", line=0)
    for edge in (x, x + n * side):
        sheet.line(edge, y - 14, edge, y + 3 * side, SOUND, 0.5, "2 1")
    sheet.size(
        x,
        y - 9,
        x + n * side,
        y - 9,
        f"8 squares: {8 * size_mm:g} mm wanted, say {8 * size_mm + 0.8:.1f} mm measured",
        SOUND,
    )
    sheet.text(
        x,
        y + 3 * side + 9,
        f"square_size_m: {(8 * size_mm + 0.8) / 8e3:.5f}        # {8 * size_mm + 0.8:.1f} mm / 8",
        4.4,
    )
    sheet.text(x, y + 3 * side + 15, "square_size_std_m: 0.00001     # read to 0.1 mm, over eight squares", 4.4)
    sheet.text(x + n * side + 18, y + 8, "from edge to edge,", 4, GRAY)
    sheet.text(x + n * side + 18, y + 13.5, "both ways, at both", 4, GRAY)
    sheet.text(x + n * side + 18, y + 19, "ends of the board", 4, GRAY)
    return sheet


def draw_wiring() -> Drawing:
    """Return the wiring of Arduino, buzzers, microphones and computer."""
    sheet = Drawing(190, 118, "Wiring")
    box(sheet, 66, 12, 46, 70, "", "")
    sheet.text(97, 45, "Arduino", 4.4, INK, "middle", bold=True)
    sheet.text(97, 50, "Uno, Nano, Mega", 3.2, GRAY, "middle")
    for number in range(6):
        level = 20 + 9 * number
        sheet.text(68, level + 1.3, f"pin {number + 2}", 3.4, GRAY)
        sheet.line(66, level, 50, level)
        sheet.rect(41, level - 1.6, 9, 3.2, fill="#ffffff")
        sheet.line(41, level, 30, level)
        sheet.circle(26, level, 4, fill="#ffffff", ink=SOUND, line=0.7)
        sheet.text(26, level + 1.4, str(number + 1), 4, SOUND, "middle", bold=True)
        sheet.line(22, level, 16, level)
    sheet.line(16, 20, 16, 78)
    sheet.line(16, 78, 66, 78)
    sheet.text(68, 79.3, "GND", 3.4, GRAY)
    sheet.text(45.5, 15.5, "100-220 ohm", 3.2, GRAY, "middle")
    sheet.text(18, 88, "six passive piezo buzzers", 3.8, SOUND)
    box(sheet, 142, 12, 36, 24, "computer", "rig-capture")
    box(sheet, 142, 50, 36, 24, "sound device", "one clock, 8 inputs")
    box(sheet, 142, 88, 36, 20, "camera", "locked exposure")
    sheet.line(112, 24, 142, 24, BLUE, 0.7)
    sheet.text(127, 22, "USB, data", 3.4, BLUE, "middle")
    sheet.line(160, 36, 160, 50, BLUE, 0.7)
    sheet.line(178, 98, 185, 98, BLUE, 0.7)
    sheet.line(185, 98, 185, 24, BLUE, 0.7)
    sheet.line(185, 24, 178, 24, BLUE, 0.7)
    for number in range(8):
        level = 52 + 2.9 * number
        sheet.line(128, level, 142, level, GREEN, 0.4)
        sheet.circle(126.6, level, 1.2, fill="#ffffff", ink=GREEN)
    sheet.text(130, 47, "8 microphones", 3.8, GREEN, "middle")
    sheet.line(112, 78, 134, 78, GRAY, 0.4, "1.5 1")
    sheet.line(134, 78, 142, 73, GRAY, 0.4, "1.5 1")
    sheet.text(112, 84, "pin 8: sync, may be left out", 3.4, GRAY)
    return sheet


def box(sheet: Drawing, x: float, y: float, width: float, height: float, name: str, below: str) -> None:
    sheet.rect(x, y, width, height, fill="#f8fafc", line=0.6)
    sheet.text(x + width / 2, y + height / 2, name, 4.4, INK, "middle", bold=True)
    sheet.text(x + width / 2, y + height / 2 + 5, below, 3.2, GRAY, "middle")


def draw_room() -> Drawing:
    """Return the room from above: where the array stands, and where the board goes."""
    sheet = Drawing(190, 124, "The room from above")
    sheet.rect(12, 10, 166, 92, fill="#f8fafc", line=1.2)
    x, y = 52.0, 62.0
    sheet.polygon([(x, y), (x + 104, y - 46), (x + 104, y + 32)], fill="#fef3c7", ink="none", line=0)
    for distance in (40, 70, 100):
        angles = np.linspace(-0.36, 0.28, 30)
        points = [(x + distance * np.cos(angle), y + distance * np.sin(angle)) for angle in angles]
        for (x1, y1), (x2, y2) in pairwise(points):
            sheet.line(x1, y1, x2, y2, GRAY, 0.25, "1 1")
        sheet.text(x + distance - 2, y + 37, f"{distance / 100:g} m", 3.6, GRAY, "end")
    for along, across, turn in (
        (40, -8, 20),
        (42, 8, -25),
        (68, -18, -15),
        (70, 2, 30),
        (66, 15, 8),
        (98, -26, 25),
        (99, 4, -30),
        (96, 20, 15),
    ):
        sheet.rect(x + along - 0.8, y + across - 6, 1.6, 12, fill=SOUND, ink="none", line=0, turn_deg=turn)
    sheet.rect(x - 5, y - 3, 6, 6, fill=INK)
    for dx, dy in ((-14, -16), (-14, 16), (8, -18), (8, 18)):
        sheet.circle(x + dx - 3, y + dy, 2, fill="#ffffff", ink=GREEN, line=0.8)
        sheet.line(x - 3, y, x + dx - 3, y + dy, GREEN, 0.3)
    sheet.text(x - 3, y + 29, "camera and microphones", 3.8, GREEN, "middle")
    sheet.text(x - 3, y + 33.5, "on one stiff frame", 3.8, GREEN, "middle")
    sheet.text(x + 52, 18, "board positions: 0.4 to 1 m away, all over the picture", 3.8, SOUND, "middle")
    sheet.size(12, y + 22, x - 17, y + 22, "1 m or more")
    sheet.text(
        12, 109, "Off the middle and not parallel to a wall; a carpet, curtains, an open bookshelf help.", 3.8, GRAY
    )
    sheet.text(
        12,
        114.5,
        "Nothing hard (table, screen, you) within 20 cm of a microphone, or between it and the board.",
        3.6,
        GRAY,
    )
    return sheet


def draw_poses() -> Drawing:
    """Return which poses make a good session: over the picture, near and far, tilted four ways."""
    sheet = Drawing(190, 122, "Poses of a good session")
    sheet.text(12, 10, "All over the picture", 4.4, bold=True)
    sheet.rect(12, 14, 80, 45, fill="#f8fafc", line=0.8)
    for column, left in enumerate((15, 41, 67)):
        for row, top in enumerate((16.5, 30, 43.5)):
            sheet.rect(left, top, 19, 13, fill="#ffffff", turn_deg=(column - 1) * 8 - (row - 1) * 6)
            sheet.text(left + 9.5, top + 8, str(3 * row + column + 1), 4, SOUND, "middle")
    sheet.text(104, 10, "Near, middle, far", 4.4, bold=True)
    for left, size, words in ((104, 34, "0.4 m"), (142, 22, "0.7 m"), (168, 14, "1 m")):
        sheet.rect(left, 36 - size * 0.36, size, size * 0.72, fill="#ffffff")
        sheet.rect(left + size * 0.15, 36 - size * 0.2, size * 0.7, size * 0.42, fill=PALE, ink="none", line=0)
        sheet.text(left + size / 2, 56, words, 3.8, GRAY, "middle")
    sheet.text(12, 72, "Tilted by 20 to 35 degrees, about both axes and both ways", 4.4, bold=True)
    shapes = {
        "left edge nearer": [(0, 0), (34, 5), (34, 25), (0, 30)],
        "right edge nearer": [(0, 5), (34, 0), (34, 30), (0, 25)],
        "top nearer": [(0, 0), (38, 0), (33, 26), (5, 26)],
        "bottom nearer": [(5, 2), (33, 2), (38, 28), (0, 28)],
    }
    for number, (words, corners) in enumerate(shapes.items()):
        left = 12 + 44 * number
        sheet.polygon([(left + x, 77 + y) for x, y in corners], fill="#ffffff")
        centre = (left + sum(x for x, _ in corners) / 4, 77 + sum(y for _, y in corners) / 4)
        inner = [
            (centre[0] + 0.66 * (left + x - centre[0]), centre[1] + 0.66 * (77 + y - centre[1])) for x, y in corners
        ]
        sheet.polygon(inner, fill=PALE, ink="none", line=0)
        sheet.text(left + 18, 114, words, 3.8, GRAY, "middle")
    return sheet


if __name__ == "__main__":
    main()
