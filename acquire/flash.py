"""The command line `rig-flash`: put the buzzer board's firmware on a board."""

from __future__ import annotations

import shlex
import subprocess
import sys
from functools import partial
from pathlib import Path

import click

from acquire.avrdude import BOARDS, AvrdudeError, BoardKind, ToolError, check_installed, command, write_image
from acquire.ports import FoundPort, choose_port, open_port, serial_ports
from rigs.command import run

_IMAGES = Path(__file__).parent / "images"
_FIRMWARE = Path(__file__).parents[1] / "firmware"


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="acoustic-camera-rig")
@click.option("--port", default="auto", show_default=True, metavar="auto|PATH|VID:PID[:SERIAL]", help="Which port.")
@click.option("--board", type=click.Choice(list(BOARDS)), help="Which board, where its USB ids do not tell.")
@click.option(
    "--image",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="An Intel HEX file, instead of the firmware that comes with this program.",
)
@click.option("--build", is_flag=True, help="Build the firmware from its sources first (in a source tree).")
@click.option("--dry-run", is_flag=True, help="Look for all that is needed, say what would be done, and write nothing.")
@click.option("--verbose", is_flag=True, help="Show what avrdude says.")
def cli(port: str, board: str | None, image: Path | None, build: bool, dry_run: bool, verbose: bool) -> int:
    """Put the firmware of the buzzer board on an Arduino, and ask the board what is on it.

    Exit code: 0 good, 2 wrong usage or avrdude is missing, 3 no board, no permission, or the board cannot be written,
    4 what answers after writing is not this firmware.
    """
    if image and build:
        raise click.UsageError("--image names a file, --build makes one: give one of the two")
    found = choose_port(port, serial_ports())
    open_port(found.path).close()  # it is there, and avrdude would write into another program's conversation
    kind = _kind(board, found)
    click.echo(f"{'port' if port == found.path else 'found'} {found.describe()}: taken as board {kind.name}")
    check_installed()
    if build:
        _build(dry_run)
    chosen = image or _IMAGES / f"buzzer-board-{kind.image}.hex"
    if not chosen.is_file() and not (build and dry_run):
        raise ToolError(
            f"{chosen}: there is no such image: build it with --build in a source tree, or name one with --image"
        )
    if dry_run:
        click.echo(f"would run: {shlex.join(command(kind, found.path, chosen))}")
        return 0
    _write(kind, found.path, chosen, verbose)
    return 0


def main() -> None:
    """Run `rig-flash`."""
    sys.exit(run("rig-flash", cli))


def _kind(board: str | None, found: FoundPort) -> BoardKind:
    name = board or found.board
    if not name:
        raise click.UsageError(
            f"{found.describe()}: that does not tell which board it is: give --board {', '.join(BOARDS)}"
        )
    return BOARDS[name]


def _write(kind: BoardKind, port: str, image: Path, verbose: bool) -> None:
    click.echo(f"writing {image.name} with avrdude: some seconds, up to half a minute where no bootloader answers ...")
    try:
        write_image(kind, port, image, partial(click.echo, nl=False, err=True) if verbose else _ignore)
    except AvrdudeError as error:
        if error.output and not verbose:
            click.echo(error.output, err=True)
        raise
    from acquire.devices.board_hello import connect  # noqa: PLC0415 - NumPy would slow down --help

    link, hello = connect(port)
    link.close()
    click.echo(f"written and verified; the board says: {hello.describe()}, {hello.n_buzzers} buzzers")


def _ignore(line: str) -> None:
    """Keep what avrdude says to itself: much of it is harmless, and frightens."""


def _build(dry_run: bool) -> None:
    if not (_FIRMWARE / "Makefile").is_file():
        raise ToolError(
            "--build works in a source tree only: leave it out to take the image that came with this program"
        )
    build = ["make", "-C", str(_FIRMWARE), "images"]
    if dry_run:
        click.echo(f"would run: {shlex.join(build)}")
        return
    try:
        made = subprocess.run(build, capture_output=True, text=True, check=False)  # noqa: S603
    except FileNotFoundError as error:
        raise ToolError("make is not installed: `sudo apt install make`, or leave --build out") from error
    if made.returncode:
        click.echo(made.stdout + made.stderr, err=True)
        raise ToolError(
            "the firmware could not be built, for the reason above: `sudo apt install gcc-avr arduino-core-avr`"
        )
