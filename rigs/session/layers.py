"""The layers of a session that do not grow: written when it is made, checked when it is opened."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from uuid import uuid4

import h5py
import numpy as np
from numpy.typing import NDArray

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


@dataclass(frozen=True)
class Header:
    """What a session is made with, and does not grow.

    Parameters
    ----------
    name : str
    description_text : str
        The rig description's YAML, word for word.
    versions : mapping of str to str
    sample_rate_hz : float
    truth : Truth, optional
    corners_px : (n_poses, n_corners, 2) array, optional
    tdoas : MeasuredTdoas, optional
    created_utc : str
        ISO 8601; now, unless it is a copy.
    recovered : str
        What it is a copy of; empty where it is none.
    file_id : str
        Ties the journal to the file.
    """

    name: str
    description_text: str
    versions: Mapping[str, str]
    sample_rate_hz: float
    truth: Truth | None = None
    corners_px: NDArray[np.float64] | None = None
    tdoas: MeasuredTdoas | None = None
    created_utc: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    recovered: str = ""
    file_id: str = field(default_factory=lambda: uuid4().hex)


def write_header(file: h5py.File, header: Header) -> None:
    """Write everything that does not grow."""
    _set_text(file, "format", layout.FORMAT)
    file.attrs.create("version", layout.VERSION, dtype="<i8")
    for name in ("name", "created_utc", "file_id"):
        _set_text(file, name, getattr(header, name))
    if header.recovered:
        _set_text(file, "recovered", header.recovered)
    content = header.description_text.encode()
    description = file.create_dataset(layout.DESCRIPTION, data=_bytes(content))
    _set_text(description, "sha256", hashlib.sha256(content).hexdigest())
    file.create_dataset(layout.VERSIONS, data=_bytes(_listing(header)))
    for path, values in _fixed_layers(header).items():
        file.create_dataset(path, data=values)
    if header.truth is not None:
        _set_text(file[layout.TRUTH], "source", header.truth.source)


def fixed_names(header: Header) -> list[str]:
    """Return the names of the datasets that `write_header` makes."""
    return [layout.DESCRIPTION, layout.VERSIONS, *_fixed_layers(header)]


def journal_header(header: Header) -> dict[str, NDArray[Any]]:
    """Return the same as arrays, for the journal."""
    texts = {
        "name": header.name.encode(),
        "created_utc": header.created_utc.encode(),
        "file_id": header.file_id.encode(),
        "truth_source": (header.truth.source if header.truth else "").encode(),
        layout.DESCRIPTION: header.description_text.encode(),
        layout.VERSIONS: _listing(header),
    }
    rate_hz = {"sample_rate_hz": np.array([header.sample_rate_hz])}
    return {name: _bytes(text) for name, text in texts.items()} | rate_hz | _fixed_layers(header)


def header_from_journal(arrays: Mapping[str, NDArray[Any]]) -> Header:
    """Return the header that `journal_header` made the arrays of."""
    text = {name: arrays[name].tobytes().decode() for name in arrays if arrays[name].dtype == np.uint8}
    truth: dict[str, Any] = {
        name: arrays[f"{layout.TRUTH}/{name}"] for name in _TRUTH_SHAPES if f"{layout.TRUTH}/{name}" in arrays
    }
    if "speed_of_sound_m_s" in truth:
        truth["speed_of_sound_m_s"] = float(truth["speed_of_sound_m_s"][0])
    return Header(
        text["name"],
        text[layout.DESCRIPTION],
        json.loads(text[layout.VERSIONS]),
        float(arrays["sample_rate_hz"][0]),
        Truth(source=text["truth_source"], **truth) if "microphones_m" in truth else None,
        arrays.get(layout.CORNERS),
        MeasuredTdoas(arrays[layout.TDOAS], arrays[layout.TDOA_PAIRS]) if layout.TDOAS in arrays else None,
        text["created_utc"],
        file_id=text["file_id"],
    )


def _fixed_layers(header: Header) -> dict[str, NDArray[Any]]:
    """Return measured layers and truth, where given, by their names in the file."""
    fixed: dict[str, Any] = {}
    if header.corners_px is not None:
        fixed[layout.CORNERS] = header.corners_px
    if header.tdoas is not None:
        fixed[layout.TDOAS] = header.tdoas.tdoa_s
    if header.truth is not None:
        values = {name: getattr(header.truth, name) for name in _TRUTH_SHAPES}
        fixed |= {f"{layout.TRUTH}/{name}": np.atleast_1d(each) for name, each in values.items() if each is not None}
    arrays = {name: np.asarray(values, dtype="<f8") for name, values in fixed.items()}
    if header.tdoas is not None:
        arrays[layout.TDOA_PAIRS] = np.asarray(header.tdoas.pairs, dtype="<i4")
    return arrays


def _listing(header: Header) -> bytes:
    return json.dumps(dict(header.versions), ensure_ascii=False).encode()


def _bytes(content: bytes) -> NDArray[np.uint8]:
    return np.frombuffer(content, dtype=np.uint8)


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
    container: Container, description: RigDescription, n_poses: int | None, judge: Judge
) -> NDArray[np.float64] | None:
    """Return measured corners (n_poses, n_corners, 2) in pixels, None where there are none; raises SessionError."""
    if layout.CORNERS not in container:
        return None
    columns, rows = description.board.corners
    corners_px = container.read(layout.CORNERS, "<f8", (None, columns * rows, 2))
    judge.measured_rows(len(corners_px), n_poses, layout.CORNERS)
    return corners_px


def read_tdoas(
    container: Container, channels: tuple[int, ...], n_emissions: int | None, judge: Judge
) -> MeasuredTdoas | None:
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


def _set_text(owner: Any, name: str, text: str) -> None:
    content = text.encode()  # of fixed length: the variable-length strings of h5py are objects to other readers
    owner.attrs.create(name, content, dtype=h5py.string_dtype("utf-8", max(1, len(content))))


def _read_text(container: Container, name: str) -> bytes:
    content = container.read(name, np.uint8, (None,)).tobytes()
    if len(content) > _MAX_TEXT_BYTES:
        raise SessionError(f"{container.path}: {name} is larger than 1 MB, which none is")
    return content
