"""A calibration as its YAML file has it: read back, and checked, since a hand may have edited it.

All that reads results reads them here (`rig-calibrate --compare` and `--export`, `rig-verify`), so all refuse the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from calib.errors import ResultFileError
from calib.joint.uncertainty import microphone_covariances
from calib.result import Calibration, Recording
from calib.result_document import FORMAT, VERSION, as_document, digest_of
from calib.settings import Block, Method, Settings
from calib.sound import TdoaMode
from rigs.description import Intrinsics
from rigs.errors import DescriptionError, reason
from rigs.library import load_yaml
from rigs.remedies import remedies
from rigs.section import Channel

FloatArray = NDArray[np.float64]

MAX_BYTES = 10_000_000
MAX_MICROPHONES = 64
ROUNDING = 1e-4  # of the largest entry: how far apart two entries may be that should be alike
_AGAIN = "calibrate the session again"
_NO_COVARIANCE = "not symmetric with positive variances and eigenvalues, so no covariance: put it right"


@dataclass(frozen=True)
class StoredCalibration:
    """Microphones in the camera frame, and what is needed to use them.

    Parameters
    ----------
    name : str
        Of the file, for messages.
    sessions : dict of str to str
        What it was made from: SHA-256 of each session, and its name.
    settings : Settings
        What was chosen when it was made; of an earlier version's file all but the method as usual.
    software : str
        What made it.
    channels : tuple of int
        Input channel of each microphone.
    positions_m : (n_mics, 3) array
    array_covariance_m2 : (3 n_mics, 3 n_mics) array
        Of all positions together, microphone by microphone.
    speed_of_sound_m_s, speed_of_sound_std_m_s : float
        Of the air at the time.
    intrinsics : Intrinsics
    recording : Recording
    """

    name: str
    sessions: dict[str, str]
    settings: Settings
    software: str
    channels: tuple[int, ...]
    positions_m: FloatArray
    array_covariance_m2: FloatArray
    speed_of_sound_m_s: float
    speed_of_sound_std_m_s: float
    intrinsics: Intrinsics
    recording: Recording

    @property
    def method(self) -> Method:
        """What it was made by."""
        return self.settings.method

    @property
    def covariance_m2(self) -> FloatArray:
        """Covariance (n_mics, 3, 3) of each microphone."""
        return microphone_covariances(self.array_covariance_m2, len(self.channels))

    @property
    def std_m(self) -> FloatArray:
        """Standard deviations (n_mics, 3) of the positions."""
        return np.asarray(np.sqrt(np.diag(self.array_covariance_m2)).reshape(-1, 3))

    @property
    def columns(self) -> tuple[int, ...]:
        """Column of each microphone in the session's `time_data`, from 0."""
        return tuple(self.recording.channels.index(channel) for channel in self.channels)

    @property
    def names(self) -> list[str]:
        """A name for each microphone."""
        return [f"microphone_{channel}" for channel in self.channels]

    @property
    def session_names(self) -> str:
        """Names of all sessions, in one line."""
        return " + ".join(self.sessions.values())

    def only(self, channels: tuple[int, ...]) -> StoredCalibration:
        """Return the calibration of some channels, in their order."""
        rows = np.array([self.channels.index(channel) for channel in channels], dtype=np.intp)
        places = (3 * rows[:, None] + np.arange(3)).ravel()
        return replace(
            self,
            channels=channels,
            positions_m=self.positions_m[rows],
            array_covariance_m2=self.array_covariance_m2[np.ix_(places, places)],
        )


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, allow_inf_nan=False)


Coordinate = Annotated[float, Field(ge=-100, le=100)]
Row = tuple[float, float, float]


class _Microphone(_Part):
    channel: Channel
    position_m: tuple[Coordinate, Coordinate, Coordinate]
    covariance_m2: tuple[Row, Row, Row]


class _Camera(Intrinsics):
    model_config = ConfigDict(extra="ignore")

    distortion: tuple[float, float, float, float, float]  # a result has it; nothing stands in for it


class _Session(_Part):
    name: str
    sha256: str


class _Recording(_Part):
    sample_rate_hz: float = Field(gt=0)
    channels: tuple[Channel, ...] = Field(min_length=1)
    picture_size_px: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]]


class _Settings(_Part):
    """All but the method; what is not there is as usual."""

    seed: int = Field(0, ge=0)
    reference_channel: Channel | None = None
    excluded_channels: tuple[Channel, ...] = ()
    tdoa: TdoaMode = "auto"
    hold: tuple[Block, ...] = ()
    find_delays: bool = False
    ignore_sync: bool = False
    exact: tuple[Block, ...] = ()


class _Document(_Part):
    """The keys that are read; a result has more, for people."""

    method: Method
    software: str
    speed_of_sound_m_s: float = Field(ge=250, le=450)
    speed_of_sound_std_m_s: float = Field(ge=0)
    microphones: tuple[_Microphone, ...] = Field(min_length=1, max_length=MAX_MICROPHONES)
    camera: _Camera
    session: _Session | None = None
    sessions: tuple[_Session, ...] = ()
    recording: _Recording
    settings: _Settings = _Settings()
    array_covariance_m2: tuple[tuple[float, ...], ...]


def read_result(path: Path) -> StoredCalibration:
    """Read a result of `rig-calibrate`.

    Raises
    ------
    ResultFileError
        Missing, no result, of another version, or edited into something impossible: one line with file, key and
        remedy.
    """
    try:
        content = load_yaml(_text(path), str(path), fast=True)
        _check_kind(content, path)
        document = _Document.model_validate(content)
    except DescriptionError as error:
        raise ResultFileError(f"{error}; or {_AGAIN}") from error
    except ValidationError as error:
        raise ResultFileError(f"{path}: {remedies(error, _Document)[0]}, or {_AGAIN}") from error
    for fault in (_session_fault(document), _channel_fault(document), _covariance_fault(document)):
        if fault:
            raise ResultFileError(f"{path}: {fault}, or {_AGAIN}")
    if content.get("digest", digest_of(content)) != digest_of(content):
        raise ResultFileError(
            f"{path}: edited by hand since it was written, says its digest: {_AGAIN}, or remove the line `digest` to "
            "take it as it is"
        )
    return _stored(document, path.name)


def as_stored(result: Calibration) -> StoredCalibration:
    """Return a result rounded as its file has it, so that exports of both are the same."""
    return _stored(_Document.model_validate(as_document(result)), result.session_name)


def _stored(document: _Document, name: str) -> StoredCalibration:
    sessions = (document.session,) if document.session else document.sessions
    return StoredCalibration(
        name,
        {session.sha256: session.name for session in sessions},
        Settings(method=document.method, **document.settings.model_dump()),
        document.software,
        tuple(microphone.channel for microphone in document.microphones),
        np.array([microphone.position_m for microphone in document.microphones]),
        np.array(document.array_covariance_m2),
        document.speed_of_sound_m_s,
        document.speed_of_sound_std_m_s,
        Intrinsics(**document.camera.model_dump()),
        Recording(**document.recording.model_dump()),
    )


def _text(path: Path) -> str:
    try:
        with path.open("rb") as stream:
            content = stream.read(MAX_BYTES + 1)
        if len(content) > MAX_BYTES:
            raise ResultFileError(f"{path}: larger than 10 MB, so not a result: name a SESSION.calib.yaml")
        return content.decode("utf-8-sig")
    except OSError as error:
        raise ResultFileError(f"{path}: cannot be read ({reason(error)}): name a result of rig-calibrate") from error
    except UnicodeDecodeError as error:
        raise ResultFileError(f"{path}: not UTF-8 text, so not a result: name a SESSION.calib.yaml") from error


def _check_kind(content: Any, path: Path) -> None:
    """Refuse what is no result that this version can read.

    Raises
    ------
    ResultFileError
    """
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ResultFileError(f"{path}: not a result of rig-calibrate: name a SESSION.calib.yaml")
    if content.get("version") != VERSION:
        raise ResultFileError(
            f"{path}: of version {content.get('version')!r}, this software reads {VERSION}: use the software that made "
            f"it, or {_AGAIN}"
        )
    for key in ("array_covariance_m2", "recording"):
        if key not in content:
            raise ResultFileError(f"{path}: has no {key}: an earlier version made it, or a hand changed it: {_AGAIN}")


# Each returns what is wrong and where, which no single key shows; empty where nothing is.


def _session_fault(document: _Document) -> str:
    return "" if document.session or document.sessions else "session: missing: put back what it was made from"


def _channel_fault(document: _Document) -> str:
    seen: set[int] = set()
    for number, microphone in enumerate(document.microphones):
        if microphone.channel in seen:
            return f"microphones[{number}].channel: {microphone.channel} is listed twice: give each its own"
        if microphone.channel not in document.recording.channels:
            return f"microphones[{number}].channel: {microphone.channel} is none of recording.channels: put it right"
        seen.add(microphone.channel)
    return ""


def _covariance_fault(document: _Document) -> str:
    n_mics, rows = len(document.microphones), document.array_covariance_m2
    size = 3 * n_mics
    if [len(row) for row in rows] != [size] * size:
        return f"array_covariance_m2: not the {size} x {size} numbers that {n_mics} microphones need: put it right"
    whole = np.array(rows)
    own = np.array([microphone.covariance_m2 for microphone in document.microphones])
    for number, (mine, block) in enumerate(zip(own, microphone_covariances(whole, n_mics), strict=True)):
        where = f"microphones[{number}].covariance_m2"
        if not _is_covariance(mine):
            return f"{where}: {_NO_COVARIANCE}"
        if np.abs(mine - block).max() > ROUNDING * mine.max():
            return f"{where} and array_covariance_m2 contradict each other: put them right"
    if not _is_covariance(whole):
        return f"array_covariance_m2: {_NO_COVARIANCE}"
    return ""


def _is_covariance(matrix: FloatArray) -> bool:
    variances = np.diag(matrix)
    slack = ROUNDING * variances.max()
    is_symmetric = bool(np.abs(matrix - matrix.T).max() <= slack)
    return bool((variances > 0).all()) and is_symmetric and bool(np.linalg.eigvalsh(matrix)[0] >= -slack)
