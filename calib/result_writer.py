"""The YAML file of a result: written whole, or not at all."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import yaml

from calib.result import Calibration
from calib.result_document import as_document
from rigs.errors import TargetError, TargetExistsError, reason
from rigs.target import check_target


def write_calibration(result: Calibration, path: Path, *, overwrite: bool = False) -> None:
    """Write the YAML file, whole or not at all.

    Raises
    ------
    TargetError
        Something is there and `overwrite` was not asked for, or it is no earlier result; or there is no such folder,
        or it cannot be written to.
    OSError
        The disk is full.
    """
    check_result_target(path, overwrite=overwrite)
    text = as_text(result)
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise TargetError(f"{path}: cannot be made ({reason(error)}): choose another folder") from error
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(text)
        Path(temporary).chmod(0o644)
        _put_in_place(Path(temporary), path, overwrite=overwrite)
    finally:
        Path(temporary).unlink(missing_ok=True)


def as_text(result: Calibration) -> bytes:
    """Return the content of the YAML file."""
    text: str = yaml.safe_dump(as_document(result), sort_keys=False, default_flow_style=None, width=120)
    return text.encode()


def check_result_target(path: Path, *, overwrite: bool) -> None:
    """Refuse early what `write_calibration` would refuse; only an earlier result is ever written over.

    Raises
    ------
    TargetError
    """
    if path.exists() and not overwrite:
        raise TargetExistsError(f"{path}: already there: add --overwrite, or name another --output")
    check_target(path, replaces="calibration" if overwrite else None)


def _put_in_place(temporary: Path, path: Path, *, overwrite: bool) -> None:
    if overwrite:
        temporary.replace(path)
        return
    try:
        path.hardlink_to(temporary)  # fails where the name is taken, even by a racing run
    except FileExistsError as error:
        raise TargetExistsError(f"{path}: there is already something of this name: add --overwrite") from error
    except OSError:  # a file system without hard links
        temporary.rename(path)
