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
PRINT_ORIGIN_MM = (110.0, 86.0)  # of the first inner corner on the sheet
PICTURE_PX, FOCAL_PX = (1280, 720), 920  # of the camera that drawings to scale are made for


def main() -> None:
    """Draw everything."""
    board = find_description("bench8").description.board
    for name, draw in {"board": draw_board, "scale": draw_scale, "poses": draw_poses}.items():
        draw(board).save(FOLDER / f"bench-{name}.svg")
    for name, picture in {"wiring": draw_wiring(), "room": draw_room()}.items():
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
    x, y = PRINT_ORIGIN_MM
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
    """Return the plate with the print and all buzzers, with their measures, and a buzzer from the side."""
    sheet, scale = Drawing(190, 172, "The board: plate, corners and buzzers"), 0.36
    left, top = 14.0, 20.0
    x, y = left + PRINT_ORIGIN_MM[0] * scale, top + PRINT_ORIGIN_MM[1] * scale
    width, height = (side * scale for side in A3_MM)
    sheet.rect(left, top, width, height, fill="#f8fafc")
    sheet.size(left, top - 4, left + width, top - 4, f"plate = the printed A3 sheet, uncut: {A3_MM[0]:g} mm")
    sheet.size(left + width + 4, top, left + width + 4, top + height, f"{A3_MM[1]:g} mm")
    squares(sheet, board, x, y, scale)
    for number, right, down, _ in buzzers_mm(board):
        at = (x + scale * right, y + scale * down)
        sheet.circle(*at, 3.2, fill="#ffffff", ink=SOUND, line=0.8)
        sheet.text(at[0], at[1] + 1.4, str(number), 4, SOUND, "middle", bold=True)
        sheet.text(at[0], at[1] + (8 if down > 0 else -5), f"x {right:+g}, y {down:+g}", 3.6, SOUND, "middle")
    sheet.circle(x, y, 1.6, ink=GREEN, line=0.8)
    for name, (right, down) in {"x": (27, 0), "y": (0, 27)}.items():
        sheet.arrow(x, y, x + right, y + down, GREEN, 0.8)
        sheet.circle(x + 1.16 * right, y + 1.16 * down, 3, fill="#ffffff", ink="none", line=0)
        sheet.text(x + 1.16 * right, y + 1.16 * down + 1.4, name, 5, GREEN, "middle", bold=True)
    sheet.text(left, 135, "Origin: the first inner corner, beside the dark corner square. Millimetres.", 4, GREEN)
    draw_depth(sheet, left, 150, board)
    return sheet


def draw_depth(sheet: Drawing, x: float, y: float, board: Board) -> None:
    """Draw a buzzer on the plate from the side, much enlarged: where its z is measured."""
    (z_mm,) = {depth for *_, depth in buzzers_mm(board)}  # all alike: no spacers
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
    sheet.text(x + 64, y + 5.5, f"z = {z_mm:g} mm, all six", 3.6, GRAY)
    sheet.arrow(x + 100, y - 2, x + 100, y + 13, GREEN, 0.8)
    sheet.text(x + 103, y + 12.5, "z, away from the camera", 4, GREEN)
    sheet.text(x + 103, y + 1, "0 at the print, so z < 0 before it", 3.4, GRAY)


def draw_scale(board: Board) -> Drawing:
    """Return how the print's scale is measured: on the board itself, from dark edge to dark edge, both ways."""
    sheet, scale = Drawing(190, 128, "Measuring the print"), 0.36
    x, y = 34.0, 30.0
    squares(sheet, board, x, y, scale)
    side, size_mm = 1e3 * board.square_size_m * scale, 1e3 * board.square_size_m
    row, column = measured_squares(board)
    left, top, right, bottom = x - side, y - side, x + (row - 1) * side, y + (column - 1) * side
    for column_left in (left, right - side):
        sheet.rect(column_left, top, side, bottom - top, ink=SOUND, line=0.7)
    for edge in (left, right):
        sheet.line(edge, top - 8, edge, bottom + 8, SOUND, 0.4, "2 1")
    for edge in (top, bottom):
        sheet.line(left - 8, edge, right + side + 10, edge, SOUND, 0.4, "2 1")
    sheet.size(left, top - 5, right, top - 5, f"{row} squares: {row * size_mm:g} mm wanted", SOUND)
    sheet.size(left, bottom + 6, right, bottom + 6, "", SOUND)
    for middle in (left + side / 2, right - side / 2):
        sheet.size(middle, top, middle, bottom, "", SOUND)
    aside = right + side + 3
    sheet.text(aside, (top + bottom) / 2 - 5, f"down columns 1 and {row}:", 3.6, SOUND)
    sheet.text(aside, (top + bottom) / 2, f"{column} squares,", 3.6, SOUND)
    sheet.text(aside, (top + bottom) / 2 + 5, f"{column * size_mm:g} mm wanted", 3.6, SOUND)
    words = f"From dark edge to dark edge: along rows 1 and {column}, down columns 1 and {row}."
    sheet.text(left, bottom + 14, words, 3.8, GRAY)
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
    sheet = Drawing(190, 142, "Wiring")
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
    draw_led(sheet, 108, 34)
    box(sheet, 148, 6, 36, 18, "computer", "rig-capture")
    box(sheet, 148, 92, 36, 44, "sound device", "one clock")
    sheet.text(166, 123.5, "8 line or micro-", 3.2, GRAY, "middle")
    sheet.text(166, 127.5, "phone inputs, and", 3.2, GRAY, "middle")
    sheet.text(166, 131.5, "a 9th for sync", 3.2, GRAY, "middle")
    box(sheet, 148, 34, 28, 14, "camera", "focus locked")
    sheet.line(108, 17, 148, 17, BLUE, 0.7)
    sheet.text(128, 14.5, "USB", 3.6, BLUE, "middle")
    sheet.line(162, 24, 162, 34, BLUE, 0.7)
    sheet.text(164, 30.3, "USB", 3.6, BLUE)
    sheet.line(181, 24, 181, 92, BLUE, 0.7)
    sheet.text(179.5, 60, "USB", 3.6, BLUE, "end")
    draw_divider(sheet, 108, 66, 148, 96)
    for number in range(8):
        level = 104 + 4 * number
        sheet.line(126, level, 148, level, GREEN, 0.4)
        sheet.circle(124.6, level, 1.4, fill="#ffffff", ink=GREEN)
        sheet.text(146.5, level - 0.6, str(number + 1), 2.8, GREEN, "end")
    sheet.text(120, 119.3, "8 microphones", 3.8, GREEN, "end")
    sheet.text(14, 98, "Never join pin 8 to an input directly: it has 5 V.", 3.8, SOUND)
    sheet.text(14, 104, "With both resistors the input gets 0.45 V (line).", 3.6, GRAY)
    sheet.text(14, 109.5, "A microphone input: 100 kilohm in place of 10.", 3.6, GRAY)
    return sheet


def draw_led(sheet: Drawing, x: float, y: float) -> None:
    """Draw the LED with its resistor, from the Arduino's edge at x."""
    sheet.text(x - 2, y + 1.3, "pin 13", 3.4, GRAY, "end")
    sheet.line(x, y, x + 5, y)
    sheet.rect(x + 5, y - 1.6, 9, 3.2, fill="#ffffff")
    sheet.text(x + 9.5, y - 3, "470 ohm", 3.2, GRAY, "middle")
    sheet.line(x + 14, y, x + 19, y)
    sheet.polygon([(x + 19, y - 2.2), (x + 19, y + 2.2), (x + 23, y)], fill="#ffffff")
    sheet.line(x + 23, y - 2.2, x + 23, y + 2.2)
    sheet.text(x + 21, y - 3.6, "LED", 3.2, GRAY, "middle")
    sheet.line(x + 23, y, x + 28, y)
    ground(sheet, x + 28, y)
    sheet.text(x + 3, y + 7.5, "in the camera's view;", 3.2, GRAY)
    sheet.text(x + 3, y + 11.5, "may be left out", 3.2, GRAY)


def draw_divider(sheet: Drawing, x: float, y: float, input_x: float, input_y: float) -> None:
    """Draw the divider that makes 0.45 V of pin 8's 5 V, from the Arduino's edge to the sound device's ninth input."""
    sheet.text(x - 2, y + 1.3, "pin 8", 3.4, GRAY, "end")
    sheet.line(x, y, x + 5, y)
    sheet.rect(x + 5, y - 1.6, 9, 3.2, fill="#ffffff")
    sheet.text(x + 9.5, y - 3, "10 kilohm", 3.2, GRAY, "middle")
    node = x + 24
    sheet.line(x + 14, y, node, y)
    sheet.circle(node, y, 0.8, fill=INK)
    sheet.line(node, y, node, y + 5)
    sheet.rect(node - 1.6, y + 5, 3.2, 9, fill="#ffffff")
    sheet.text(node - 3, y + 10.6, "1 kilohm", 3.2, GRAY, "end")
    sheet.line(node, y + 14, node, y + 18)
    ground(sheet, node, y + 18)
    sheet.text(node - 3, y + 18, "GND and", 3.2, GRAY, "end")
    sheet.text(node - 3, y + 22, "line (-)", 3.2, GRAY, "end")
    sheet.line(node, y, input_x - 6, y)
    sheet.line(input_x - 6, y, input_x - 6, input_y)
    sheet.line(input_x - 6, input_y, input_x, input_y)
    sheet.text(input_x - 0.8, input_y - 1.6, "9", 2.8, GRAY, "end")
    sheet.text(input_x - 4, y + 1, "sync output:", 3.2, GRAY)
    sheet.text(input_x - 4, y + 5, "line (+);", 3.2, GRAY)
    sheet.text(input_x - 4, y + 9, "may be left out", 3.2, GRAY)


def ground(sheet: Drawing, x: float, y: float) -> None:
    """Draw the sign for GND below (x, y)."""
    sheet.line(x, y, x, y + 2)
    for row, half in enumerate((2.2, 1.4, 0.6)):
        sheet.line(x - half, y + 2 + 0.9 * row, x + half, y + 2 + 0.9 * row)


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


def print_mm(board: Board) -> tuple[float, float]:
    """Return width and height of all squares."""
    across, down = (1e3 * board.square_size_m * (corners + 1) for corners in board.corners)
    return across, down


def shown_share(length_m: float, distance_m: float) -> float:
    """Return which share of the picture's width a length has at a distance."""
    return length_m * FOCAL_PX / (PICTURE_PX[0] * distance_m)


def draw_poses(board: Board) -> Drawing:
    """Return which poses make a good session: over the picture, near and far, tilted four ways."""
    sheet = Drawing(190, 122, "Poses of a good session")
    sheet.text(12, 10, "All over the picture", 4.4, bold=True)
    sheet.rect(12, 14, 80, 45, fill="#f8fafc", line=0.8)
    across, down = (80 * shown_share(1e-3 * side_mm, 0.7) for side_mm in print_mm(board))
    for row, column in np.ndindex(3, 3):
        left, top = 12.8 + column * (78.4 - across) / 2, 14.6 + row * (43.8 - down) / 2
        sheet.rect(left, top, across, down, fill="#ffffff")
        sheet.text(left + across / 2, top + down / 2 + 1.4, str(3 * row + column + 1), 4, SOUND, "middle")
    sheet.text(12, 63.5, "the squares of the board at 0.7 m, to scale", 3.6, GRAY)
    sheet.text(104, 10, "Near, middle, far", 4.4, bold=True)
    for left, distance_m in ((104, 0.4), (133, 0.7), (162, 1.0)):
        sheet.rect(left, 20, 26, 26 * 9 / 16, fill="#f8fafc", line=0.6)
        for sides_mm, fill in ((A3_MM, "#ffffff"), (print_mm(board), PALE)):
            width, height = (26 * shown_share(1e-3 * side_mm, distance_m) for side_mm in sides_mm)
            ink = "none" if fill == PALE else INK
            sheet.rect(left + 13 - width / 2, 20 + 13 * 9 / 16 - height / 2, width, height, fill=fill, ink=ink)
        sheet.text(left + 13, 40, f"{distance_m:g} m", 3.8, GRAY, "middle")
    sheet.text(104, 47, "picture, plate and squares, to scale", 3.6, GRAY)
    sheet.text(104, 52, f"({PICTURE_PX[0]} x {PICTURE_PX[1]}, focal length {FOCAL_PX} px)", 3.6, GRAY)
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
