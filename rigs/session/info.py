"""The summary of a session, for people."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.text import Text

from rigs.errors import DamagedSessionError
from rigs.session.emission_list import print_emissions
from rigs.session.layout import CLOCK_SESSION, FLAG_GAP, FLAG_OVERFLOW
from rigs.session.reader import Session

_MAX_PROBLEMS = 10
_BAD_FILE = 5


def show(path: Path, *, verify: bool, emissions: bool = False, console: Console | None = None) -> int:
    """Print what a session file holds; the exit code is 0, or 5 where `verify` finds damage.

    Parameters
    ----------
    path : Path
    verify : bool
        Read everything and compare the checksums.
    emissions : bool
        List them one by one.
    console : Console, optional

    Raises
    ------
    SessionError
        Not a session file, or a damaged one.
    """
    console = console or Console(highlight=False)
    with Session.open(path) as session:
        for label, text in summary(session):
            _print(console, label, text)
        if emissions:
            print_emissions(session, console)
        problems = session.verify() if verify else session.remarks
    for problem in problems[:_MAX_PROBLEMS]:
        _print(console, "problem", problem, "yellow")
    if len(problems) > _MAX_PROBLEMS:
        _print(console, "problem", f"and {len(problems) - _MAX_PROBLEMS} more", "yellow")
    if verify and problems:
        _print(console, "remedy", DamagedSessionError.remedy)
    if verify and not problems:
        _print(console, "checksums", "all good", "green")
    return _BAD_FILE if verify and problems else 0


def summary(session: Session) -> Iterator[tuple[str, str]]:
    """Yield what a session holds as pairs (label, text)."""
    rate_hz = session.sample_rate_hz
    yield "session", session.name
    yield "recorded", session.created_utc
    yield "rig", f"{session.description.name} (sha256 {session.description_sha256[:12]})"
    if session.recovered:
        yield "recovered", f"{session.recovered}; its log says what was dropped"
    yield "complete", "yes" if session.complete else "no: still recording, or cut off; good as far as it goes"
    yield (
        "audio",
        f"{session.n_samples / rate_hz:.1f} s, {session.n_channels} channels, {rate_hz:g} Hz{_losses(session)}",
    )
    if (clock := _sample_clock(session)) is not None:
        yield "clock", clock
    yield "frames", str(len(session.frames))
    yield "poses", _accepted(session.poses["accepted"])
    yield "emissions", _accepted(session.emissions["accepted"])
    yield "measured", _measured(session)
    yield "truth", "none" if session.truth is None else f"yes, from {session.truth.source}"
    yield "versions", ", ".join(f"{name} {version}" for name, version in session.versions.items()) or "none"
    yield "log", _log(session)


def _accepted(flags: np.ndarray) -> str:
    return f"{np.count_nonzero(flags)} accepted of {len(flags)}"


def _losses(session: Session) -> str:
    flags = session.audio_blocks["flags"]
    n_lossy = np.count_nonzero(flags & (FLAG_OVERFLOW | FLAG_GAP))
    return f", samples lost before {n_lossy} of {len(flags)} blocks" if n_lossy else ""


def _sample_clock(session: Session) -> str | None:
    """Say how fast the sound device really sampled; None where nobody measured it."""
    fits = session.clock_fits[session.clock_fits["clock"] == CLOCK_SESSION]
    if len(fits) == 0:
        return None
    nominal_hz = session.description.audio.sample_rate_hz
    rate_hz, rate_std = float(fits["rate"][-1]), float(fits["rate_std"][-1])
    return f"sampled at {rate_hz:.2f} Hz, {1e6 * (rate_hz / nominal_hz - 1):+.1f} +- {1e6 * rate_std:.1f} ppm"


def _measured(session: Session) -> str:
    layers = []
    if session.corners_px is not None:
        layers.append(f"corners of {len(session.corners_px)} poses")
    if session.tdoas is not None:
        layers.append(f"TDOAs of {len(session.tdoas.tdoa_s)} emissions x {len(session.tdoas.pairs)} pairs")
    return ", ".join(layers) or "none"


def _log(session: Session) -> str:
    levels = [bytes(level).lower() for level in session.log["level"]]
    n_warnings = sum(level.startswith(b"warn") for level in levels)
    n_errors = sum(level.startswith((b"err", b"crit")) for level in levels)
    return f"{len(levels)} lines, {n_warnings} warnings, {n_errors} errors"


def _print(console: Console, label: str, text: str, style: str = "") -> None:
    visible = "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text)
    console.print(Text(f"{label:<10} ", style="bold").append(visible, style=style or "not bold"), soft_wrap=True)
