"""The emissions of a session one by one, with their numbers, and whether they count."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from rich.console import Console
from rich.table import Table

from rigs.session.reader import Session

_HEADINGS = ("emission", "pose", "buzzer", "repeat", "at, s", "onset, ms")


def print_emissions(session: Session, console: Console) -> None:
    """Print a line for each row of the session's table, numbered from 0 as `rig-calibrate --inspect-tdoa` takes it."""
    table = Table(box=None, padding=(0, 2, 0, 0))  # 77 columns, so that no line is broken
    for heading in _HEADINGS:
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("counts", no_wrap=True)
    for row in emission_rows(session):
        table.add_row(*row)
    console.print(table)


def emission_rows(session: Session) -> Iterator[tuple[str, ...]]:
    """Yield of each emission its number, pose, buzzer, repeat, place in the sound, onset against it, and verdict."""
    good_poses = session.poses["pose"][session.poses["accepted"] != 0]
    for number, emission in enumerate(session.emissions):
        expected, at, onset = int(emission["expected_sample"]), "", ""
        if expected >= 0:
            at = f"{expected / session.sample_rate_hz:.3f}"
            onset = _onset_ms(session, number, expected)
        whole = (number, emission["pose"], emission["buzzer"], emission["repeat"])
        counts = whether_it_counts(bool(emission["accepted"]), bool(np.isin(emission["pose"], good_poses)), expected)
        yield (*(str(int(value)) for value in whole), at, onset, counts)


def whether_it_counts(accepted: bool, pose_accepted: bool, expected_sample: int) -> str:
    """Say in words whether an emission counts, and why not."""
    if accepted and pose_accepted:
        return "yes"
    if expected_sample < 0:
        return "no: audio was lost"
    if not accepted:
        return "no: not good at capture"
    return "no: its pose is not good"


def _onset_ms(session: Session, number: int, expected: int) -> str:
    """Return how long after its place an emission was heard; empty where that is not known."""
    if session.onsets is None:
        return ""
    late_ms = 1e3 * (float(session.onsets["measured_sample"][number]) - expected) / session.sample_rate_hz
    return f"{late_ms:+.2f}" if np.isfinite(late_ms) else "not heard"
