"""The layers of a session that do not grow: written when it is made, checked when it is opened."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from rigs.description import RigDescription
from rigs.errors import DescriptionError, SessionError
from rigs.session import layout
from rigs.session.container import Container
from rigs.session.layout import MeasuredTdoas, Truth
from rigs.session.validation import Judge

_MAX_TEXT_BYTES = 1_000_000
_TRUTH_SHAPES: dict[str, tuple[int | None, ...]] = {
    "microphones_m": (None, 3),
    "speed_of_sound_m_s": (1,),
    "board_to_camera": (None, 4, 4),
    "buzzers_m": (None, 3),
    "camera_matrix": (3, 3),
    "distortion": (5,),
}


def write_header(file: h5py.File, name: str, description_text: str, versions: Mapping[str, str]) -> None:
    """Write the identity, the description and the versions."""
    _set_text(file, "format", layout.FORMAT)
    file.attrs.create("version", layout.VERSION, dtype="<i8")
    _set_text(file, "name", name)
    _set_text(file, "created_utc", datetime.now(UTC).isoformat(timespec="seconds"))
    content = description_text.encode()
    description = file.create_dataset(layout.DESCRIPTION, data=np.frombuffer(content, dtype=np.uint8))
    _set_text(description, "sha256", hashlib.sha256(content).hexdigest())
    listing = json.dumps(dict(versions), ensure_ascii=False).encode()
    file.create_dataset(layout.VERSIONS, data=np.frombuffer(listing, dtype=np.uint8))


def write_measured(file: h5py.File, corners_px: NDArray[np.float64] | None, tdoas: MeasuredTdoas | None) -> None:
    """Write measured corners (n_poses, n_corners, 2) in pixels and TDOAs, where given."""
    if corners_px is not None:
        _write(file, layout.CORNERS, corners_px)
    if tdoas is not None:
        _write(file, layout.TDOAS, tdoas.tdoa_s)
        _write(file, layout.TDOA_PAIRS, tdoas.pairs, "<i4")


def write_truth(file: h5py.File, truth: Truth | None) -> None:
    """Write the truth, where given."""
    if truth is None:
        return
    group = file.create_group(layout.TRUTH)
    _set_text(group, "source", truth.source)
    for field in fields(truth):
        value = getattr(truth, field.name)
        if field.name != "source" and value is not None:
            _write(group, field.name, np.atleast_1d(value))


def read_identity(container: Container) -> tuple[str, str]:
    """Return (name, created_utc); raises SessionError where the file is foreign or of a newer version."""
    if container.attribute("/", "format") != layout.FORMAT:
        raise SessionError(f"{container.path}: HDF5, but not a session: its attribute format is not {layout.FORMAT!r}")
    version = container.attribute("/", "version")
    if isinstance(version, int) and version > layout.VERSION:
        raise SessionError(
            f"{container.path}: written in format version {version}, this software knows up to {layout.VERSION}: "
            "update acoustic-camera-rig"
        )
    if version != layout.VERSION:
        raise SessionError(f"{container.path}: its format version {version!r} is none that ever was")
    return str(container.attribute("/", "name") or ""), str(container.attribute("/", "created_utc") or "")


def read_description(container: Container) -> tuple[str, str]:
    """Return (text, sha256) of the rig description; raises SessionError where they do not fit."""
    content = _read_text(container, layout.DESCRIPTION)
    sha256 = hashlib.sha256(content).hexdigest()
    if container.attribute(layout.DESCRIPTION, "sha256") != sha256:
        raise SessionError(f"{container.path}: the rig description was changed after recording: its hash does not fit")
    try:
        return content.decode(), sha256
    except UnicodeDecodeError as error:
        raise SessionError(f"{container.path}: the rig description is not UTF-8 text") from error


def parse(text: str, path: Path) -> RigDescription:
    """Parse the rig description of a session file; raises SessionError."""
    from rigs.library import parse_description  # noqa: PLC0415 - YAML and its schema, only here

    try:
        return parse_description(text, f"{path}: rig description")
    except DescriptionError as error:
        raise SessionError(str(error)) from error


def read_versions(container: Container) -> dict[str, str]:
    """Return the versions of software, firmware and drivers; raises SessionError."""
    listing: Any = None
    with suppress(ValueError, RecursionError):
        listing = json.loads(_read_text(container, layout.VERSIONS))
    if not isinstance(listing, dict) or not all(isinstance(version, str) for version in listing.values()):
        raise SessionError(f"{container.path}: {layout.VERSIONS} is not a JSON object of texts")
    return listing


def read_table(container: Container, name: str, dtype: np.dtype[np.void]) -> NDArray[Any]:
    """Return an optional table of records; empty where there is none."""
    return container.read(name, dtype, (None,)) if name in container else np.empty(0, dtype)


def read_corners(
    container: Container, description: RigDescription, n_poses: int, judge: Judge
) -> NDArray[np.float64] | None:
    """Return measured corners (n_poses, n_corners, 2) in pixels, None where there are none; raises SessionError."""
    if layout.CORNERS not in container:
        return None
    columns, rows = description.board.corners
    corners_px = container.read(layout.CORNERS, "<f8", (None, columns * rows, 2))
    judge.measured_rows(len(corners_px), n_poses, layout.CORNERS)
    return corners_px


def read_tdoas(container: Container, channels: tuple[int, ...], n_emissions: int, judge: Judge) -> MeasuredTdoas | None:
    """Return measured TDOAs, None where there are none; raises SessionError."""
    if layout.TDOAS not in container:
        return None
    pairs = container.read(layout.TDOA_PAIRS, "<i4", (None, 2))
    if not np.isin(pairs, channels).all():
        raise SessionError(f"{container.path}: {layout.TDOA_PAIRS} names channels that the rig does not record")
    tdoa_s = container.read(layout.TDOAS, "<f8", (None, len(pairs)))
    judge.measured_rows(len(tdoa_s), n_emissions, layout.TDOAS)
    return MeasuredTdoas(tdoa_s, pairs)


def read_truth(container: Container, description: RigDescription) -> Truth | None:
    """Return the truth, None where there is none; raises SessionError."""
    names = {name: f"{layout.TRUTH}/{name}" for name in _TRUTH_SHAPES}
    if not any(path in container for path in names.values()):
        return None
    shapes = _TRUTH_SHAPES | {
        "microphones_m": (len(description.audio.channels), 3),
        "buzzers_m": (len(description.board.buzzers), 3),
    }
    found: dict[str, Any] = {
        name: container.read(path, "<f8", shapes[name])
        for name, path in names.items()
        if path in container or name == "microphones_m"
    }
    for name, values in found.items():
        if not np.isfinite(values).all():
            raise SessionError(f"{container.path}: {layout.TRUTH}/{name} holds values that are not numbers")
    if "speed_of_sound_m_s" in found:
        found["speed_of_sound_m_s"] = float(found["speed_of_sound_m_s"][0])
    return Truth(source=str(container.attribute(layout.TRUTH, "source") or "unknown"), **found)


def _write(parent: h5py.Group, name: str, values: ArrayLike, dtype: str = "<f8") -> None:
    parent.create_dataset(name, data=np.asarray(values, dtype=dtype))


def _set_text(owner: Any, name: str, text: str) -> None:
    content = text.encode()  # of fixed length: the variable-length strings of h5py are objects to other readers
    owner.attrs.create(name, content, dtype=h5py.string_dtype("utf-8", max(1, len(content))))


def _read_text(container: Container, name: str) -> bytes:
    content = container.read(name, np.uint8, (None,)).tobytes()
    if len(content) > _MAX_TEXT_BYTES:
        raise SessionError(f"{container.path}: {name} is larger than 1 MB, which none is")
    return content
