"""The recovery: the good part of a session as a new one; the old one is never touched."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

from rigs.errors import TargetError
from rigs.session import layout
from rigs.session.good_part import Recovery, Watch, copy, unwatched
from rigs.session.layers import Header
from rigs.session.layout import MeasuredTdoas
from rigs.session.wreck import Wreck
from rigs.session.writer import SessionWriter
from rigs.target import check_target

_SPARE_BYTES = 2**24


def recover(path: Path, target: Path, watch: Watch = unwatched) -> Recovery:
    """Copy the good part of a cut-off or damaged session to a new, complete one.

    Parameters
    ----------
    path, target : Path
    watch : callable
        Handed the rows to copy and what they are; shows how far the copy is.

    Raises
    ------
    TargetError
        The target is there already, or there is no room for it.
    SessionError
        Nothing can be recovered, or the target cannot be written.
    """
    check_target(target)
    with Wreck.open(path) as wreck:
        check_room(path, target)
        writer = SessionWriter.begin(target, copied_header(wreck), wreck.n_channels)
        try:
            recovery = copy(wreck, writer, watch)
            text = "; ".join(recovery.dropped) or "nothing"
            writer.append_log(math.nan, "warning", f"recovered from {path.name}: {recovery.kept()}; dropped: {text}")
            writer.close()
            writer.publish()
        except BaseException:
            writer.discard()
            raise
    return recovery


def check_room(path: Path, target: Path) -> None:
    """Raise TargetError where the disk of `target` has no room for another `path`."""
    needed, free = path.stat().st_size + _SPARE_BYTES, shutil.disk_usage(target.parent).free
    if free < needed:
        raise TargetError(
            f"{target}: the copy needs {needed / 1e9:.2f} GB and this disk has {free / 1e9:.2f} GB free: "
            "free some space or use another disk"
        )


def copied_header(wreck: Wreck) -> Header:
    """Return the header of a copy: that of the old file, marked as recovered from it."""
    old = wreck.header
    return Header(
        old.name,
        old.description_text,
        old.versions,
        old.sample_rate_hz,
        old.truth,
        None if old.corners_px is None else old.corners_px[: len(wreck.tables[layout.POSES])],
        None
        if old.tdoas is None
        else MeasuredTdoas(old.tdoas.tdoa_s[: len(wreck.tables[layout.EMISSIONS])], old.tdoas.pairs),
        old.created_utc,
        recovered=f"from {wreck.path.name}",
    )
