"""Emissions cut out of a session's sound."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigs.errors import SessionError
from rigs.session.reader import Session


@dataclass(frozen=True)
class Excerpt:
    """The sound around one emission.

    Parameters
    ----------
    emission, pose, buzzer : int
        Row of the session's table, counted from 0; number of the pose; id of the buzzer.
    channels : tuple of int
        Input channel of each column.
    first_sample : int
        Row of the session's audio where it begins.
    samples : (n_samples, n_channels) float32 array
        Full scale = 1.
    n_missing : int
        How many samples it is shorter than was asked for: the session reaches no further.
    """

    emission: int
    pose: int
    buzzer: int
    channels: tuple[int, ...]
    first_sample: int
    samples: NDArray[np.float32]
    n_missing: int

    @property
    def name(self) -> str:
        """What a file with it is called, without its ending."""
        return f"emission-{self.emission:04d}-pose-{self.pose:03d}-buzzer-{self.buzzer}"


def cut(session: Session, emission: int, channels: tuple[int, ...], before_s: float, after_s: float) -> Excerpt:
    """Cut one emission out, with some sound before and after, as far as the session reaches.

    Parameters
    ----------
    session : Session
    emission : int
        Row of the session's table, counted from 0.
    channels : tuple of int
        Input channels; none: all that were recorded.
    before_s, after_s : float
        How much more than the emission itself.

    Raises
    ------
    SessionError
        No such emission or channel, or the session does not hold its sound.
    """
    check_emission(session, emission)
    row = session.emissions[emission]
    columns = _columns(session, channels or session.channels)
    begins, rate_hz = int(row["expected_sample"]), session.sample_rate_hz
    if begins < 0:
        raise SessionError(f"{session.path}: when emission {emission} began was not recorded: nothing to cut")
    asked_first = begins - round(before_s * rate_hz)
    asked_end = begins + round((session.description.signal.waveform().duration_s + after_s) * rate_hz)
    first, end = max(0, asked_first), min(asked_end, session.n_samples)
    if first >= end:
        raise SessionError(f"{session.path}: the sound ends before emission {emission}: the session was cut off")
    samples = session.audio(first, end - first)[:, columns]
    chosen = tuple(session.channels[column] for column in columns)
    n_missing = asked_end - asked_first - len(samples)
    return Excerpt(emission, int(row["pose"]), int(row["buzzer"]), chosen, first, samples, n_missing)


def check_emission(session: Session, emission: int) -> None:
    """Refuse a number that is none of an emission.

    Raises
    ------
    SessionError
    """
    n_emissions = len(session.emissions)
    if n_emissions == 0:
        raise SessionError(f"{session.path}: the session has no emissions")
    if not 0 <= emission < n_emissions:
        raise SessionError(f"{session.path}: there is no emission {emission}: they go from 0 to {n_emissions - 1}")
    if session.n_samples == 0:
        raise SessionError(f"{session.path}: this session has no sound: it begins with measured TDOAs")


def _columns(session: Session, channels: tuple[int, ...]) -> list[int]:
    for channel in channels:
        if channel not in session.channels:
            raise SessionError(
                f"{session.path}: channel {channel} was not recorded: there are {', '.join(map(str, session.channels))}"
            )
    return [session.channels.index(channel) for channel in channels]
