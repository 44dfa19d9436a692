"""The tasks of `rig-calibrate`, a function each; what only one of them needs is imported there."""

from __future__ import annotations

import json
import os
import shlex
import sys
from collections.abc import Callable
from contextlib import ExitStack

import click
from rich.console import Console

from calib.errors import MethodError
from calib.pipeline import calibrate, calibrate_together
from calib.request import Request
from calib.result_file import read_result
from calib.result_writer import check_result_target
from calib.screen import show, show_published
from rigs.errors import TargetExistsError
from rigs.session.reader import Session

GOOD = 0
DIFFER = 5  # the exit code where two results do
NOT_ALL_GOOD = 5  # of the sessions of --each

Task = Callable[[Request, Console], int]


def task_of(request: Request) -> Task:
    """Return what was asked for; a task returns the exit code."""
    if request.compare:
        return compare_results
    if request.names_result:
        return export_result
    if request.inspect_tdoa is not None:
        return inspect_emission
    if request.one_by_one:
        return calibrate_one_by_one
    return calibrate_growing if request.follow else calibrate_sessions


def calibrate_sessions(request: Request, console: Console) -> int:
    """Solve one session, or several together."""
    publication, settings = request.publication, request.settings
    _check_targets(request)
    with ExitStack() as stack:
        status = stack.enter_context(console.status("opening"))
        sessions = [stack.enter_context(Session.open(file)) for file in request.files]

        def tell(step: str) -> None:
            status.update(f"{step} ...")

        together = len(sessions) > 1
        result = calibrate_together(sessions, settings, tell) if together else calibrate(sessions[0], settings, tell)
        tell("writing the result and what stands beside it")
        published = publication.publish(sessions, result, settings, with_result=True)
    show(result, publication.target, console)
    show_published(published, console)
    return GOOD


def _check_targets(request: Request) -> None:
    """Refuse what is there already; who wants exports only is told how to have them of the result that is there."""
    publication = request.publication
    try:
        check_result_target(publication.target, overwrite=request.overwrite)
    except TargetExistsError as error:
        if not publication.formats:
            raise
        command = shlex.join(["rig-calibrate", str(publication.target), "--export", ",".join(publication.formats)])
        raise TargetExistsError(f"{error}, or export from it without solving again: {command}") from error
    publication.check()


def calibrate_growing(request: Request, _: Console) -> int:
    """Solve a session again with every pose that is being captured."""
    from calib.follow import follow

    publication, settings = request.publication, request.settings
    publication.check()
    result = follow(request.file, publication.target, settings, _say, overwrite=request.overwrite)
    if result is not None:
        with Session.open(request.file) as session:
            publication.publish([session], result, settings)
    return GOOD


def calibrate_one_by_one(request: Request, console: Console) -> int:
    """Solve each session by itself; not all good where one has no result."""
    from calib.study.fleet import SUMMARY, calibrate_each, show_fleet
    from calib.study.workers import Workers, check_distributed

    check_distributed()
    table = request.output or request.file.with_name(SUMMARY)
    workers = Workers(Workers.of_machine().number, request.cluster)
    rows = calibrate_each(request.files, request.settings, workers, table, overwrite=request.overwrite, console=console)
    show_fleet(rows, table, console)
    return GOOD if all(row.is_good for row in rows) else NOT_ALL_GOOD


def export_result(request: Request, console: Console) -> int:
    """Write a result for other tools, without solving again."""
    if len(request.files) > 1:
        raise MethodError(f"{request.file}: a result: name one of them, or two with --compare")
    publication = request.publication
    if not publication.formats:
        raise MethodError(f"{request.file}: a result, not a session: name its session, or what to --export from it")
    publication.check()
    show_published(publication.export_only(read_result(request.file)), console)
    return GOOD


def compare_results(request: Request, console: Console) -> int:
    """Tell whether two results differ."""
    from calib.comparison import compare
    from calib.comparison_screen import show_comparison

    comparison = compare(*(read_result(file) for file in request.files))
    show_comparison(comparison, console)
    return DIFFER if comparison.differ else GOOD


def inspect_emission(request: Request, console: Console) -> int:
    """Plot how the arrivals of one emission were measured."""
    from calib.inspection import draw, inspect, plot_path, show_view

    number = request.inspect_tdoa
    assert number is not None
    with Session.open(request.file) as session, console.status("listening"):
        target = plot_path(request.file, number, request.output)
        view = inspect(session, number, request.tdoa)
        draw(view, target)
    show_view(view, target, console)
    return GOOD


def _say(progress: dict[str, object]) -> None:
    try:
        click.echo(json.dumps(progress))
    except BrokenPipeError:  # nobody reads any more; the result is still wanted
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
