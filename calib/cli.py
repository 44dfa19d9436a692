"""`rig-calibrate`: a session file in, microphone positions out."""

from __future__ import annotations

import os
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rigs.command import run
from rigs.target import session_files

if TYPE_CHECKING:
    from rich.console import Console

    from calib.publication import Publication
    from calib.settings import Block, Method, Settings
    from calib.sound import TdoaMode

METHODS = ("joint", "ours-1", "ours-2", "ours-3")
DIFFER = 5  # the exit code where two results do
NOT_ALL_GOOD = 5  # of the sessions of --each
MOST_NAMES = 3  # of sessions, in the name of their result
RESULT_ENDINGS = {".yaml", ".yml"}
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
def command(
    files: tuple[Path, ...],
    method: Method,
    output: Path | None,
    overwrite: bool,
    seed: int,
    tdoa: TdoaMode,
    inspect_tdoa: int | None,
    reference: int | None,
    exclude_channel: tuple[int, ...],
    hold: tuple[Block, ...],
    exact: tuple[Block, ...],
    find_delays: bool,
    suggest_poses: int,
    ignore_sync: bool,
    follow: bool,
    each: bool,
    cluster: str | None,
    compare: bool,
    report: bool,
    plots: str | None,
    export: str | None,
) -> int | None:
    """Find every microphone of SESSION in the camera frame, each with its standard deviation.

    Several sessions of one rig are solved together. Writes SESSION.calib.yaml and SESSION.report.html beside the
    (first) session, of several SESSION+SESSION.calib.yaml; sessions themselves are never changed. Exit codes: 0 good,
    2 usage, 5 data missing, damaged or not good enough, or two results that differ (--compare), 130 interrupted.
    """
    from rich.console import Console  # heavy parts are imported only when there is work to do

    from calib.export.formats import chosen_formats
    from calib.pipeline import calibrate, calibrate_together
    from calib.publication import Publication
    from calib.result import check_result_target, write_calibration
    from calib.screen import show, show_published
    from calib.settings import Settings
    from rigs.session.reader import Session

    console = Console()
    if compare:
        _check_of_results(WITH_COMPARE)
        return _compare(files, console)
    session, each = files[0], each or cluster is not None
    _check_choices(files, one=follow or inspect_tdoa is not None, each=each)
    _check_extras(each=each, asked=bool(plots or export))
    if inspect_tdoa is not None:
        _inspect(session, inspect_tdoa, tdoa, output, console)
        return None
    formats = chosen_formats(export)
    if session.suffix in RESULT_ENDINGS:
        _check_of_results(WITH_EXPORT)
        _export(files, output, overwrite, formats, console)
        return None
    target = output or _result_path(files)
    settings = Settings(
        method, seed, reference, exclude_channel, tdoa, hold, find_delays, suggest_poses, ignore_sync, exact
    )
    if each:
        return _each(files, output, settings, cluster, console, overwrite=overwrite)
    publication = Publication(target, overwrite, report, plots, formats)
    if follow:
        _follow(session, settings, publication)
        return None
    check_result_target(target, overwrite=overwrite)
    publication.check()
    with ExitStack() as stack:
        status = stack.enter_context(console.status("opening"))
        sessions = [stack.enter_context(Session.open(file)) for file in files]

        def tell(step: str) -> None:
            status.update(f"{step} ...")

        together = len(sessions) > 1
        result = calibrate_together(sessions, settings, tell) if together else calibrate(sessions[0], settings, tell)
        write_calibration(result, target, overwrite=overwrite)
        tell("writing what stands beside the result")
        published = publication.publish(sessions, result, settings)
    show(result, target, console)
    show_published(published, console)
    return None


def _export(
    files: tuple[Path, ...], output: Path | None, overwrite: bool, formats: tuple[str, ...], console: Console
) -> None:
    from calib.errors import MethodError
    from calib.publication import Publication
    from calib.result_file import read_result
    from calib.screen import show_published

    result = files[0]
    if len(files) > 1:
        raise MethodError(f"{result}: a result: name one of them, or two with --compare")
    if not formats:
        raise MethodError(f"{result}: a result, not a session: name its session, or what to --export from it")
    publication = Publication(output or result, overwrite, report=False, formats=formats)
    publication.check()
    show_published(publication.export_only(read_result(result)), console)


def _check_choices(files: tuple[Path, ...], *, one: bool, each: bool) -> None:
    if one and (each or len(files) > 1):
        raise click.UsageError("--follow and --inspect-tdoa take one session")


def _check_extras(*, each: bool, asked: bool) -> None:
    if each and asked:
        raise click.UsageError(
            "--each and --cluster write results and their table: leave --plots to single sessions, and --export from a "
            "result afterwards (rig-calibrate SESSION.calib.yaml --export all)"
        )


def _check_of_results(allowed: set[str]) -> None:
    """Refuse options that need a session where results stand in its place."""
    from calib.errors import MethodError

    context = click.get_current_context()
    for option in context.command.params:
        assert option.name is not None
        is_given = context.get_parameter_source(option.name) is click.core.ParameterSource.COMMANDLINE
        if is_given and option.name not in allowed:
            raise MethodError(f"{option.opts[-1]} does nothing with a result: leave it out, or name the session")


def _result_path(sessions: tuple[Path, ...]) -> Path:
    """Return where the result goes if nothing else is asked for: beside the first session."""
    if len(sessions) > MOST_NAMES:
        name = f"{sessions[0].stem}+{len(sessions) - 1}-more"
    else:
        name = "+".join(session.stem for session in sessions)
    return sessions[0].parent / f"{name}.calib.yaml"  # a name may be empty: "." is refused later


def _follow(session: Path, settings: Settings, publication: Publication) -> None:
    import json

    from calib.follow import follow
    from rigs.session.reader import Session

    def say(progress: dict[str, object]) -> None:
        try:
            click.echo(json.dumps(progress))
        except BrokenPipeError:  # nobody reads any more; the result is still wanted
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())

    publication.check()
    result = follow(session, publication.target, settings, say, overwrite=publication.overwrite)
    if result is not None:
        with Session.open(session) as opened:
            publication.publish([opened], result, settings)


def _each(
    files: tuple[Path, ...],
    output: Path | None,
    settings: Settings,
    cluster: str | None,
    console: Console,
    *,
    overwrite: bool,
) -> int:
    """Return 0 where every session has a result, else 5."""
    from calib.study.fleet import SUMMARY, calibrate_each, show_fleet
    from calib.study.workers import Workers, check_distributed

    check_distributed()
    table = output or files[0].with_name(SUMMARY)
    workers = Workers(Workers.of_machine().number, cluster)
    rows = calibrate_each(files, settings, workers, table, overwrite=overwrite, console=console)
    show_fleet(rows, table, console)
    return 0 if all(row.is_good for row in rows) else NOT_ALL_GOOD


def _compare(files: tuple[Path, ...], console: Console) -> int:
    """Return 5 where the results differ, else 0."""
    from calib.comparison import compare
    from calib.comparison_screen import show_comparison
    from calib.result_file import read_result

    if len(files) != 2:
        raise click.UsageError(f"--compare takes two results, not {len(files)}: name two .calib.yaml files")
    comparison = compare(*(read_result(file) for file in files))
    show_comparison(comparison, console)
    return DIFFER if comparison.differ else 0


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
