"""The live display: what it tells without colour, and what it leaves to the terminal."""

import io

import pytest
from rich.console import Console

from acquire.bar import Bar
from acquire.screen import picture
from acquire.status import Status

WIDTH, HEIGHT = 80, 24


def console_of(encoding="utf-8"):
    return Console(file=io.TextIOWrapper(io.BytesIO(), encoding), width=WIDTH, height=HEIGHT, color_system=None)


@pytest.mark.parametrize(("encoding", "full", "rest"), [("utf-8", "━", "─"), ("ascii", "#", "-")])
@pytest.mark.parametrize(("share", "n_full"), [(-1.0, 0), (0.0, 0), (0.3, 3), (1.0, 10), (2.0, 10)])
def test_a_bar_tells_without_colour_how_full_it_is(encoding, full, rest, share, n_full):
    console = console_of(encoding)
    ((segment, *more),) = console.render_lines(Bar(share, 10, "green"), pad=False)
    assert segment.text + "".join(part.text for part in more) == full * n_full + rest * (10 - n_full)


def test_the_last_line_has_room_for_what_the_terminal_writes():
    status = Status("simulated", "s1.h5", tuple(range(1, 9)), poses=20, n_emissions=6)
    *_, last = lines = console_of().render_lines(picture(status, WIDTH, HEIGHT), pad=False)
    assert len(lines) < HEIGHT
    assert sum(part.cell_length for part in last) < WIDTH - len("^C")
