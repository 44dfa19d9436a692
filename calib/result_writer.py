"""The YAML file of a result: written whole, or not at all."""

from __future__ import annotations

from pathlib import Path

import yaml

from calib.outputs import write_outputs
from calib.result import Calibration
from calib.result_document import as_document
from rigs.errors import TargetExistsError
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
    write_outputs({path: as_text(result)}, overwrite=overwrite)


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
