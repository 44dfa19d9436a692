"""The command line `rig-check`: tell whether everything is ready for a session."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import click

from rigs.command import leave, run


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="acoustic-camera-rig")
@click.option("--rig", metavar="PATH|NAME", help="Rig description: a YAML file, or the name of a shipped rig.")
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), help="Of the simulated rig, instead of the description's.")
@click.option("--json", "as_json", is_flag=True, help="Print the same for a machine, when all is done.")
def cli(rig: str | None, seed: int | None, as_json: bool) -> int:
    """Check the bench before a session: put the board where the camera sees it, and keep quiet for ten seconds.

    Opens every device, looks at a picture, fires each buzzer once, and says of each thing: ok, look (it may cost
    quality), or bad (mend it first), with what to do. Run it in the folder where the session will be recorded; nothing
    is kept. The description is looked for as rig-capture does.

    Exit code: 0 nothing bad, 2 wrong usage or description, 3 a device is missing or was lost, 4 wrong firmware,
    5 something measured is bad, 130 ended by Ctrl-C.
    """
    from rich.console import Console  # these, OpenCV and pydantic would slow down --help

    from acquire.doctor.checkup import check_up
    from acquire.doctor.table import JsonTable, LiveTable
    from rigs.library import find_description

    found = find_description(rig)
    table = JsonTable(found) if as_json else LiveTable(found, Console(highlight=False))
    with closing(table):
        for finding in check_up(found.description, Path.cwd(), seed=seed):
            table.add(finding)
        return table.end()


def main() -> None:
    """Run `rig-check`."""
    leave(run("rig-check", cli))
