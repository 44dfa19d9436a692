"""A target: a file that a command is asked to write, refused early where it cannot or must not be."""

from __future__ import annotations

import errno
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from rigs.errors import TargetError, TargetExistsError, reason

_BEGINNINGS = {"session": b"\x89HDF\r\n\x1a\n", "calibration": b"format: acoustic-rig-calibration"}


def session_file(_context: object, _parameter: object, path: Path) -> Path:
    """Return a session's file, named as `rig-capture --session` takes it: s1 is s1.h5, unless there is an s1."""
    named = path.with_name(f"{path.name}.h5") if path.name not in ("", "..") else path
    return named if named.is_file() and not path.exists() else path


def session_files(context: object, parameter: object, paths: tuple[Path, ...]) -> tuple[Path, ...]:
    """Return several sessions' files, as `session_file` does."""
    return tuple(session_file(context, parameter, path) for path in paths)


def check_target(path: Path, *, replaces: Literal["session", "calibration"] | None = None) -> None:
    """Refuse a target before any work is done for it.

    Parameters
    ----------
    path : Path
    replaces : {"session", "calibration"} or None
        What an existing file must be to be written over, as its first bytes tell; None: nothing is.

    Raises
    ------
    TargetError
        Not the name of a file, or there is no such folder.
    TargetExistsError
        Something is there that must not be written over.
    """
    if path.name in ("", "..") or path.is_dir():
        raise TargetError(f"{path}: a folder, not a file: name a file")
    if not path.parent.is_dir():
        raise TargetError(no_folder(path))
    if not (path.exists() or path.is_symlink()):
        return
    if replaces is None:
        raise TargetExistsError(f"{path}: there is already something of this name: choose another name")
    with path.open("rb") as stream:
        begins = stream.read(64)
    if not begins.startswith(_BEGINNINGS[replaces]):
        raise TargetExistsError(f"{path}: not a {replaces}, so not written over: choose another name")


def no_folder(target: Path) -> str:
    """Say that there is no folder to make a target in."""
    if target.parent.exists():
        return f"{target}: {target.parent} is a file, not a folder: name another"
    return f"{target}: there is no folder {target.parent}: make it first, or name another"


@contextmanager
def whole_folder(folder: Path, *, replace: bool = False) -> Iterator[Path]:
    """Yield a folder to fill, and give it its name when all went well; otherwise nothing is left.

    Parameters
    ----------
    folder : Path
        Its name; must not be there, unless `replace`.
    replace : bool
        Remove what has that name at the very end.

    Raises
    ------
    TargetExistsError
        Something of this name is there.
    TargetError
        There is no folder to make it in, or that cannot be written to.
        Nor where the disk is full.
    """
    if folder.name in ("", "..") or not folder.parent.is_dir():
        raise TargetError(no_folder(folder))
    if not replace and (folder.exists() or folder.is_symlink()):
        raise TargetExistsError(f"{folder}: there is already something of this name: choose another name")
    unfinished = _hidden_folder(folder)
    try:
        unfinished.chmod(0o755)
        yield unfinished
        if replace and folder.exists():
            shutil.rmtree(folder)
        unfinished.rename(folder)
    except OSError as error:
        raise _named(error, folder) from error
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a name to write to, and give the file its own name when all went well; otherwise nothing is left.

    Raises
    ------
    TargetError
        As `check_target`, or its folder cannot be written to, or the disk is full.
    """
    check_target(path)
    folder = _hidden_folder(path)
    try:
        yield folder / path.name
        (folder / path.name).rename(path)
    except OSError as error:
        raise _named(error, path) from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _named(error: OSError, target: Path) -> Exception:
    """Return an error of a full disk that names what should have been written there; any other as it is."""
    if error.errno not in (errno.ENOSPC, errno.EDQUOT):
        return error
    return TargetError(f"{target}: cannot be written ({reason(error)}): free some space or choose another disk")


def _hidden_folder(beside: Path) -> Path:
    try:
        return Path(tempfile.mkdtemp(dir=beside.parent, prefix=f".{beside.name}."))
    except OSError as error:
        raise TargetError(
            f"{beside}: cannot be made ({reason(error)}): check the permissions or choose another folder"
        ) from error
