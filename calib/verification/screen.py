"""What `rig-verify` shows in the terminal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from calib.verification.folder import FILM
from calib.verification.pipeline import Verification
from calib.verification.statistics import Spread, spreads

NARROWEST = 76
WORDS = {
    "picture_px": ("in the picture", "px", 1.0, 2),
    "bearing_deg": ("angle at the camera", "deg", 1.0, 3),
    "space_m": ("in space", "mm", 1e3, 2),
    "across_m": ("across the view", "mm", 1e3, 2),
    "space_m_per_m": ("in space per metre", "mm", 1e3, 2),
    "steered_px": ("map's highest", "px", 1.0, 2),
}


def show(verification: Verification, folder: Path, codec: str | None, console: Console) -> None:
    """Print the verdict first, then the errors, what moved, and where the pictures are."""
    console.width = max(console.width, NARROWEST)
    _show_verdict(verification, console)
    console.print(_origin(verification), soft_wrap=False)
    console.print(_error_table(verification))
    console.print(_movement(verification))
    for warning in verification.warnings:
        console.print(_line("!", "bold yellow", warning))
    film = f", film {FILM} ({codec})" if codec else ""
    console.print(f"[bold]Written:[/bold] {escape(str(folder))}{film}", soft_wrap=True, highlight=False)


def _show_verdict(verification: Verification, console: Console) -> None:
    verdict = verification.verdict
    if verdict.passed:
        words = f"sounds lie on their buzzers, within {verdict.limits.error_deg:g} degrees in the median"
        console.print(_line("PASS", "bold green", words + _unmoved(verification)))
    for failure in verdict.failures:
        console.print(_line("FAIL", "bold red", failure))


def _unmoved(verification: Verification) -> str:
    if verification.movement.doubt:
        return ""
    if verification.movement.motions:
        return f", and nothing has moved by more than {1e3 * verification.verdict.limits.moved_m:g} mm"
    return ", and the array has not moved"


def _origin(verification: Verification) -> Text:
    n_poses, calibration = len(np.unique(verification.pose)), verification.calibration
    words = (
        f"{verification.located.found.sum()} of {len(verification.row)} sounds located, at {n_poses} "
        f"{'pose' if n_poses == 1 else 'poses'} that the calibration has not used"
    )
    if verification.made_again:
        words += (
            f": it was made from this very session, so it was made again ({calibration.method}) from the other poses"
        )
    return Text(words)


def _error_table(verification: Verification) -> Table:
    table = Table(title="Sound against picture", title_justify="left", box=box.SIMPLE_HEAD)
    table.add_column("error")
    for name in ("median", "rms", "95 %", "largest", "expected rms"):
        table.add_column(name, justify="right", style="bold" if name == "median" else "")
    for spread in spreads(verification):
        table.add_row(*_cells(spread))
    return table


def _cells(spread: Spread) -> list[str]:
    words, unit, factor, digits = WORDS[spread.name]
    values = (spread.median, spread.rms, spread.percentile_95, spread.largest, spread.expected_rms)
    return [
        f"{words}, {unit}",
        *("" if value is None else f"{factor * value:.{digits}f}" for value in values),
    ]


def _movement(verification: Verification) -> Table:
    movement, limit_mm = verification.movement, 1e3 * verification.verdict.limits.moved_m
    if movement.doubt:
        return _line("?", "bold yellow", f"whether the array has moved since is not told: {movement.doubt}")
    resolved = f"a microphone that moved alone would show from {1e3 * movement.resolution_m:.1f} mm on"
    slight = [motion.sentence() for motion in movement.motions if motion not in verification.verdict.alarms]
    if slight:
        return _line("!", "bold yellow", f"moved, but by less than {limit_mm:g} mm: {'; '.join(slight)}")
    if verification.verdict.alarms:
        return _line("", "", resolved)
    return _line("", "", f"no microphone has moved; {resolved}")


def _line(sign: str, style: str, text: str) -> Table:
    line = Table.grid(padding=(0, 1))
    line.add_row(Text(sign, style=style), Text(text))
    return line
