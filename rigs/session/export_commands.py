"""The commands `rig-session audio` and `rig-session frames`: sound and pictures out of a session."""

from __future__ import annotations

import re
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rigs.errors import RigError, SessionError
from rigs.target import session_file

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from rigs.session.excerpts import Excerpt
    from rigs.session.reader import Session
    from rigs.session.sound_files import Format

PLAYERS = "acoustic_camera_rig.player"  # entry points: play(samples (n, n_channels), sample_rate_hz)
NUMBERS = re.compile(r"(\d+)(?:-(\d+))?")


class Numbers(click.ParamType):  # type: ignore[type-arg]
    """Numbers such as 12 or 3-8 or 1,4,7-9."""

    name = "numbers"

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> list[int]:
        """Return the numbers in the order given, each once."""
        numbers: dict[int, None] = {}
        for part in value.split(","):
            found = NUMBERS.fullmatch(part.strip())
            if found is None or len(part) > 20:
                self.fail(f"{value!r}: give numbers such as 12, 3-8 or 1,4,7-9", param, ctx)
            first, last = int(found[1]), int(found[2] or found[1])
            if last < first or last - first > 100_000:
                self.fail(f"{part!r}: the first number must be below the last", param, ctx)
            numbers |= dict.fromkeys(range(first, last + 1))
        return list(numbers)


@click.command()
@click.argument("file", type=click.Path(path_type=Path), callback=session_file)
@click.option("--emission", "emissions", type=Numbers(), help="Which, counted from 0: 12, 3-8 or 1,4,7-9.")
@click.option("--all", "every", is_flag=True, help="Every emission whose place in the sound is known.")
@click.option("--channel", "channels", type=int, multiple=True, help="Only this input channel (may be repeated).")
@click.option("--before-s", type=click.FloatRange(0, 60), default=0.02, show_default=True, help="Sound before it.")
@click.option("--after-s", type=click.FloatRange(0, 60), default=0.2, show_default=True, help="Sound after it.")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), help="File (.wav, .flac), or folder for more than one."
)
@click.option("--format", "form", type=click.Choice(("wav", "flac")), help="[default: by the file's ending, or wav]")
@click.option("--play", is_flag=True, help="Play it on the default sound device, and write only what -o names.")
def audio(
    file: Path, emissions: list[int] | None, every: bool, channels: tuple[int, ...], before_s: float, after_s: float,
    output: Path | None, form: Format | None, play: bool,
) -> None:  # fmt: skip
    """Cut emissions out of the session FILE and write, or play, their sound.

    WAV keeps every sample as it was recorded (32-bit float); FLAC has 24 bits. Nothing is written over.

    Exit code: 0 good, 2 wrong usage or a disk that is full, 3 no sound device to play on, 5 a bad file or no such
    emission.
    """
    from rigs.session.excerpts import check_emission, cut  # noqa: PLC0415 (keeps --help quick)
    from rigs.session.reader import Session  # noqa: PLC0415

    if every == (emissions is not None):
        raise click.UsageError("say which: --emission 12, --emission 3-8, or --all")
    with Session.open(file) as session:
        numbers = _placed(session) if emissions is None else emissions
        for number in numbers or [0]:
            check_emission(session, number)
        if output is not None or not play:
            _write(session, numbers, lambda number: cut(session, number, channels, before_s, after_s), output, form)
        if play:
            heard = channels or session.channels[:1]
            _play((cut(session, number, heard, before_s, after_s) for number in numbers), session.sample_rate_hz)


def _placed(session: Session) -> list[int]:
    """Return the emissions whose place in the sound is known, and say how many are none; all where all are none."""
    expected = session.emissions["expected_sample"]
    placed = [int(number) for number in ((expected >= 0) & (expected < session.n_samples)).nonzero()[0]]
    if 0 < len(placed) < len(expected):
        click.echo(f"{len(expected) - len(placed)} of {len(expected)} left out: audio was lost while they sounded")
    return placed or list(range(len(expected)))


def _write(
    session: Session, numbers: list[int], excerpt_of: Callable[[int], Excerpt], output: Path | None, form: Format | None
) -> None:
    from rigs.session.sound_files import FORMATS, format_of, write_sound  # noqa: PLC0415
    from rigs.target import whole_file, whole_folder  # noqa: PLC0415

    if len(numbers) == 1:
        path = output or session.path.with_suffix(f".emission-{numbers[0]}.{form or 'wav'}")
        form = format_of(path, form)
        with whole_file(path) as unfinished:
            excerpt = excerpt_of(numbers[0])
            write_sound(unfinished, excerpt, session.sample_rate_hz, form, path)
        click.echo(f"{path}: emission {numbers[0]}{_shortage([excerpt.n_missing], session.sample_rate_hz)}")
        return
    folder = output or session.path.with_suffix(".audio")
    if folder.suffix.lower() in {f".{each}" for each in FORMATS}:
        raise RigError(f"{folder}: {len(numbers)} emissions make a file each: name a folder, or one --emission")
    with whole_folder(folder) as unfinished:
        missing = []
        for number in numbers:
            excerpt = excerpt_of(number)
            name = f"{excerpt.name}.{form or 'wav'}"
            write_sound(unfinished / name, excerpt, session.sample_rate_hz, form or "wav", folder / name)
            missing.append(excerpt.n_missing)
    click.echo(f"{folder}: {len(numbers)} emissions, a file each{_shortage(missing, session.sample_rate_hz)}")


def _shortage(missing_samples: list[int], sample_rate_hz: float) -> str:
    """Say that the session reaches less far than was asked for, if so."""
    short = [n_samples for n_samples in missing_samples if n_samples]
    if not short:
        return ""
    whose = "" if len(missing_samples) == 1 else f"{len(short)} of them "
    return f"; {whose}up to {max(short) / sample_rate_hz:.2g} s shorter than asked for: the session reaches no further"


def _play(excerpts: object, sample_rate_hz: float) -> None:
    players = sorted(entry_points(group=PLAYERS), key=lambda each: each.name)
    if not players:
        raise RigError("this installation has no player: install acoustic-camera-rig anew, or write a file with -o")
    play: Callable[[NDArray[np.float32], float], None] = players[0].load()
    for excerpt in excerpts:  # type: ignore[attr-defined]
        click.echo(f"emission {excerpt.emission}, pose {excerpt.pose}, buzzer {excerpt.buzzer}, "
                   f"channel {', '.join(map(str, excerpt.channels))}")  # fmt: skip
        play(excerpt.samples, sample_rate_hz)


@click.command()
@click.argument("file", type=click.Path(path_type=Path), callback=session_file)
@click.option("--frame", "frames", type=Numbers(), help="Which, counted from 0: 12, 3-8 or 1,4,7-9 [default: all].")
@click.option("--pose", "poses", type=Numbers(), help="Only those of these poses: 3, 0-4 or 1,4,7-9.")
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Folder to make [default: FILE.frames].")
def frames(file: Path, frames: list[int] | None, poses: list[int] | None, output: Path | None) -> None:
    """Write the pictures of the session FILE as PNG, as the camera gave them.

    Nothing is written over. Exit code: 0 good, 2 wrong usage or a disk that is full, 5 a bad file, or no such
    frame or pose.
    """
    from rigs.session.reader import Session  # noqa: PLC0415 (keeps --help quick)
    from rigs.target import whole_folder  # noqa: PLC0415

    with Session.open(file) as session:
        of = [int(pose) for pose in session.frames["pose"]]
        numbers = list(range(len(of))) if frames is None else frames
        _check_among(file, "pose", poses or [], of)
        _check_among(file, "frame", numbers, range(len(of)))
        folder = output or file.with_suffix(".frames")
        with whole_folder(folder) as unfinished:
            n_written = 0
            for number in numbers:
                png = session.png(number)
                if poses is None or of[number] in poses:
                    (unfinished / f"frame-{number:05d}-pose-{of[number]:03d}.png").write_bytes(png.tobytes())
                    n_written += 1
            if n_written == 0:
                raise RigError(f"{file}: none of these frames: the session holds {len(of)}, of {len(set(of))} poses")
    click.echo(f"{folder}: {n_written} {'frame' if n_written == 1 else 'frames'}")


def _check_among(file: Path, what: str, chosen: Sequence[int], present: Sequence[int]) -> None:
    """Refuse a number that none of those present has."""
    absent = sorted(set(chosen) - set(present))
    if absent and present:
        raise SessionError(
            f"{file}: there is no {what} {absent[0]} with a picture: they go from {min(present)} to {max(present)}"
        )
