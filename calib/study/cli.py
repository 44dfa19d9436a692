"""`rig-study`: the paper's tables and figures, and any other study, beside the physical limit."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rigs.command import run

if TYPE_CHECKING:
    from rich.console import Console

    from calib.study.published import Published
    from calib.study.workers import Workers

ITEMS = ("table1", "table2", "table3", "fig3", "fig4")
PROTOCOLS = ("as-published", "as-written")
QUICK_HELP = (
    "One repetition of each combination, of three of its numbers of poses at most (the smallest, the largest and one "
    "between): to see that it runs."
)
NEEDED = ("pyarrow", "distributed", "matplotlib")


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("what", metavar="table1|table2|table3|fig3|fig4|all|FILE.yaml")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder of the results."
)
@click.option(
    "--protocol", type=click.Choice(PROTOCOLS), help="Of the paper's items: how its tables were made, or how its text "
    "has it [default: both].",
)  # fmt: skip
@click.option("--quick", is_flag=True, help=QUICK_HELP)
@click.option(
    "--published",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder of the paper's published files (a clone of AISLAB-sustech/AcousticCamera).",
)
@click.option(
    "--workers",
    type=click.IntRange(1, 1024),
    help="Processes on this machine, not with --cluster [default: one per core].",
)
@click.option("--cluster", metavar="tcp://HOST:PORT", help="A Dask scheduler whose workers compute.")
@click.version_option(package_name="acoustic-camera-rig")
def command(
    what: str,
    output: Path,
    protocol: str | None,
    quick: bool,
    published: Path | None,
    workers: int | None,
    cluster: str | None,
) -> None:
    """Run the paper's table or figure, all of them, or the study in FILE.yaml.

    Each study gets a folder of its own in the output folder. Run the same command again to go on with what was
    interrupted; finished parts are never computed again. Exit codes: 0 good, 2 usage, a wrong study or a folder of
    another study, 3 the cluster or the disk is lost, 5 published files missing or damaged, 130 interrupted.
    """
    _check_extra()
    from rich.console import Console

    from calib.study.paper import make_items
    from calib.study.published import read_published
    from calib.study.workers import Workers

    if cluster is not None and workers is not None:
        raise click.UsageError("--workers counts processes on this machine: leave it out with --cluster")
    who = Workers(Workers.of_machine().number if workers is None else workers, cluster)
    if protocol is not None and what not in (*ITEMS, "all"):
        raise click.UsageError(f"--protocol goes with {', '.join(ITEMS)} and all only: leave it out with {what}")
    console, files = Console(), read_published(published)
    if what not in (*ITEMS, "all"):
        _own_study(what, output, quick, files, who, console)
        return
    items = ITEMS if what == "all" else (what,)
    make_items(
        items, (protocol,) if protocol else PROTOCOLS, output, quick, files, who, console, all_of_them=what == "all"
    )


def _own_study(what: str, output: Path, quick: bool, published: Published, workers: Workers, console: Console) -> None:
    from calib.study.library import find_study, shipped_studies
    from calib.study.pages import remarks
    from calib.study.paper import STUDY_OF, finish
    from calib.study.run import run_study

    study = find_study(what, also=(*ITEMS, "all"))
    finished = run_study(study, output / study.name, published, workers, console, quick=quick)
    for remark in remarks(finished):
        console.print(f"! {remark}", soft_wrap=True)
    finish(finished, console, STUDY_OF[what.partition("-")[0]] if what in shipped_studies() else None)


def _check_extra() -> None:
    from calib.study.errors import StudyError

    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise StudyError(f"{' and '.join(missing)} missing: pip install 'acoustic-camera-rig[study]'")


def main() -> int:
    """Run the command; errors become one line and an exit code."""
    return run("rig-study", command)
