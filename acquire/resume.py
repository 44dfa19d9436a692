"""The resumption: a session that ended early is copied beside itself, and the copy goes on in its place."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rigs.board import find_corners
from rigs.description import RigDescription
from rigs.errors import RigError, SessionError
from rigs.library import FoundDescription
from rigs.session import layout, picture
from rigs.session.good_part import Recovery, Watch, copy, unwatched
from rigs.session.layout import Truth
from rigs.session.recover import check_room, copied_header
from rigs.session.wreck import Wreck
from rigs.session.writer import SessionWriter

FloatArray = NDArray[np.float64]
SEED, POSES = "simulation seed", "poses wanted"  # their names among the versions of a session
_ADDRESSES = (("trigger", "port"), ("camera", "source"), ("audio", "device"))  # may change when something is replugged


@dataclass(frozen=True)
class Earlier:
    """What a session holds from before.

    Parameters
    ----------
    found : FoundDescription
        The rig description in the file, with the addresses of the devices as they are now.
    seed : int or None
        Of the simulated rig.
    poses : int or None
        How many were wanted, where the session tells.
    """

    found: FoundDescription
    seed: int | None
    poses: int | None


@dataclass(frozen=True)
class Resumption:
    """A session that goes on.

    Parameters
    ----------
    writer : SessionWriter
        Of the copy, still hidden; `take_place` puts it where the old file is.
    recovery : Recovery
        What the copy holds.
    corners_px : list of (n_corners, 2) arrays
        Of the board at each good pose, as far as a picture of it is left.
    moved : list of str
        Which device has which other address now.
    """

    writer: SessionWriter
    recovery: Recovery
    corners_px: list[FloatArray]
    moved: list[str]

    def take_place(self, versions: dict[str, str]) -> list[str]:
        """Put the copy where the old file is, and return in words what happened."""
        kept = self.writer.replace(keep=bool(self.recovery.dropped))
        self.writer.mark_resumed()
        lines = [f"resumed after {self.recovery.kept()}", *self.moved]
        lines += [f"dropped: {each}" for each in self.recovery.dropped]
        if kept is not None:
            lines.append(f"the file as it was is kept as {kept.name}")
        for line in (*lines, *(f"resumed with {part} {version}" for part, version in versions.items())):
            self.writer.append_log(math.nan, "info", line)
        return lines


def look_into(path: Path, named: FoundDescription | None, seed: int | None) -> Earlier:
    """Return the rig that a session was begun with; it must be the one that is named now, but for addresses.

    A board at another port, a camera at another source and a sound device of another name may be the same ones.

    Parameters
    ----------
    path : Path
    named : FoundDescription or None
        The rig description that --rig names.
    seed : int or None
        That --seed gives.

    Raises
    ------
    rigs.errors.RigError
        Another rig, another seed, or a session of measurements, which has a row per pose and cannot grow.
    SessionError
        Not a session, being recorded, or beyond recovery.
    """
    with Wreck.open(path) as wreck:
        description = wreck.description if named is None else _readdressed(wreck.description, named.description)
        if named is not None and (difference := _difference(named.description, description)):
            raise RigError(
                f"{named.where}: not the rig of {path}: {difference}; go on without --rig, or begin another session"
            )
        if wreck.header.corners_px is not None or wreck.header.tdoas is not None:
            raise RigError(f"{path}: begins with measured corners or TDOAs, so nothing can be recorded into it")
        old, poses = (_number(wreck.header.versions.get(key, "")) for key in (SEED, POSES))
        if None not in (old, seed) and old != seed:
            raise RigError(f"{path}: began with --seed {old}, so it cannot go on with --seed {seed}: leave it out")
        found = FoundDescription(wreck.header.description_text, description, str(path), "--resume")
        return Earlier(found, old if seed is None else seed, poses)


def resume(
    path: Path, truth: Truth | None, description: RigDescription, n_poses: int, watch: Watch = unwatched
) -> Resumption:
    """Copy a session to a hidden file beside it, ready to be appended to; the session itself is not touched.

    Parameters
    ----------
    path : Path
    truth : Truth or None
        Of the simulated rig that goes on.
    description : RigDescription
        With the addresses of its devices as they are now.
    n_poses : int
        How many good poses are wanted in all.
    watch : callable
        As in `rigs.session.recover.recover`.

    Raises
    ------
    rigs.errors.RigError
        It has as many already, there is no room for the copy, or the truth is another.
    SessionError
        It cannot be read, or the copy cannot be written.
    """
    with Wreck.open(path) as wreck:
        n_good = np.count_nonzero(wreck.tables[layout.POSES]["accepted"])
        if n_good >= n_poses:
            raise RigError(f"{path}: has {n_good} good poses already: ask for more with --poses")
        check_room(path, path)
        header = replace(copied_header(wreck), recovered="", truth=_joined(truth, wreck.header.truth, path))
        header = replace(header, versions={**header.versions, POSES: str(n_poses)})
        writer = SessionWriter.begin(path, header, wreck.n_channels)
        try:
            recovery = copy(wreck, writer, watch)
            moved = _moved(wreck.description, description)
            return Resumption(writer, recovery, _good_corners_px(wreck, recovery.n_accepted), moved)
        except BaseException:
            writer.discard()
            raise


def _joined(new: Truth | None, old: Truth | None, path: Path) -> Truth | None:
    """Return the truth that plans more poses; the two must be of one scene."""
    if new is None or old is None:
        return old
    if not np.array_equal(new.microphones_m, old.microphones_m):
        raise RigError(f"{path}: was recorded in another simulated room: name its --seed")
    if new.board_to_camera is None or old.board_to_camera is None:
        return old
    return new if len(new.board_to_camera) >= len(old.board_to_camera) else old


def _good_corners_px(wreck: Wreck, n_good: int) -> list[FloatArray]:
    """Return where the board was at the poses that still count: the first so many of those that did."""
    frames, poses = wreck.tables[layout.CAMERA_FRAMES], wreck.tables[layout.POSES]
    corners_px = []
    for pose in poses["pose"][poses["accepted"] != 0][:n_good]:
        found = (_corners_px(wreck, frame) for frame in frames[frames["pose"] == pose])
        if (first := next((each for each in found if each is not None), None)) is not None:
            corners_px.append(first)
    return corners_px


def _corners_px(wreck: Wreck, frame: np.void) -> FloatArray | None:
    png = wreck.png(frame)
    if png is None:
        return None
    try:
        return find_corners(picture.decode(png, str(wreck.path)), wreck.description.board)
    except SessionError:
        return None


def _number(text: str) -> int | None:
    return int(text) if text.isdecimal() else None


def _readdressed(description: RigDescription, now: RigDescription) -> RigDescription:
    """Return a rig with the addresses that its devices have in another description."""
    sections = {}
    for section, key in _ADDRESSES:
        value = getattr(getattr(now, section), key)
        sections[section] = getattr(description, section).model_copy(update={key: value})
    return description.model_copy(update=sections)


def _moved(old: RigDescription, new: RigDescription) -> list[str]:
    """Say in words which device has which other address now."""
    lines = []
    for section, key in _ADDRESSES:
        before, now = (rig.model_dump(mode="json")[section][key] for rig in (old, new))
        if before != now:
            lines.append(f"{section}.{key} is now {now!r}, it was {before!r}")
    return lines


def _difference(new: RigDescription, old: RigDescription) -> str:
    """Say in words where two descriptions first differ; empty where they do not."""
    return _first_difference(new.model_dump(mode="json"), old.model_dump(mode="json"), "")


def _first_difference(new: Any, old: Any, where: str) -> str:
    if new == old:
        return ""
    if isinstance(new, dict) and isinstance(old, dict):
        for key in [*old, *new]:
            if new.get(key) != old.get(key):
                return _first_difference(new.get(key), old.get(key), f"{where}.{key}" if where else key)
    return f"{where} is {new!r}, in the session {old!r}"
