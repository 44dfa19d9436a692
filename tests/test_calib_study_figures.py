"""Figures of studies: no two lines of a panel look alike, a method keeps its colour, and what few reached is marked."""

from dataclasses import replace
from itertools import product

import pytest

pytest.importorskip("pyarrow")
pytest.importorskip("matplotlib")

from matplotlib.figure import Figure
from test_calib_study_summary import SUMMARY

from calib.study.looks import LOOKS, Line, panels_of
from calib.study.plots import NOTE_OPEN, _draw_errors, _note_open


@pytest.mark.parametrize(
    ("methods", "rests", "n_panels"),
    [
        (list(LOOKS), [""], 1),
        (["ours-2", "joint"], ["board A", "board B", "board C"], 1),
        (["ours-2", "joint"], [f"board {number}" for number in range(8)], 8),
        (list(LOOKS), ["board A", "board B"], 2),
        (["joint"], [f"board {number}" for number in range(6)], 1),
        (["joint"], [f"board {number}" for number in range(7)], 7),
    ],
)
def test_no_two_lines_of_a_panel_look_alike(methods, rests, n_panels):
    lines = [Line(method, rest, []) for method, rest in product(methods, rests)]
    panels = panels_of(lines)
    assert len(panels) == n_panels
    assert sum(len(panel.lines) for panel in panels) == len(lines)
    for panel in panels:
        assert len({tuple(look.values()) for _, _, look in panel.lines}) == len(panel.lines)
        assert len({label for _, label, _ in panel.lines}) == len(panel.lines)
        if len(methods) > 1:
            assert all(look["color"] == LOOKS[line.method][0] for line, _, look in panel.lines)


def test_signs_are_open_where_few_converged():
    good, poor = SUMMARY, replace(SUMMARY, n_settled=20, convergence_rate=0.2)
    axes = Figure().subplots()
    ((line, label, look),) = panels_of([Line("ours-2", "", [good, poor])])[0].lines
    _draw_errors(axes, [1, 2], line.cases, "rmse_m", label, look)
    (open_signs,) = [each for each in axes.get_lines() if each.get_markerfacecolor() == "white"]
    assert list(open_signs.get_xdata()) == [2]
    assert _note_open([line]) == NOTE_OPEN
    assert not _note_open([replace(line, cases=[good])])
