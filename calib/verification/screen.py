"""What `rig-verify` shows in the terminal."""

from __future__ import annotations

from collections.abc import Iterator
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
    for line in _movement(verification):
        console.print(line)
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
    movement, limit_m = verification.movement, verification.verdict.limits.moved_m
    if movement.unseen(limit_m):
        return ""
    checked = f"none of the {len(movement.resolutions_m)} microphones checked" if verification.unchecked else "nothing"
    return f", and {checked} has moved by more than {1e3 * limit_m:g} mm"


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


def _movement(verification: Verification) -> Iterator[Table]:
    """Say what no verdict has said: what is not told, what moved a little, what would show, who was not asked."""
    movement, limit_m = verification.movement, verification.verdict.limits.moved_m
    if untold := movement.unseen(limit_m):
        yield _line("?", "bold yellow", f"whether the array has moved since is not told: {untold}")
    slight = [motion.sentence() for motion in movement.motions if motion not in verification.verdict.alarms]
    if slight and not movement.is_foreign(limit_m):
        yield _line("!", "bold yellow", f"moved, but by less than {1e3 * limit_m:g} mm: {'; '.join(slight)}")
    if movement.resolutions_m and not movement.is_foreign(limit_m):
        yield _line("", "", _shows_from(movement.resolutions_m))
    if verification.unchecked:
        yield _line("!", "bold yellow", _unchecked(verification.unchecked))


def _shows_from(resolutions_m: dict[int, float]) -> str:
    """Say from where on a motion shows, for the microphones that show it best and worst."""
    best, worst = (choose(resolutions_m, key=lambda channel: resolutions_m[channel]) for choose in (min, max))
    return (
        f"a microphone that moved alone would show from {1e3 * resolutions_m[best]:.2g} mm (microphone {best}) to "
        f"{1e3 * resolutions_m[worst]:.2g} mm (microphone {worst}) on, in the direction that shows least"
    )


def _unchecked(channels: list[int]) -> str:
    names = ", ".join(map(str, channels))
    return (
        f"channel {names}: not checked, as the calibration lacks it or it heard nothing"
        if len(channels) == 1
        else f"channels {names}: not checked, as the calibration lacks them or they heard nothing"
    )


def _line(sign: str, style: str, text: str) -> Table:
    line = Table.grid(padding=(0, 1))
    line.add_row(Text(sign, style=style), Text(text))
    return line
