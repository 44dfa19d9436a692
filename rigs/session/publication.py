"""Publication: a session is made under a hidden name and gets its own once it can be read; none is ever half made."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from rigs.errors import SessionWriteError, TargetError, TargetExistsError, reason
from rigs.session.journal import is_being_recorded, journal_path


def hidden_path(path: Path) -> Path:
    """Return the name, beside `path`, under which its session is made."""
    return path.with_name(f".{path.name}.new")


def prepare(path: Path) -> Path:
    """Return the hidden path to make a session at, cleared of what a killed program left there.

    Raises
    ------
    TargetError
        There is no such folder.
    TargetExistsError
        Another program makes this very session.
    """
    if not path.parent.is_dir():
        raise TargetError(f"{path}: there is no folder {path.parent}: make it first, or name another")
    hidden = hidden_path(path)
    if is_being_recorded(hidden):
        raise TargetExistsError(f"{path}: another program is making this session: wait for it, or choose another name")
    discard(hidden)
    return hidden


def publish(hidden: Path, path: Path) -> None:
    """Give a session its name, unless something has it already.

    Raises
    ------
    TargetExistsError
    """
    refuse_existing(path)
    try:
        path.hardlink_to(hidden)  # fails where a rename would write over
        hidden.unlink()
    except FileExistsError as error:
        raise _taken(path) from error
    except OSError:  # no hard links on this file system
        hidden.rename(path)
    with suppress(FileNotFoundError):  # a closed session has none
        journal_path(hidden).replace(journal_path(path))
    sync_folder(path.parent)


def replace(hidden: Path, path: Path, *, keep: bool) -> Path | None:
    """Put a session, all of it on the disk, in the place of an older one.

    Parameters
    ----------
    hidden, path : Path
    keep : bool
        Keep the older one, and its journal, under another name.

    Returns
    -------
    Path or None
        That other name.
    """
    try:
        kept = _keep(path) if keep else None
        hidden.replace(path)
        journal_path(hidden).replace(journal_path(path))
    except OSError as error:
        raise SessionWriteError(
            f"{path}: the resumed session cannot take its place ({reason(error)}): the old one is still there"
        ) from error
    sync_folder(path.parent)
    return kept


def discard(session: Path) -> None:
    """Delete a session that was never published, and its journal."""
    for each in (session, journal_path(session)):
        with suppress(OSError):
            each.unlink()


def refuse_existing(path: Path) -> None:
    """Raise TargetExistsError where something is at `path`."""
    if path.exists() or path.is_symlink():
        raise _taken(path)


def sync_folder(folder: Path) -> None:
    """See the names in a folder onto the disk, where the system can."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _keep(path: Path) -> Path:
    number = 1
    while (kept := path.with_name(f"{path.stem}.before-resume-{number}{path.suffix}")).exists():
        number += 1
    for old, new in ((path, kept), (journal_path(path), journal_path(kept))):
        if old.exists():
            try:
                new.hardlink_to(old)
            except OSError:
                old.rename(new)
    return kept


def _taken(path: Path) -> TargetExistsError:
    return TargetExistsError(f"{path}: there is already something of this name: choose another name")
