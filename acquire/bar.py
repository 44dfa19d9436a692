"""A bar of two kinds of lines, thick as far as it is full and thin beyond, so that it needs no colour."""

from __future__ import annotations

from dataclasses import dataclass

from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.segment import Segment


@dataclass(frozen=True)
class Bar:
    """A bar to print with rich.

    Parameters
    ----------
    share : float
        How full it is: 0 to 1, beyond which it is as good as empty or full.
    width : int
        In columns.
    style : str
        Of the full part.
    """

    share: float
    width: int
    style: str

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        full, rest = "#-" if options.ascii_only else "━─"
        n_full = round(min(max(self.share, 0.0), 1.0) * self.width)
        yield Segment(full * n_full, console.get_style(self.style))
        yield Segment(rest * (self.width - n_full), console.get_style("dim"))

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        return Measurement(self.width, self.width)
