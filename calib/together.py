"""Several sessions of one rig as one: their poses side by side, each emission knowing which session it is of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.corners import PoseCorners
from calib.emissions import EmissionTdoas
from calib.errors import MethodError
from calib.flaws import Flaws
from calib.rejections import Rejection
from calib.sound import SoundArrivals
from rigs.description import RigDescription
from rigs.session.layout import Truth
from rigs.session.reader import Session


@dataclass(frozen=True)
class Measured:
    """What was measured in one session.

    Parameters
    ----------
    name, sha256 : str
    description : RigDescription
    corners : PoseCorners
    tdoas : EmissionTdoas
    truth : Truth or None
    sound : dict or None
        What was heard and what was wrong with it, in plain values.
    doubts : list of str
        About the file.
    rejections : list of Rejection
        What was left out before the solve.
    """

    name: str
    sha256: str
    description: RigDescription
    corners: PoseCorners
    tdoas: EmissionTdoas
    truth: Truth | None = None
    sound: dict[str, Any] | None = None
    doubts: list[str] = field(default_factory=list)
    rejections: list[Rejection] = field(default_factory=list)


def check_one_rig(sessions: Sequence[Measured | Session]) -> None:
    """Refuse sessions that are not of one rig.

    Raises
    ------
    MethodError
        Naming what differs.
    """
    first = sessions[0]
    for other in sessions[1:]:
        for part, of_first, of_other in _parts(first.description, other.description):
            if of_first != of_other:
                raise MethodError(
                    f"{first.name} and {other.name} are not of one rig: {part} differs; solve them one by one"
                )


def check_joinable(sessions: list[Measured]) -> None:
    """Refuse a session that is given twice, and sessions that hold different pairs of microphones.

    Raises
    ------
    MethodError
    """
    first, seen = sessions[0].tdoas, dict[str, str]()
    for other in sessions:
        if other.sha256 in seen:
            raise MethodError(f"{seen[other.sha256]} and {other.name} are the same session: name each once")
        seen[other.sha256] = other.name
        same_kind = (first.sound is None) == (other.tdoas.sound is None)
        if not same_kind or not np.array_equal(first.pairs, other.tdoas.pairs):
            raise MethodError(
                f"{sessions[0].name} and {other.name} do not hold the same pairs of microphones: solve them one by one"
            )


def _parts(first: RigDescription, other: RigDescription) -> list[tuple[str, object, object]]:
    """Return what must be the same: all that the sessions are to share."""
    parts = [
        (f"{section}.{name}", getattr(getattr(first, section), name), getattr(getattr(other, section), name))
        for section, names in SHARED.items()
        for name in names
    ]
    return [*parts, ("board", first.board, other.board)]


SHARED = {"audio": ("channels", "reference_microphone"), "camera": ("size_px", "intrinsics")}


def put_together(sessions: list[Measured]) -> tuple[PoseCorners, EmissionTdoas]:
    """Return the corners and the emissions of all sessions, the poses numbered through."""
    lengths = [int(session.corners.pose.max()) + 1 + int(session.tdoas.pose.max()) for session in sessions]
    offsets = [0, *accumulate(lengths)][: len(sessions)]
    corners = PoseCorners(
        np.concatenate([session.corners.pose + offset for session, offset in zip(sessions, offsets, strict=True)]),
        np.concatenate([session.corners.corners_px for session in sessions]),
    )
    names = {
        int(pose) + offset: f"{pose} of {session.name}"
        for session, offset in zip(sessions, offsets, strict=True)
        for pose in session.corners.pose
    }
    return corners, replace(_emissions([session.tdoas for session in sessions], offsets), pose_names=names)


def _emissions(parts: list[EmissionTdoas], offsets: list[int]) -> EmissionTdoas:
    return EmissionTdoas(
        np.concatenate([part.pose + offset for part, offset in zip(parts, offsets, strict=True)]),
        np.concatenate([part.buzzer for part in parts]),
        np.concatenate([part.tdoa_s for part in parts]),
        parts[0].pairs,
        sound=_sound([part.sound for part in parts if part.sound is not None]),
        rows=_joined([part.rows for part in parts]),
        session=np.repeat(np.arange(len(parts)), [len(part.pose) for part in parts]),
    )


def _joined(rows: list[NDArray[np.intp] | None]) -> NDArray[np.intp] | None:
    known = [each for each in rows if each is not None]
    return np.concatenate(known) if len(known) == len(rows) else None


def _sound(parts: list[SoundArrivals]) -> SoundArrivals | None:
    if not parts:
        return None
    arrival_s = np.concatenate([part.arrival_s for part in parts])
    return SoundArrivals(
        " and ".join(sorted({part.mode for part in parts})),
        np.arange(len(arrival_s)),
        parts[0].channels,
        arrival_s,
        np.concatenate([part.std_s for part in parts]),
        Flaws(_shape(arrival_s)),
        np.concatenate([part.quality for part in parts]),
        *_onsets(parts),
    )


def _onsets(parts: list[SoundArrivals]) -> tuple[NDArray[np.float64], NDArray[np.float64]] | tuple[()]:
    """Return when emissions began and its standard deviation, NaN in sessions without; nothing where none has any."""
    if all(part.onset_s is None for part in parts):
        return ()
    unknown = [np.full(len(part.rows), np.nan) for part in parts]
    onset_s = [part.onset_s if part.onset_s is not None else none for part, none in zip(parts, unknown, strict=True)]
    std_s = [
        part.onset_std_s if part.onset_std_s is not None else none for part, none in zip(parts, unknown, strict=True)
    ]
    return np.concatenate(onset_s), np.concatenate(std_s)


def _shape(values: NDArray[np.float64]) -> tuple[int, int]:
    return values.shape[0], values.shape[1]
