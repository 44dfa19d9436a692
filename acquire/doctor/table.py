"""The table of the check-up: for people as it grows, for machines when it is done."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict

import click
import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from acquire.doctor.checkup import Finding
from acquire.doctor.hearing import SILENCE_DBFS, Hearing
from acquire.doctor.row import Part, Row, State, exit_code
from rigs.library import FoundDescription

_STYLES = {State.OK: "green", State.LOOK: "yellow", State.BAD: "bold red"}
_SUBJECT_WIDTH = 15
_NAMED = 4  # buzzers whose columns have room for the whole word
_QUIET_SNR_DB, _NO_SNR_DB = 15.0, 3.0
_LEGEND = "\n   level in dBFS / signal over noise in dB, by buzzer (bz)"
_CHANNEL_WIDTH = 12  # with six buzzers the table fits 70 columns
_NAMED_ROWS = 4  # as many as the last line repeats
_ENDS = {
    State.OK: "everything is ready: rig-capture --session NAME",
    State.LOOK: "ready, but look at {k} of {n} ({which}): rig-capture --session NAME",
    State.BAD: "not ready: mend {k} of {n} ({which}), then run rig-check again",
}


class LiveTable:
    """Prints each row when it comes, under the heading of its part.

    Parameters
    ----------
    found : FoundDescription
    console : Console
    """

    def __init__(self, found: FoundDescription, console: Console) -> None:
        self._console = console
        self._rows: list[Row] = []
        self._part: Part | None = None
        self._step = console.status("")
        console.print(f"rig {found.description.name}, from {found.where}", soft_wrap=True, markup=False)

    def add(self, finding: Finding) -> None:
        """Print a row, or the table of what each channel heard; show a step for as long as it takes."""
        if isinstance(finding, str):
            if self._console.is_terminal:
                self._step.update(f"[dim]{finding} ...")
                self._step.start()
            return
        self._step.stop()
        if isinstance(finding, Hearing):
            if finding.buzzers:
                self._console.print(Text(_LEGEND, style="dim"), soft_wrap=True)
                self._console.print(hearing_table(finding))
            return
        if finding.part is not self._part:
            self._part = finding.part
            self._console.print(Text(f"\n{finding.part.value.capitalize()}", style="bold"))
        self._rows.append(finding)
        if self._console.is_terminal:
            self._console.print(_line(finding))
        else:  # one row, one line, for grep
            self._console.print(_plain_line(finding), soft_wrap=True, markup=False)

    def close(self) -> None:
        """Give the terminal its cursor back, whatever has happened."""
        self._step.stop()

    def end(self) -> int:
        """Print the sum of it all and return the exit code."""
        self.close()
        counts = Counter(row.state for row in self._rows)
        worst = max(counts, key=list(State).index)
        which = _subjects([row for row in self._rows if row.state is worst])
        text = _ENDS[worst].format(n=len(self._rows), k=counts[worst], which=which)
        self._console.print(Text(f"\n{text}", style=_STYLES[worst]), soft_wrap=True)
        return exit_code(self._rows)


class JsonTable:
    """Prints everything as one JSON object.

    Parameters
    ----------
    found : FoundDescription
    """

    def __init__(self, found: FoundDescription) -> None:
        self._found = found
        self._rows: list[Row] = []
        self._hearing: Hearing | None = None

    def add(self, finding: Finding) -> None:
        """Keep a row, or the table of what each channel heard."""
        if isinstance(finding, Hearing):
            self._hearing = finding
        elif isinstance(finding, Row):
            self._rows.append(finding)

    def close(self) -> None:
        """Do nothing: what is not whole is not printed."""

    def end(self) -> int:
        """Print it all and return the exit code."""
        code = exit_code(self._rows)
        said = {
            "rig": self._found.description.name,
            "from": self._found.where,
            "exit_code": code,
            "rows": [_as_json(row) for row in self._rows],
            "hearing": None if self._hearing is None else _hearing_as_json(self._hearing),
        }
        click.echo(json.dumps(said, indent=2, allow_nan=False))
        return code


def hearing_table(hearing: Hearing) -> Table:
    """Draw level and signal-to-noise ratio of each channel and buzzer; a dash where it is not heard."""
    table = Table(box=None, padding=(0, 1), collapse_padding=True)
    table.add_column("channel", justify="right", style="dim", width=_CHANNEL_WIDTH)
    table.add_column("noise", justify="right", style="dim", no_wrap=True)
    for buzzer in hearing.buzzers:
        table.add_column(
            f"buzzer {buzzer}" if len(hearing.buzzers) <= _NAMED else f"bz {buzzer}", justify="right", no_wrap=True
        )
    for column, channel in enumerate(hearing.channels):
        cells = [_cell(hearing, column, k) for k in range(len(hearing.buzzers))]
        noise_dbfs = hearing.noise_dbfs[column]
        table.add_row(str(channel), f"{noise_dbfs:.0f}" if noise_dbfs > SILENCE_DBFS else "none", *cells)
    return table


def _subjects(rows: Sequence[Row]) -> str:
    """List what rows are about; of many the first."""
    more = [f"{len(rows) - _NAMED_ROWS} more"] if len(rows) > _NAMED_ROWS else []
    return ", ".join([*(row.subject for row in rows[:_NAMED_ROWS]), *more])


def _cell(hearing: Hearing, column: int, k: int) -> Text:
    if hearing.clipped[column, k]:
        return Text("clip", style=_STYLES[State.BAD])
    if not hearing.heard()[column, k]:
        return Text("-", style=_STYLES[State.BAD])
    snr_db = hearing.snr_db[column, k]
    state = State.OK if snr_db >= _QUIET_SNR_DB else State.LOOK if snr_db >= _NO_SNR_DB else State.BAD
    mark = {State.OK: "", State.LOOK: "?", State.BAD: "!"}[state]
    return Text(f"{hearing.level_dbfs[column, k]:.0f}/{snr_db:.0f}{mark}", style=_STYLES[state])


def _line(row: Row) -> Table:
    grid = Table.grid(padding=(0, 1))
    grid.add_column(width=6)
    grid.add_column(width=_SUBJECT_WIDTH, style="dim")
    grid.add_column(overflow="fold")
    grid.add_row(Text(f"  {row.state.value}", style=_STYLES[row.state]), row.subject, Text(row.finding))
    if row.remedy:
        grid.add_row("", "", Text.assemble(("do: ", "bold"), row.remedy))
    return grid


def _plain_line(row: Row) -> str:
    remedy = f"; do: {row.remedy}" if row.remedy else ""
    return f"  {row.state.value:<5}{row.subject:<{_SUBJECT_WIDTH + 1}}{row.finding}{remedy}"


def _as_json(row: Row) -> dict[str, object]:
    figures = {name: _number(value) for name, value in row.figures.items()}
    return asdict(row) | {"figures": figures, "exit_code": row.exit_code if row.state is State.BAD else 0}


def _hearing_as_json(hearing: Hearing) -> dict[str, object]:
    tables = {"level_dbfs": hearing.level_dbfs, "snr_db": hearing.snr_db, "onset_s": hearing.onset_s}
    return {
        "channels": hearing.channels,
        "buzzers": hearing.buzzers,
        "noise_dbfs": [_number(value) for value in hearing.noise_dbfs],
        "clipped": hearing.clipped.tolist(),
        **{name: [[_number(value) for value in line] for line in np.asarray(table)] for name, table in tables.items()},
    }


def _number(value: float) -> float | None:
    return round(float(value), 6) if math.isfinite(value) else None
