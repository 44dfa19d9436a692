"""`rig-calibrate`: a session file in, microphone positions out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from rigs.command import run

if TYPE_CHECKING:
    from rich.console import Console

    from calib.settings import Method
    from calib.sound import TdoaMode

METHODS = ("joint", "ours-1", "ours-2", "ours-3")
BLOCKS = ("speed", "buzzers", "scale", "intrinsics", "poses")


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("session", type=click.Path(path_type=Path))
@click.option(
    "--method",
    type=click.Choice(METHODS),
    default="joint",
    show_default=True,
    help="joint: robust, reference-free, needs no first guess. ours-1, -2, -3: the paper's, by Gauss-Newton.",
)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Result file [default: SESSION.calib.yaml].")
@click.option("--overwrite", is_flag=True, help="Replace the result file if it is there.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of random first guesses.")
@click.option(
    "--tdoa",
    type=click.Choice(("auto", "matched", "gcc-phat")),
    default="auto",
    show_default=True,
    help="How arrivals are measured: matched to the known waveform, or by GCC-PHAT, which needs to know none.",
)
@click.option(
    "--inspect-tdoa",
    type=click.IntRange(0),
    metavar="EMISSION",
    help="Plot this emission (numbered from 0) with its correlations, and do nothing else. -o may name a .png or .svg.",
)
@click.option("--reference", type=int, metavar="CHANNEL", help="Reference microphone of ours-1 [default: the first].")
@click.option(
    "--exclude-channel", type=int, multiple=True, metavar="CHANNEL", help="Leave a microphone out (may be repeated)."
)
@click.option(
    "--hold",
    type=click.Choice(BLOCKS),
    multiple=True,
    help="Joint holds this at what the rig description, or a fit to the corners alone, says (may be repeated).",
)
@click.option("--find-delays", is_flag=True, help="Joint finds a constant delay of each channel too.")
@click.option(
    "--suggest-poses",
    type=click.IntRange(0, 50),
    default=0,
    metavar="N",
    help="Say which N board positions would help most.",
)
@click.option("--report/--no-report", default=True, show_default=True, help="Write SESSION.report.html, for people.")
@click.option("--plots", type=click.Choice(("png", "svg")), help="Write the report's plots as files, too.")
@click.option(
    "--export",
    metavar="NAMES",
    help="Write files for other tools: all, or some of acoular,pyroomacoustics,odas,ros2,urdf,kalibr,matlab,csv,json. "
    "With a result (SESSION.calib.yaml) in place of SESSION, without solving again.",
)
@click.version_option(package_name="acoustic-camera-rig")
def command(
    session: Path,
    method: Method,
    output: Path | None,
    overwrite: bool,
    seed: int,
    tdoa: TdoaMode,
    inspect_tdoa: int | None,
    reference: int | None,
    exclude_channel: tuple[int, ...],
    hold: tuple[str, ...],
    find_delays: bool,
    suggest_poses: int,
    report: bool,
    plots: str | None,
    export: str | None,
) -> None:
    """Find every microphone of SESSION in the camera frame, each with its standard deviation.

    Writes SESSION.calib.yaml and SESSION.report.html beside the session, which itself is never changed. Exit codes:
    0 good, 2 usage, 5 data missing, damaged or not good enough, 130 interrupted.
    """
    from rich.console import Console  # heavy parts are imported only when there is work to do

    from calib.export.formats import chosen_formats
    from calib.pipeline import calibrate
    from calib.publication import Publication
    from calib.result import check_result_target, write_calibration
    from calib.screen import show
    from calib.settings import Settings
    from rigs.session.reader import Session

    console = Console()
    if inspect_tdoa is not None:
        _inspect(session, inspect_tdoa, tdoa, output, console)
        return
    formats = chosen_formats(export)
    if session.suffix in {".yaml", ".yml"}:
        _export(session, output, overwrite, formats, console)
        return
    target = output or session.with_suffix(".calib.yaml")
    publication = Publication(target, overwrite, report, plots, formats)
    with Session.open(session) as opened, console.status("opening") as status:
        check_result_target(target, overwrite=overwrite)
        publication.check()
        settings = Settings(method, seed, reference, exclude_channel, tdoa, hold, find_delays, suggest_poses)
        result = calibrate(opened, settings, lambda step: status.update(f"{session.name}: {step} ..."))
        write_calibration(result, target, overwrite=overwrite)
        status.update(f"{session.name}: writing what stands beside the result ...")
        published = publication.publish(opened, result, settings)
    show(result, target, console)
    for line in published:
        console.print(line, soft_wrap=True, markup=False, highlight=False)


def _export(result: Path, output: Path | None, overwrite: bool, formats: tuple[str, ...], console: Console) -> None:
    from calib.errors import MethodError
    from calib.export.stored import read_array
    from calib.publication import Publication

    if not formats:
        raise MethodError(f"{result}: a result, not a session: name its session, or what to --export from it")
    publication = Publication(output or result, overwrite, report=False, formats=formats)
    publication.check()
    for line in publication.export_only(read_array(result)):
        console.print(line, soft_wrap=True, markup=False, highlight=False)


def _inspect(path: Path, number: int, tdoa: TdoaMode, output: Path | None, console: Console) -> None:
    from calib.inspection import draw, inspect, plot_path, show_view
    from rigs.session.reader import Session

    with Session.open(path) as opened, console.status("listening"):
        target = plot_path(path, number, output)
        view = inspect(opened, number, tdoa)
        draw(view, target)
    show_view(view, target, console)


def main() -> int:
    """Run the command; errors become one line and an exit code."""
    return run("rig-calibrate", command)
