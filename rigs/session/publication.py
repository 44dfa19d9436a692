"""Publication: a session is made under a hidden name and gets its own once it can be read; none is ever half made."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from rigs.errors import SessionWriteError, TargetError, TargetExistsError, reason
from rigs.session.journal import is_being_recorded, journal_path


class Publication:
    """The hidden name and the own name of a session that is made; what a killed program left at the first is cleared.

    Parameters
    ----------
    path : Path
        The own name.

    Attributes
    ----------
    path, hidden : Path
    is_done : bool
        The session has its own name.

    Raises
    ------
    TargetError
        There is no such folder.
    TargetExistsError
        Another program makes this very session.
    """

    def __init__(self, path: Path) -> None:
        if not path.parent.is_dir():
            raise TargetError(f"{path}: there is no folder {path.parent}: make it first, or name another")
        path = path.resolve() if path.is_file() and path.is_symlink() else path  # a link stays one
        self.path, self.hidden, self.is_done = path, path.with_name(f".{path.name}.new"), False
        if is_being_recorded(self.hidden):
            raise TargetExistsError(
                f"{path}: another program is making this session: wait for it, or choose another name"
            )
        self.discard()

    def publish(self) -> None:
        """Give the session its name, unless something has it already.

        Raises
        ------
        TargetExistsError
        """
        refuse_existing(self.path)
        try:
            self.path.hardlink_to(self.hidden)  # fails where a rename would write over
            self.hidden.unlink()
        except FileExistsError as error:
            raise _taken(self.path) from error
        except OSError:  # no hard links on this file system
            self.hidden.rename(self.path)
        with suppress(FileNotFoundError):  # a closed session has none
            journal_path(self.hidden).replace(journal_path(self.path))
        self._finish()

    def replace(self, *, keep: bool) -> Path | None:
        """Put the session, all of it on the disk, in the place of an older one.

        Parameters
        ----------
        keep : bool
            Keep the older one, and its journal, under another name.

        Returns
        -------
        Path or None
            That other name.

        Raises
        ------
        SessionWriteError
        """
        try:
            kept = _keep(self.path) if keep else None
            self.hidden.replace(self.path)
            journal_path(self.hidden).replace(journal_path(self.path))
        except OSError as error:
            raise SessionWriteError(
                f"{self.path}: the resumed session cannot take its place ({reason(error)}): the old one is still there"
            ) from error
        self._finish()
        return kept

    def discard(self) -> None:
        """Delete what has the hidden name, and its journal."""
        for each in (self.hidden, journal_path(self.hidden)):
            with suppress(OSError):
                each.unlink()

    def drop_journal(self) -> None:
        """Delete the journal, once the session is closed and on the disk; one that stays behind does no harm."""
        with suppress(OSError):
            journal_path(self.path if self.is_done else self.hidden).unlink()
        _sync_folder(self.path.parent)

    def _finish(self) -> None:
        self.is_done = True
        _sync_folder(self.path.parent)


def refuse_existing(path: Path) -> None:
    """Raise TargetExistsError where something is at `path`."""
    if path.exists() or path.is_symlink():
        raise _taken(path)


def _sync_folder(folder: Path) -> None:
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
