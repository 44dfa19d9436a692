"""`rig-calibrate`: a session file in, microphone positions out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from rigs.command import run
from rigs.target import session_files

METHODS = ("joint", "ours-1", "ours-2", "ours-3")
WITH_EXPORT = {"files", "output", "overwrite", "export", "report"}  # what goes with a result in place of a session
WITH_COMPARE = {"files", "compare"}
BLOCKS = ("speed", "buzzers", "scale", "corners", "intrinsics", "poses")


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument(
    "files", nargs=-1, required=True, metavar="SESSION...", type=click.Path(path_type=Path), callback=session_files
)
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
    help="Joint holds this at what the rig description, or a fit to the corners alone, says, and takes it to be as "
    "uncertain as that is (may be repeated).",
)
@click.option(
    "--exact",
    type=click.Choice(BLOCKS),
    multiple=True,
    help="Like --hold, but taken to be without any error: only if you know it to be (may be repeated).",
)
@click.option("--find-delays", is_flag=True, help="Joint finds a constant delay of each channel too.")
@click.option(
    "--ignore-sync", is_flag=True, help="Joint makes no use of the board's sync output, where a channel recorded it."
)
@click.option(
    "--suggest-poses",
    type=click.IntRange(0, 50),
    default=0,
    metavar="N",
    help="Say which N board positions would help most.",
)
@click.option(
    "--follow",
    is_flag=True,
    help="Solve again with every pose that is being captured; prints a line of JSON each time.",
)
@click.option(
    "--each",
    is_flag=True,
    help="Calibrate each session by itself, all cores at once; a result each, no report, and a table (-o) "
    "[calibrations.csv].",
)
@click.option(
    "--cluster",
    metavar="tcp://HOST:PORT",
    help="Like --each, on the workers of a Dask scheduler that see the same files.",
)
@click.option("--compare", is_flag=True, help="Tell whether two results (not sessions) differ, and what moved.")
@click.option("--report/--no-report", default=True, show_default=True, help="Write SESSION.report.html, for people.")
@click.option("--plots", type=click.Choice(("png", "svg")), help="Write the report's plots as files, too.")
@click.option(
    "--export",
    metavar="NAMES",
    help="Write files for other tools: all, or some of acoular, pyroomacoustics, odas, ros2, urdf, kalibr, matlab, "
    "csv, json, with commas between. With a result (SESSION.calib.yaml) in place of SESSION, without solving again.",
)
@click.version_option(package_name="acoustic-camera-rig")
def command(**asked: Any) -> int:
    """Find every microphone of SESSION in the camera frame, each with its standard deviation.

    Several sessions of one rig are solved together. Writes SESSION.calib.yaml and SESSION.report.html beside the
    (first) session, of several SESSION+SESSION.calib.yaml; sessions themselves are never changed. Exit codes: 0 good,
    2 usage, 3 the scheduler of --cluster is not there or lost, 5 data missing, damaged or not good enough, or two
    results that differ (--compare), 130 interrupted.
    """
    from rich.console import Console  # heavy parts are imported only when there is work to do

    from calib.request import Request
    from calib.tasks import task_of

    request = Request(**asked)
    if request.compare or request.names_result:
        _check_of_results(WITH_COMPARE if request.compare else WITH_EXPORT)
    return task_of(request)(request, Console())


def _check_of_results(allowed: set[str]) -> None:
    """Refuse options that need a session where results stand in its place."""
    from calib.errors import MethodError

    context = click.get_current_context()
    for option in context.command.params:
        assert option.name is not None
        is_given = context.get_parameter_source(option.name) is click.core.ParameterSource.COMMANDLINE
        if is_given and option.name not in allowed:
            raise MethodError(f"{option.opts[-1]} does nothing with a result: leave it out, or name the session")


def main() -> int:
    """Run the command; errors become one line and an exit code."""
    return run("rig-calibrate", command)
