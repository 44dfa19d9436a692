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


def buzzers_mm(board: Board) -> list[tuple[int, float, float, float]]:
    """Return the number and the place of each buzzer."""
    return [(one.id, *(1e3 * value for value in one.position_m)) for one in board.buzzers]


def measured_squares(board: Board) -> tuple[int, int]:
    """Return how many squares to measure along a row and down a column: from dark edge to dark edge, so odd numbers."""
    across, down = (corners + 1 for corners in board.corners)
    return across - (across + 1) % 2, down - (down + 1) % 2


def draw_print(board: Board) -> Drawing:
    """Return the board in its own size on A3, with crosses for the buzzers and a rule to check the print by."""
    sheet = Drawing(*A3_MM, "Board for printing at 100 %")
    x, y = 110.0, 86.0
    squares(sheet, board, x, y, 1.0)
    for number, right, down, _ in buzzers_mm(board):
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
    row, column = measured_squares(board)
    sheet.text(
        left,
        20,
        f"Print at 100 % (not: fit to page). Squares of {size_mm:g} mm: {row} along a row must measure "
        f"{row * size_mm:g} mm, {column} down a column {column * size_mm:g} mm.",
        4,
        GRAY,
    )
    return sheet


def draw_board(board: Board) -> Drawing:
    """Return the board with its frame, its buzzers and their measures, and a buzzer from the side."""
    sheet, scale = Drawing(190, 150, "The board: frame, corners and buzzers"), 0.36
    x, y = 50.0, 34.0
    sheet.rect(x - 28, y - 24, 128, 96, fill="#f8fafc")
    squares(sheet, board, x, y, scale)
    places = {number: (scale * right, scale * down) for number, right, down, _ in buzzers_mm(board)}
    for number, (right, down) in places.items():
        sheet.circle(x + right, y + down, 3.2, fill="#ffffff", ink=SOUND, line=0.8)
        sheet.text(x + right, y + down + 1.4, str(number), 4, SOUND, "middle", bold=True)
    sheet.circle(x, y, 1.6, ink=GREEN, line=0.8)
    for name, (right, down) in {"x": (27, 0), "y": (0, 27)}.items():
        sheet.arrow(x, y, x + right, y + down, GREEN, 0.8)
        sheet.circle(x + 1.16 * right, y + 1.16 * down, 3, fill="#ffffff", ink="none", line=0)
        sheet.text(x + 1.16 * right, y + 1.16 * down + 1.4, name, 5, GREEN, "middle", bold=True)
    far, low = places[3][0], places[6][1]
    sheet.size(x, y - 27, x + far, y - 27, f"buzzer 3: x = {far / scale:g} mm")
    sheet.line(x, y - 29, x, y - 1.6, GRAY, 0.2, "1 1")
    sheet.line(x + far, y - 29, x + far, y - 20, GRAY, 0.2, "1 1")
    sheet.size(x + 104, y, x + 104, y + low, "buzzer 6:")
    sheet.text(x + 105.8, y + low / 2 + 6, f"y = {low / scale:g} mm", 3.6, GRAY)
    sheet.text(22, 113, "Origin: the first inner corner, beside the dark corner square of the print.", 4, GREEN)
    draw_depth(sheet, 22, 128, board)
    return sheet


def draw_depth(sheet: Drawing, x: float, y: float, board: Board) -> None:
    """Draw a buzzer on the plate from the side, much enlarged: where its z is measured."""
    z_mm = buzzers_mm(board)[0][3]
    plate, hole = y + 8, y
    sheet.text(x, y - 7, "From the side, enlarged:", 4, GREEN)
    sheet.rect(x, plate, 74, 5, fill=PALE)
    sheet.text(x + 2, plate + 9, "plate, print on top, camera above", 3.6, GRAY)
    sheet.rect(x + 24, hole, 16, plate - hole, fill="#ffffff", ink=SOUND, line=0.8)
    sheet.rect(x + 30.5, hole - 0.5, 3, 1, fill=SOUND, ink="none", line=0)
    sheet.text(x + 22, hole + 2.5, "its hole", 3.6, SOUND, "end")
    sheet.line(x + 40, hole, x + 66, hole, GRAY, 0.2, "1 1")
    sheet.line(x + 62, plate, x + 62, hole + 2, GRAY, 0.3)
    sheet.arrow(x + 62, plate, x + 62, hole, GRAY, 0.3)
    sheet.text(x + 64, y + 5.5, f"z = {z_mm:g} mm", 3.6, GRAY)
    sheet.arrow(x + 92, y - 2, x + 92, y + 13, GREEN, 0.8)
    sheet.text(x + 95, y + 12.5, "z, away from the camera", 4, GREEN)
    sheet.text(x + 95, y + 1, "0 at the print, so z < 0 before it", 3.4, GRAY)


def draw_scale(board: Board) -> Drawing:
    """Return how the print's scale is measured: on the board itself, from dark edge to dark edge, both ways."""
    sheet, scale = Drawing(190, 128, "Measuring the print"), 0.36
    x, y = 34.0, 30.0
    squares(sheet, board, x, y, scale)
    side, size_mm = 1e3 * board.square_size_m * scale, 1e3 * board.square_size_m
    row, column = measured_squares(board)
    left, top, right, bottom = x - side, y - side, x + (row - 1) * side, y + (column - 1) * side
    for edge in (left, right):
        sheet.line(edge, top - 8, edge, bottom + 8, SOUND, 0.4, "2 1")
    for edge in (top, bottom):
        sheet.line(left - 8, edge, right + side + 10, edge, SOUND, 0.4, "2 1")
    sheet.size(left, top - 5, right, top - 5, f"{row} squares: {row * size_mm:g} mm wanted", SOUND)
    sheet.size(left, bottom + 6, right, bottom + 6, "", SOUND)
    sheet.size(left - 5, top, left - 5, bottom, "", SOUND)
    aside = right + side + 7
    sheet.size(aside, top, aside, bottom, f"{column} squares:", SOUND)
    sheet.text(aside + 1.8, (top + bottom) / 2 + 6, f"{column * size_mm:g} mm wanted", 3.6, SOUND)
    sheet.text(left, bottom + 14, "From dark edge to dark edge, at both ends of the board, both ways.", 3.8, GRAY)
    long_mm, short_mm = row * (size_mm + 0.1), column * (size_mm + 0.1)
    mean_m = (long_mm / row + short_mm / column) / 2e3
    sheet.text(left, bottom + 22, f"You read {long_mm:.1f} mm and {short_mm:.1f} mm, say. Then write:", 3.8, GRAY)
    sheet.text(left, bottom + 29, f"square_size_m: {mean_m:.5f}", 4.4)
    sheet.text(
        left + 66, bottom + 29, f"# the mean of {long_mm:.1f} mm / {row} and {short_mm:.1f} mm / {column}", 3.6, GRAY
    )
    sheet.text(left, bottom + 35, "square_size_std_m: 0.00001", 4.4)
    sheet.text(left + 66, bottom + 35, f"# read to 0.1 mm, over {row} squares", 3.6, GRAY)
    return sheet


def draw_wiring() -> Drawing:
    """Return the wiring of Arduino, buzzers, microphones and computer."""
    sheet = Drawing(190, 112, "Wiring")
    sheet.rect(66, 12, 42, 74, fill="#f8fafc", line=0.6)
    sheet.text(93, 45, "Arduino", 4.4, INK, "middle", bold=True)
    sheet.text(93, 50.5, "Uno, Nano", 3.4, GRAY, "middle")
    sheet.text(93, 55, "or Mega", 3.4, GRAY, "middle")
    for number in range(6):
        level = 20 + 9 * number
        sheet.text(68, level + 1.3, f"pin {number + 2}", 3.4, GRAY)
        sheet.line(66, level, 50, level)
        sheet.rect(41, level - 1.6, 9, 3.2, fill="#ffffff")
        sheet.line(41, level, 30, level)
        sheet.circle(26, level, 3.8, fill="#ffffff", ink=SOUND, line=0.7)
        sheet.text(26, level + 1.4, str(number + 1), 4, SOUND, "middle", bold=True)
        sheet.line(22.2, level, 14, level)
    sheet.line(14, 20, 14, 78)
    sheet.line(14, 78, 66, 78)
    sheet.text(68, 79.3, "GND", 3.4, GRAY)
    sheet.text(45.5, 14, "100 to 220 ohm each", 3.4, GRAY, "middle")
    sheet.text(14, 84.5, "six passive piezo buzzers", 3.8, SOUND)
    box(sheet, 140, 12, 38, 24, "computer", "rig-capture")
    box(sheet, 140, 50, 38, 28, "sound device", "one clock, 8 inputs")
    box(sheet, 140, 88, 38, 18, "camera", "focus locked")
    sheet.line(108, 24, 140, 24, BLUE, 0.7)
    sheet.text(124, 21.5, "USB", 3.6, BLUE, "middle")
    sheet.line(159, 36, 159, 50, BLUE, 0.7)
    sheet.text(161, 44.3, "USB", 3.6, BLUE)
    sheet.line(178, 97, 184, 97, BLUE, 0.7)
    sheet.line(184, 97, 184, 24, BLUE, 0.7)
    sheet.line(184, 24, 178, 24, BLUE, 0.7)
    for number in range(8):
        level = 52 + 2.9 * number
        sheet.line(128, level, 140, level, GREEN, 0.4)
        sheet.circle(126.6, level, 1.2, fill="#ffffff", ink=GREEN)
    sheet.text(138, 47, "8 microphones", 3.8, GREEN, "end")
    sheet.text(106, 77.3, "pin 8", 3.4, GRAY, "end")
    sheet.line(108, 76, 140, 76, GRAY, 0.4, "1.5 1")
    sheet.text(110, 82, "sync output,", 3.4, GRAY)
    sheet.text(110, 86.2, "may be left out", 3.4, GRAY)
    return sheet


def box(sheet: Drawing, x: float, y: float, width: float, height: float, name: str, below: str) -> None:
    sheet.rect(x, y, width, height, fill="#f8fafc", line=0.6)
    sheet.text(x + width / 2, y + height / 2, name, 4.4, INK, "middle", bold=True)
    sheet.text(x + width / 2, y + height / 2 + 5, below, 3.2, GRAY, "middle")


def draw_room() -> Drawing:
    """Return the room from above: where the array stands, and where the board goes."""
    sheet = Drawing(190, 128, "The room from above, not to scale")
    sheet.rect(8, 8, 174, 92, fill="#f8fafc", line=1.2)
    x, y, ahead = 58.0, 60.0, np.radians(-6)

    def place(along: float, aside_deg: float) -> tuple[float, float]:
        angle = ahead + np.radians(aside_deg)
        return x + along * np.cos(angle), y + along * np.sin(angle)

    sheet.polygon([(x, y), place(112, -19), place(112, 19)], fill="#fef3c7", ink="none", line=0)
    for distance in (40, 70, 100):
        points = [place(distance, aside_deg) for aside_deg in np.linspace(-19, 19, 30)]
        for (x1, y1), (x2, y2) in pairwise(points):
            sheet.line(x1, y1, x2, y2, GRAY, 0.25, "1 1")
        end = place(distance, 22)
        sheet.text(end[0], end[1] + 3, f"{distance / 100:g} m", 3.6, GRAY, "middle")
    boards = {40: ((-9, 20), (10, -25)), 70: ((-13, -20), (1, 30), (14, 8)), 100: ((-14, 25), (0, -30), (14, 15))}
    for distance, some in boards.items():
        for aside_deg, turn_deg in some:
            across, down = place(distance, aside_deg)
            sheet.rect(across - 0.8, down - 6, 1.6, 12, fill=SOUND, ink="none", line=0, turn_deg=turn_deg)
    for along, aside_deg in ((22, -122), (22, 122), (21, -62), (21, 62)):
        end = place(along, aside_deg)
        sheet.line(x, y, *end, GREEN, 0.4)
        sheet.circle(*end, 2, fill="#ffffff", ink=GREEN, line=0.8)
    sheet.rect(x - 3, y - 3, 6, 6, fill=INK, turn_deg=float(np.degrees(ahead)))
    sheet.text(x - 2, y + 28, "camera and microphones", 3.8, GREEN, "middle")
    sheet.text(x - 2, y + 33, "on one stiff frame", 3.8, GREEN, "middle")
    sheet.text(14, 16, "The board goes all over the picture, 0.4 to 1 m away.", 3.8, SOUND)
    sheet.size(8.6, y, x - 15, y, "1 m or more")
    sheet.text(8, 107, "From above, not to scale: board and array are drawn small, the room is larger.", 3.6, GRAY)
    sheet.text(
        8, 114, "Off the middle and not parallel to a wall; a carpet, curtains, an open bookshelf help.", 3.6, GRAY
    )
    sheet.text(8, 121, "Nothing hard (table, screen, you) within 20 cm of a microphone, or between it and the board.",
               3.6, GRAY)  # fmt: skip
    return sheet


def draw_poses() -> Drawing:
    """Return which poses make a good session: over the picture, near and far, tilted four ways."""
    sheet = Drawing(190, 122, "Poses of a good session")
    sheet.text(12, 10, "All over the picture", 4.4, bold=True)
    sheet.rect(12, 14, 80, 45, fill="#f8fafc", line=0.8)
    for column, left in enumerate((15, 41, 67)):
        for row, top in enumerate((16.5, 30, 43.5)):
            sheet.rect(left + 1.5, top + 1.5, 16, 10, fill="#ffffff", turn_deg=(column - 1) * 8 - (row - 1) * 6)
            sheet.text(left + 9.5, top + 8, str(3 * row + column + 1), 4, SOUND, "middle")
    sheet.text(104, 10, "Near, middle, far", 4.4, bold=True)
    for left, distance_m in ((104, 0.4), (143, 0.7), (168, 1.0)):
        size = 34 * 0.4 / distance_m
        sheet.rect(left, 36 - size * 0.36, size, size * 0.72, fill="#ffffff")
        sheet.rect(left + size * 0.15, 36 - size * 0.2, size * 0.7, size * 0.42, fill=PALE, ink="none", line=0)
        sheet.text(left + size / 2, 56, f"{distance_m:g} m", 3.8, GRAY, "middle")
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
