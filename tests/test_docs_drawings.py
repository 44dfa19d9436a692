"""The bench guide's drawings: those of today's board, with every label legible."""

import importlib
import re
from pathlib import Path

import pytest
from playwright.sync_api import sync_playwright

from rigs.library import find_description

DOCS = Path(__file__).parents[1] / "docs"
BOXES = """[...document.querySelectorAll('text')].map(one => {
    const box = one.getBBox();
    return [one.textContent, box.x, box.y, box.x + box.width, box.y + box.height];
})"""


@pytest.fixture
def bench(monkeypatch):
    monkeypatch.syspath_prepend(DOCS / "figures")
    return importlib.import_module("bench")


def test_drawings_are_those_of_the_shipped_board(bench, tmp_path, monkeypatch):
    monkeypatch.setattr(bench, "FOLDER", tmp_path)
    bench.main()
    drawn = sorted(tmp_path.iterdir())
    assert len(drawn) == 6
    for path in drawn:
        assert path.read_text() == (DOCS / "figures" / path.name).read_text(), f"{path.name} is old: make figures"


def test_the_guide_measures_squares_that_the_board_has(bench):
    board = find_description("bench8").description.board
    row, column = bench.measured_squares(board)
    assert row <= board.corners[0] + 1
    assert column <= board.corners[1] + 1
    guide = " ".join((DOCS / "bench-guide.md").read_text().split())
    size_mm = 1e3 * board.square_size_m
    assert f"The board has {board.corners[0] + 1} x {board.corners[1] + 1} squares. Measure {row} of them" in guide
    for number in (row, column):
        assert f"({number * size_mm:g} mm wanted)" in guide
    assert f"Divide by {row} and by {column}" in guide


def test_the_sync_output_is_drawn_with_the_divider_of_the_firmwares_page(bench, tmp_path):
    """5 V on a sound input does harm: no straight line may be drawn from pin 8."""
    bench.draw_wiring().save(tmp_path / "wiring.svg")
    words = re.findall(r">([^<>]+)</text>", (tmp_path / "wiring.svg").read_text())
    wiring = (DOCS.parent / "firmware" / "README.md").read_text()
    for part, sign in {
        "10 kilohm": "pin 8 ---[ 10 kilohm ]",
        "1 kilohm": "[ 1 kilohm ]",
        "470 ohm": "[ 470 ohm ]",
    }.items():
        assert sign in wiring
        assert part in words
    assert words.count("9") == 1  # the input of the sync output, beside those of the microphones


def test_guide_drawing_and_description_agree_on_buzzers_and_columns(bench, tmp_path):
    board = find_description("bench8").description.board
    bench.draw_board(board).save(tmp_path / "board.svg")
    drawn, guide = (tmp_path / "board.svg").read_text(), (DOCS / "bench-guide.md").read_text()
    for _, right, down, depth in bench.buzzers_mm(board):
        assert f"x {right:+g}, y {down:+g}" in drawn
        assert f"(z = {depth / 1e3:g})" in guide
    assert f"columns 1 and {bench.measured_squares(board)[0]}" in " ".join(guide.split())
    assert f"plate of {bench.A3_MM[0]:g} x {bench.A3_MM[1]:g} mm" in guide


@pytest.mark.parametrize("corners", [(9, 6), (8, 5), (6, 9), (11, 8)])
def test_measured_squares_begin_and_end_dark(bench, corners):
    board = find_description("bench8").description.board.model_copy(update={"corners": corners})
    for squares, inner in zip(bench.measured_squares(board), corners, strict=True):
        assert squares % 2 == 1  # the first is dark, so the last is
        assert inner <= squares <= inner + 1


def test_labels_neither_overlap_nor_leave_the_sheet():
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium")
        page = browser.new_page()
        for path in [*sorted((DOCS / "figures").glob("bench-*.svg")), DOCS / "figures" / "board-a3.svg"]:
            page.goto(path.as_uri())
            width, height = page.evaluate("[...document.documentElement.getAttribute('viewBox').split(' ')].slice(2)")
            boxes = [box for box in page.evaluate(BOXES) if box[0]]
            for number, (words, left, top, right, bottom) in enumerate(boxes):
                assert left >= 0, (path.name, words)
                assert top >= 0, (path.name, words)
                assert right <= float(width), (path.name, words)
                assert bottom <= float(height), (path.name, words)
                for other, x1, y1, x2, y2 in boxes[:number]:
                    apart = right <= x1 or x2 <= left or bottom <= y1 + 1.2 or y2 <= top + 1.2  # boxes hold accents
                    assert apart, f"{path.name}: {words!r} over {other!r}"
        browser.close()
