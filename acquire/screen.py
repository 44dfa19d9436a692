"""The screens of a capture: a live one for a terminal, and plain lines for everything else."""

from __future__ import annotations

import time
from collections.abc import Iterable
from contextlib import suppress
from types import TracebackType
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.live import Live
from rich.progress import Progress
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from acquire.bar import Bar
from acquire.status import QUIET_DBFS, Message, State, Status

_REFRESH_S = 0.1
_HOT_DBFS, _CLIPPED_DBFS = -6.0, -0.1
_METER_WIDTH = 38
_LINES_BESIDE_METERS = 16
_LINES_LEFT_FREE = 4  # the rig above, what to do next below, the prompt
_ENDS = {State.FINISHED: "green", State.INTERRUPTED: "yellow", State.LOST: "red", State.GIVEN_UP: "red"}
_LEVEL_STYLES = {"info": "", "warning": "yellow"}


class Screen(Protocol):
    """Whatever shows a capture to its operator."""

    def show(self, status: Status) -> None:
        """Show how things stand; called often."""

    def say(self, message: Message) -> None:
        """Show something that happened."""

    def watch(self, rows: NDArray[np.void], what: str) -> Iterable[np.void]:
        """Give the rows on, one after another, and show how far that is."""


class PlainScreen:
    """One line per event, for pipes, logs and dumb terminals."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def show(self, status: Status) -> None:
        """Show nothing: lines tell events only."""

    def say(self, message: Message) -> None:
        """Print one line; where nobody reads any more, be silent rather than end the capture."""
        mark = "" if message.level == "info" else f"{message.level}: "
        with suppress(SystemExit, OSError):  # rich's answer to a broken pipe; a log whose disk is full
            self._console.print(f"{_clock_time(message.time_s)}  {mark}{message.text}", soft_wrap=True, markup=False)

    def watch(self, rows: NDArray[np.void], what: str) -> Iterable[np.void]:
        """Give the rows on, and show nothing."""
        return rows


class LiveScreen:
    """A display that is redrawn in place."""

    def __init__(self, console: Console) -> None:
        self._live = Live(console=console, auto_refresh=False, vertical_overflow="crop")
        self._console = console
        self._status: Status | None = None
        self._drawn_s = float("-inf")
        self._is_gone = False  # the terminal; the capture goes on until it is told to end

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._status is not None:
            self._draw(self._status)
        with suppress(OSError):
            self._live.stop()

    def show(self, status: Status) -> None:
        """Redraw, but not more often than an eye can follow."""
        self._status = status
        if time.monotonic() - self._drawn_s >= _REFRESH_S:
            self._draw(status)

    def say(self, message: Message) -> None:
        """Redraw soon; the status holds the message."""
        self._drawn_s = float("-inf")

    def watch(self, rows: NDArray[np.void], what: str) -> Iterable[np.void]:
        """Give the rows on behind a bar, until there is a status to show."""
        progress = Progress(console=self._console, auto_refresh=False)
        for row in progress.track(rows, description=what):
            if time.monotonic() - self._drawn_s >= _REFRESH_S:
                self._live.update(progress, refresh=True)
                self._drawn_s = time.monotonic()
            yield row
        self._live.update("", refresh=True)

    def _draw(self, status: Status) -> None:
        if self._is_gone:
            return
        size = self._console.size
        try:
            self._live.update(picture(status, size.width, size.height), refresh=True)
        except OSError:
            self._is_gone = True
        self._drawn_s = time.monotonic()


def screen_for(console: Console) -> LiveScreen | PlainScreen:
    """Return the live screen for a terminal, else plain lines."""
    return LiveScreen(console) if console.is_terminal and not console.is_dumb_terminal else PlainScreen(console)


def picture(status: Status, width: int, height: int) -> RenderableType:
    """Draw the status for a terminal of `width` columns and `height` lines."""
    rows = max(4, min(len(status.channels), height - _LINES_BESIDE_METERS))
    n_messages = max(height - _LINES_BESIDE_METERS - rows + 5, 3)
    blank = Text("")
    now = Text.assemble(("Now      ", "dim"), (status.advice, "bold"), no_wrap=True, overflow="crop")
    board = Text.assemble(("Board    ", "dim"), status.board, no_wrap=True, overflow="crop")
    progress = Group(_progress(status, width), board)
    parts: list[RenderableType] = [_header(status, width), progress, _meters(status, width, rows)]
    parts += [now] if status.advice else []
    parts.append(_messages(status, n_messages))
    return Cropped(Group(*(line for part in parts for line in (part, blank))), height - _LINES_LEFT_FREE)


class Cropped:
    """A picture of always the same number of lines, so that nothing jumps or scrolls away.

    The last is left free: the terminal writes ^C there. Behind a full line it would begin a new one, and all later
    pictures would be a line too low, with the first one's header above them.
    """

    def __init__(self, content: RenderableType, height: int) -> None:
        self._content, self._height = content, height

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        lines = console.render_lines(self._content, options.update(height=None), pad=True)
        for line in Segment.set_shape(lines, options.max_width, self._height - 1):
            yield from line
            yield Segment.line()
        yield Segment(" ")


def _header(status: Status, width: int) -> Table:
    grid = Table.grid(expand=True, padding=(0, 2))
    grid.width = width
    grid.add_column(no_wrap=True, overflow="ellipsis", ratio=1)
    grid.add_column(no_wrap=True, justify="right")
    title = Text.assemble(("rig-capture", "bold"), f"  {status.rig} ", ("to", "dim"), f" {status.file}")
    behind = Text(f"{status.backlog_s:.1f} s behind  ", style="yellow") if status.is_behind else Text("")
    state = Text(f"{status.state.value}  ", style=_ENDS.get(status.state, "cyan"))
    grid.add_row(title, behind + state + Text(_clock_time(status.time_s)))
    return grid


def _progress(status: Status, width: int) -> Table:
    bar_width = max(width - 28, 10)
    grid = Table.grid(padding=(0, 2))
    grid.add_column(style="dim", width=7)
    grid.add_column(width=16, no_wrap=True)
    grid.add_column()
    style = "green" if status.state is State.FINISHED else "cyan"
    fired = status.emission if status.buzzer is not None else 0
    buzzer = "-" if status.buzzer is None else f"{status.buzzer} ({status.emission} of {status.n_emissions})"
    grid.add_row("Poses", f"{status.saved} of {status.poses} saved", Bar(status.saved / status.poses, bar_width, style))
    grid.add_row("Buzzer", buzzer, Bar(fired / status.n_emissions, bar_width, style))
    return grid


def _meters(status: Status, width: int, rows: int) -> Table:
    columns = max(min(-(-len(status.channels) // rows), width // _METER_WIDTH), 1)
    bar_width = max((width - 2 * (columns - 1)) // columns - 32, 6)
    shown = min(len(status.channels), rows * columns)
    hidden = len(status.channels) - shown
    grid = Table.grid(padding=(0, 2))
    for row in range(min(rows, shown)):
        grid.add_row(*(_meter(status, index, bar_width) for index in range(row, shown, rows)))
    if hidden:
        grid.add_row(Text(f"and {hidden} more channels", style="dim"))
    return grid


def _meter(status: Status, index: int, bar_width: int) -> Table:
    channel, level_dbfs = status.channels[index], float(status.level_dbfs[index])
    fault = status.faults.get(channel, "clipping" if level_dbfs >= _CLIPPED_DBFS else "")
    style = "red" if fault else "yellow" if level_dbfs >= _HOT_DBFS else "green"
    bar = Bar(1 - level_dbfs / QUIET_DBFS, bar_width, style)
    grid = Table.grid(padding=(0, 1))
    grid.add_column(width=6, style="dim", no_wrap=True)
    grid.add_column(width=bar_width)
    grid.add_column(width=9, justify="right", no_wrap=True)
    grid.add_column(width=9, style="red", no_wrap=True)
    number = "-inf dBFS" if level_dbfs <= QUIET_DBFS else f"{level_dbfs:.0f} dBFS"
    grid.add_row(f"ch {channel}", bar, number, fault)
    return grid


def _messages(status: Status, n_messages: int) -> Table:
    """Return the last messages, the newest first, so that a small terminal cuts off the oldest."""
    grid = Table.grid(padding=(0, 2))
    grid.add_column(style="dim", no_wrap=True)
    grid.add_column(overflow="fold")
    for message in list(status.messages)[: -n_messages - 1 : -1]:
        mark = "" if message.level == "info" else f"{message.level}: "
        grid.add_row(
            _clock_time(message.time_s), Text(mark + message.text, style=_LEVEL_STYLES.get(message.level, "red"))
        )
    return grid


def _clock_time(time_s: float) -> str:
    return f"{int(time_s) // 60:3d}:{int(time_s) % 60:02d}"
