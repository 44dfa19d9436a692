"""The command line `rig-session`: look into session files."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import click

from rigs.command import run
from rigs.session.aislab_command import import_group
from rigs.session.export_commands import audio, frames
from rigs.target import session_file


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="acoustic-camera-rig")
def cli() -> None:
    """Look into session files, take sound and pictures out, recover damaged ones, import published measurements."""


@cli.command()
@click.argument("file", type=click.Path(path_type=Path), callback=session_file)
@click.option("--verify", is_flag=True, help="Read everything and compare the checksums.")
@click.option("--emissions", is_flag=True, help="List every emission with its number, and whether it counts.")
def info(file: Path, verify: bool, emissions: bool) -> int:
    """Tell what the session FILE holds.

    Exit code: 0 good, 2 wrong usage, 5 a bad file or (with --verify) damaged content.
    """
    from rigs.session.info import show

    return show(file, verify=verify, emissions=emissions)


@cli.command()
@click.argument("file", type=click.Path(path_type=Path), callback=session_file)
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Session file to make.")
def recover(file: Path, output: Path) -> int:
    """Copy the good part of a cut-off or damaged session FILE to a new one, and tell what was kept and dropped.

    FILE is never changed, and nothing is written over. Damaged sound becomes silence of the same length.

    Exit code: 0 good, 2 wrong usage, 3 the disk is full, 5 nothing can be recovered, or no good pose.
    """
    from rich.console import Console
    from rich.progress import track

    from rigs.session.recover import recover as recover_session

    console = Console(stderr=True)
    watch = partial(track, console=console, transient=True, disable=not console.is_terminal)
    recovery = recover_session(file, output, watch)
    click.echo(f"kept     {recovery.kept()}")
    for line in recovery.dropped or ["nothing"]:
        click.echo(f"dropped  {line}")
    if recovery.n_accepted:
        click.echo(f"{output}: a complete session; {file} is as it was")
        return 0
    click.echo(f"{output}: a session without a good pose, nothing to calibrate from; {file} is as it was")
    return 5


cli.add_command(import_group)
cli.add_command(audio)
cli.add_command(frames)


def main() -> None:
    """Run `rig-session`."""
    sys.exit(run("rig-session", cli))
