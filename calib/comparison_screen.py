"""What `rig-calibrate --compare` shows in the terminal."""

from __future__ import annotations

import numpy as np
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from calib.comparison import FALSE_ALARM, ChiSquare, Comparison, Fit, contradiction_of, swapped_rows

LEAST_CHANCE = 1e-9


def show_comparison(comparison: Comparison, console: Console) -> None:
    """Print the shifts, how likely they are, and a verdict in one line."""
    console.print(_shift_table(comparison))
    console.print(_chance_table(comparison))
    console.print()
    if comparison.share_sessions:
        console.print(
            "[bold yellow]![/bold yellow] both rest on the same session: they share its errors, so that they should "
            "agree better than this test asks"
        )
    style = "bold red" if comparison.differ else "bold green"
    console.print(f"[{style}]{escape(verdict(comparison))}[/{style}]", soft_wrap=True)


def verdict(comparison: Comparison) -> str:
    """Say in one line whether the results differ, and what moved."""
    if not comparison.differ:
        return "the results agree within their uncertainties"
    if contradiction := contradiction_of(comparison):
        return (
            "the results differ: they look like those of two different rigs, or most microphones have moved by "
            f"themselves: {contradiction}"
        )
    best, channels, swapped = comparison.best, comparison.first.channels, swapped_rows(comparison)
    found = [
        f"channels {channels[first]} and {channels[second]} look swapped: check the plugs" for first, second in swapped
    ]
    if best.motion is not None:
        how_far = f"{1e3 * best.distance_m:.1f} mm, {best.angle_deg:.2f} degrees"
        found.append(f"the array as a whole moved against the camera by {how_far}")
    found += [
        f"the microphone of channel {channels[row]} moved by {1e3 * np.linalg.norm(best.own_shift_m(row)):.1f} mm"
        for row in best.moved
        if row not in {row for pair in swapped for row in pair}
    ]
    return f"the results differ: {'; '.join(found)}"


def _shift_table(comparison: Comparison) -> Table:
    names = f"{comparison.first.name} to {comparison.second.name}"
    title = f"Shifts of the microphones from {escape(names)}, camera frame, mm"
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for heading in ("channel", "x", "y", "z", "length", "std", "chance", "in shape", "chance"):
        table.add_column(heading, justify="right", no_wrap=True)
    rows = zip(
        comparison.first.channels, *(_cells(comparison, fit) for fit in (comparison.unmoved, comparison.rigid)),
        strict=True,
    )  # fmt: skip
    for channel, (coordinates, length, std, chance), (_, own_length, _, own_chance) in rows:
        table.add_row(str(channel), *coordinates, length, std, chance, own_length, own_chance)
    return table


def _cells(comparison: Comparison, fit: Fit) -> list[tuple[list[str], str, str, str]]:
    cells = []
    for row, chi_square in enumerate(comparison.microphone_chi_squares(fit)):
        shift_mm = 1e3 * fit.shifts_m[row]
        block = fit.shift_covariance_m2[3 * row : 3 * row + 3, 3 * row : 3 * row + 3]
        std_mm = 1e3 * float(np.sqrt(np.trace(block)))
        coordinates = [f"{value:+.2f}" for value in shift_mm]
        cells.append((coordinates, f"{np.linalg.norm(shift_mm):.2f}", f"{std_mm:.2f}", _chance(chi_square)))
    return cells


def _chance_table(comparison: Comparison) -> Table:
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 1))
    table.add_column(style="dim")
    table.add_column()
    shape = f"in shape{', without what moved' if comparison.rigid.moved else ''}"
    for name, fit in (("all shifts", comparison.unmoved), (shape, comparison.rigid)):
        square = fit.chi_square
        table.add_row(name, f"chi-square {square.value:.1f}, expected {square.n_free}; chance {_chance(square)}")
    rigid = comparison.rigid
    table.add_row(
        "of the whole array", f"{1e3 * rigid.distance_m:.2f} mm, {rigid.angle_deg:.3f} degrees, the rest is in shape"
    )
    table.add_row("false alarms", f"{FALSE_ALARM:.0%} of arrays that did not change")
    return table


def _chance(chi_square: ChiSquare) -> str:
    chance = chi_square.chance
    if chance < LEAST_CHANCE:
        return f"<{LEAST_CHANCE:.0e}".replace("e-0", "e-")
    return f"{chance:.2f}" if chance >= 0.01 else f"{chance:.0e}".replace("e-0", "e-")
