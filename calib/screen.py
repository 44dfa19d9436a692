"""What `rig-calibrate` shows in the terminal."""

from __future__ import annotations

from pathlib import Path

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from calib.evaluation import Evaluation
from calib.joint.next_pose import ONE_AFTER_ANOTHER
from calib.rejections import KINDS, Rejection
from calib.result import Calibration

NARROWEST = 76
VERDICTS = {"good": "bold green", "usable": "bold yellow", "do not use": "bold red"}
DELAYS_A_LINE = 3
WORST = 4  # of what was left out, told by name


def show(result: Calibration, path: Path, console: Console) -> None:
    """Print the microphones, how well they fit, and what to doubt."""
    console.width = max(console.width, NARROWEST)  # a number cut short would be worse than a wrapped line
    console.print(_microphone_table(result))
    console.print(_fit_table(result))
    console.print()
    if result.evaluation is not None:
        console.print(_evaluation_table(result.evaluation))
        console.print()
    for warning in result.warnings:
        console.print(_line("!", "bold yellow", warning))
    if result.suggestions:
        console.print(f"Board positions that would help most; {ONE_AFTER_ANOTHER}:")
    for number, suggestion in enumerate(result.suggestions, start=1):
        console.print(_line(f"{number}.", "bold", suggestion.sentence()))
    console.print(f"Written: {escape(str(path))}", soft_wrap=True, highlight=False)


def show_published(lines: list[str], console: Console) -> None:
    """Print the verdict, and what was written beside the result; its lines stay whole, so that names can be copied."""
    for line in lines:
        style = next((style for level, style in VERDICTS.items() if line.startswith(f"Verdict: {level}.")), "")
        console.print(Text(line, style), soft_wrap=not style)


def _microphone_table(result: Calibration) -> Table:
    table = Table(
        title="Microphones, camera frame (x right, y down, z forward), mm",
        title_justify="left",
        box=box.SIMPLE_HEAD,
    )
    table.add_column("channel", justify="right")
    for axis in "xyz":
        table.add_column(axis, justify="right")
        table.add_column(f"std {axis}", justify="right", style="cyan")
    table.add_column("weakest", justify="right", style="bold cyan")
    rows = zip(result.channels, result.positions_m, result.std_m, result.worst_std_m, strict=True)
    for channel, position_m, std_m, worst_m in rows:
        cells = [str(channel)]
        for value, std in zip(position_m, std_m, strict=True):
            cells += [f"{1e3 * value:+.2f}", f"{1e3 * std:.2f}"]
        table.add_row(*cells, f"{1e3 * float(worst_m):.2f}")
    return table


def _fit_table(result: Calibration) -> Table:
    residual, view = result.residual, result.view
    shares = [
        (share.name, f"{share.n_poses} poses, {share.speed_of_sound_m_s:.2f} m/s +- {share.speed_of_sound_std_m_s:.2f}")
        for share in result.sessions
    ]
    speed = f"{result.speed_of_sound_m_s:.2f} m/s"
    held = result.method != "joint" or "speed" in result.held
    speed += (
        f" held, known to +- {result.speed_of_sound_std_m_s:.2f}"
        if held
        else f" +- {result.speed_of_sound_std_m_s:.2f}"
    )
    total = residual.n_used + residual.n_rejected
    held_out = []
    if result.held_out is not None:
        checked = result.held_out
        words = f"{1e6 * checked.robust_sigma_s:.2f} us robust sigma, folds spread by {1e3 * checked.spread_m:.2f} mm"
        held_out = [("held-out poses", words)]
    measured = f"; measured by {result.sound['tdoa']}" if result.sound else ""
    focal = ", ".join(f"{value:.1f}" for value in view.intrinsics.focal_px)
    return _pairs_table(
        [
            ("method", result.method + (f", {', '.join(result.held)} held" if result.held else "")),
            (
                "TDOA residual",
                f"{1e6 * residual.robust_sigma_s:.2f} us robust sigma, {1e6 * residual.rms_s:.2f} us rms",
            ),
            *held_out,
            ("TDOAs used", f"{residual.n_used} of {total}, {residual.n_rejected} rejected{measured}"),
            *_left_out(result.rejections),
            *(shares or [("speed of sound", speed)]),
            *_delays(result),
            ("camera", f"focal length {focal} px, from the {view.source}"),
            ("board", f"{len(view.board_to_camera)} poses, corners fit to {view.rms_px:.3f} px rms"),
        ]
    )


def _delays(result: Calibration) -> list[tuple[str, str]]:
    """Return how late each channel is after the first one, a line per session."""
    if result.delays is None:
        return []
    first, *others = result.channels
    names = [f"{share.name}: " for share in result.sessions] or [""]
    lines = []
    for name, delays_s, stds_s in zip(names, result.delays.delay_s, result.delays.std_s, strict=True):
        lines.append(f"{name}after channel {first}, in us")
        after = [
            f"{channel}: {1e6 * delay_s:+.2f} +- {1e6 * std_s:.2f}"
            for channel, delay_s, std_s in zip(others, delays_s[1:], stds_s[1:], strict=True)
        ]
        lines += [", ".join(after[row : row + DELAYS_A_LINE]) for row in range(0, len(after), DELAYS_A_LINE)]
    return [("delays of channels", escape("\n".join(lines)))]


def _left_out(rejections: tuple[Rejection, ...]) -> list[tuple[str, str]]:
    """Return how many of each kind were left out, and the worst few."""
    if not rejections:
        return []
    counts = [(kind, sum(rejection.kind == kind for rejection in rejections)) for kind in KINDS]
    counted = ", ".join(f"{n} {kind}{'s' if n > 1 else ''}" for kind, n in counts if n)
    worst = sorted(rejections, key=lambda rejection: (KINDS.index(rejection.kind), -rejection.sigmas))[:WORST]
    more = len(rejections) - len(worst)
    lines = [counted, *(rejection.sentence() for rejection in worst), *([f"{more} more in the file"] if more else [])]
    return [("left out", escape("\n".join(lines)))]


def _evaluation_table(evaluation: Evaluation) -> Table:
    rows = [
        ("truth", evaluation.truth),
        ("RMSE, all microphones", f"{1e3 * evaluation.rmse_m:.2f} mm in the camera frame"),
        (
            "after rigid alignment",
            f"{1e3 * evaluation.rmse_aligned_m:.2f} mm, turned by {evaluation.rotation_deg:.1f} degrees",
        ),
        ("distances", f"{1e3 * evaluation.distance_rmse_m:.2f} mm between microphones"),
    ]
    if evaluation.paper_rmse_m is not None:
        rows.append(("paper's figure", f"{1e3 * evaluation.paper_rmse_m:.2f} mm (microphones 1 to 7 summed, over 8)"))
    table = _pairs_table(rows)
    table.title, table.title_justify = "Against the truth in the session", "left"
    return table


def _line(mark: str, style: str, text: str) -> Table:
    line = Table.grid(padding=(0, 1))
    line.add_row(Text(mark, style=style), Text(text))
    return line


def _pairs_table(rows: list[tuple[str, str]]) -> Table:
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 1))
    table.add_column(style="dim")
    table.add_column()
    for name, value in rows:
        table.add_row(name, value)
    return table
