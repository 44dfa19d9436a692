"""The command line `rig-capture`: record a session."""

from __future__ import annotations

import shlex
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING
from unicodedata import category

import click

from rigs.command import leave, run

if TYPE_CHECKING:
    from acquire.status import Status
    from rigs.library import FoundDescription

_TONE_WARNING = (
    "warning: signal.kind tone: arrivals of a steady tone are ambiguous, and rig-calibrate takes none of them; "
    "use sweep or mls"
)

_UNSEEN = {"Cc", "Cs", "Zl", "Zp"}  # Unicode's control signs, halves of signs, ends of lines and paragraphs


def _list_devices(context: click.Context, _option: click.Parameter, is_wanted: bool) -> None:
    """Print what there is, and end."""
    if not is_wanted or context.resilient_parsing:
        return
    from rich.console import Console

    from acquire.device_list import show_devices

    show_devices(Console())
    context.exit()


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="acoustic-camera-rig")
@click.option(
    "--list-devices",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_list_devices,
    help="Show sound devices, cameras and serial ports as the rig description names them, and exit.",
)
@click.option(
    "--session",
    required=True,
    type=click.Path(path_type=Path),
    help="Session file to make; .h5 is added when missing. An existing file is never written over.",
)
@click.option("--rig", metavar="PATH|NAME", help="Rig description: a YAML file, or the name of a shipped rig.")
@click.option("--poses", type=click.IntRange(1, 10000), help="How many poses, instead of what the description says.")
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), help="Of the simulated rig, instead of the description's.")
@click.option(
    "--resume",
    "resumes",
    is_flag=True,
    help="Go on with an existing session, whole or cut off, with its own rig.",
)
def cli(session: Path, rig: str | None, poses: int | None, seed: int | None, resumes: bool) -> int:
    """Capture a session: for each pose of the board, fire every buzzer and record what microphones and camera take in.

    Without --rig, the description is looked for in the environment variable RIG, in ./rig.yaml and in the user's config
    folder; where there is none, the simulated rig is used. Ctrl-C ends the capture; what was recorded is saved.

    Exit code: 0 good, 2 wrong usage or description, 3 a device is missing or was lost, 4 wrong firmware, 5 the board
    was not found or nothing was heard, 130 ended by Ctrl-C or SIGTERM. Whatever the code, poses that were captured
    are saved.
    """
    from rich.console import Console  # these, HDF5, OpenCV and pydantic would slow down --help

    from acquire.capture import capture
    from acquire.interrupt import stop_on_signals
    from acquire.resume import look_into
    from acquire.screen import screen_for
    from rigs.library import find_description

    path = _session_path(session)
    if resumes:
        earlier = look_into(path, find_description(rig) if rig else None, seed)
        found, seed, poses = earlier.found, earlier.seed, poses or earlier.poses
    else:
        _check_new(path)
        found = find_description(rig)
    console = Console(highlight=False)
    console.print(_rig_line(found), soft_wrap=True, markup=False)
    if found.description.signal.kind == "tone":
        console.print(_TONE_WARNING, soft_wrap=True, markup=False)
    with stop_on_signals() as stop_wanted, screen_for(console) as screen:
        status = capture(found, path, screen=screen, poses=poses, seed=seed, stop_wanted=stop_wanted, resumes=resumes)
    with suppress(SystemExit, OSError):  # rich's answer to a broken pipe: nobody reads this any more
        for line in (*_fault_lines(status), _next_line(status.saved, found.description.min_poses, path, status.silent)):
            console.print(line, soft_wrap=True, markup=False)
    return 0


def _session_path(session: Path) -> Path:
    """Return the file that --session means; a name that no terminal can show is refused."""
    from rigs.errors import TargetError

    if any(category(sign) in _UNSEEN for sign in str(session)):
        raise click.BadParameter(
            f"{str(session)!a} has a sign that cannot be shown, such as a line's end: choose another name",
            param_hint="--session",
        )
    if session.name in ("", ".."):
        raise TargetError(f"{session}: a folder, not a file: name a file")
    return session if session.suffix == ".h5" else session.with_name(f"{session.name}.h5")


def _check_new(path: Path) -> None:
    from rigs.errors import TargetExistsError
    from rigs.target import check_target

    try:
        check_target(path)
    except TargetExistsError as error:
        raise TargetExistsError(f"{error}, or go on with that session: --resume") from error


def _rig_line(found: FoundDescription) -> str:
    why = f"named by {found.how}" if found.how in ("--rig", "RIG") else f"found as {found.how}"
    if found.how == "--resume":
        why = "the rig that the session began with"
    if found.how == "default":
        why = "the default, as nothing else is named by --rig, RIG, ./rig.yaml or your config folder"
    return f"rig {found.description.name}, from {found.where}: {why}"


def _next_line(n_saved: int, n_needed: int, path: Path, silent: tuple[int, ...] = ()) -> str:
    """Return the command that will work: a silent channel has to be left out."""
    if n_saved < n_needed:
        return f"next: capture a session with more poses: rig-calibrate needs at least {n_needed} poses, 25 are good"
    shown = f"./{path}" if str(path).startswith("-") else str(path)
    return " ".join(["next: rig-calibrate", shlex.quote(shown), *(f"--exclude-channel {one}" for one in silent)])


def _fault_lines(status: Status) -> list[str]:
    """Say which channels were at fault until the end, and which buzzers were seldom or never heard."""
    from acquire.status import CHANNEL_REMEDIES, OFTEN_MISSED

    channels = [
        f"warning: channel {channel} was {kind} until the end: {CHANNEL_REMEDIES[kind]}; or leave it out: "
        f"rig-calibrate --exclude-channel {channel}"
        for channel, kind in status.faults.items()
    ]
    buzzers = [
        f"warning: buzzer {buzzer} was not heard {n_missed} of {status.fired[buzzer]} times: check its wires, its pin "
        "on the board and its loudness; rig-calibrate rests on the other buzzers then"
        for buzzer, n_missed in sorted(status.missed.items())
        if n_missed > OFTEN_MISSED * status.fired[buzzer]
    ]
    return channels + buzzers


def main() -> None:
    """Run `rig-capture`."""
    leave(run("rig-capture", cli))
