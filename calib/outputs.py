"""Files beside a result: refused early where they cannot or must not be written, then all of them written, or none."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path

from rigs.errors import TargetError, TargetExistsError, reason
from rigs.target import check_target

MARK = b"acoustic-camera-rig"  # somewhere in all that this software writes, but for NumPy's files
_NUMPY, _RESULT, _LARGEST = b"\x93NUMPY", b"format: acoustic-rig-calibration", 50_000_000


def beside(result: Path, ending: str) -> Path:
    """Return the path of a file beside a result: s1.report.html beside s1.calib.yaml."""
    return result.with_name(result.name.removesuffix(".yaml").removesuffix(".calib") + ending)


def check_outputs(paths: Iterable[Path], *, overwrite: bool) -> None:
    """Refuse paths that could not be written, or whose content is not to be replaced.

    Raises
    ------
    TargetError
        No such folder, one that cannot be written to, or something is there already.
    """
    for path in paths:
        if path.exists() and overwrite and not path.is_dir():
            _check_ours(path)
        elif path.exists() and not path.is_dir():
            raise TargetExistsError(f"{path}: already there: add --overwrite, or name another --output")
        else:
            check_target(path)
    for folder in {path.parent for path in paths}:
        check_writable(folder)


def check_writable(folder: Path) -> None:
    """Refuse a folder in which no file can be made.

    Raises
    ------
    TargetError
    """
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise TargetError(
            f"{folder}: cannot be written to ({reason(error)}): name an --output in another folder"
        ) from error


def write_outputs(contents: Mapping[Path, bytes], *, overwrite: bool) -> None:
    """Write files under hidden names, and give all of them their own only when the last is whole.

    Raises
    ------
    TargetError
        As `check_outputs` does.
    OSError
        The disk is full, say; then nothing is left behind.
    """
    check_outputs(contents, overwrite=overwrite)
    with ExitStack() as stack:
        hidden = {}
        for path, content in contents.items():
            try:
                hidden[path] = _hidden(path, content, stack)
            except OSError as error:  # an error of writing names no file
                raise OSError(error.errno, reason(error), str(path)) from error
        _put_in_place(hidden, overwrite=overwrite)


def _hidden(path: Path, content: bytes, stack: ExitStack) -> Path:
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    temporary = Path(name)
    stack.callback(temporary.unlink, missing_ok=True)
    with os.fdopen(handle, "wb") as file:
        file.write(content)
    temporary.chmod(0o644)
    return temporary


def _put_in_place(hidden: Mapping[Path, Path], *, overwrite: bool) -> None:
    """Give files their names; where one is taken, even by a racing run, none has one."""
    with ExitStack() as undo:
        for path, temporary in hidden.items():
            if overwrite:
                temporary.replace(path)
                continue
            try:
                path.hardlink_to(temporary)  # unlike a rename, fails where the name is taken
            except FileExistsError as error:
                raise TargetExistsError(f"{path}: already there: add --overwrite, or name another --output") from error
            except OSError:  # a file system without hard links
                temporary.rename(path)
            undo.callback(path.unlink)
        undo.pop_all()


def _check_ours(path: Path) -> None:
    with path.open("rb") as stream:
        content = stream.read(_LARGEST)
    if not content.startswith((_NUMPY, _RESULT)) and MARK not in content:
        raise TargetExistsError(f"{path}: not made by this software, so not written over: name another --output")
