"""The array of a result: of one at hand, or of its file, which is checked, since a hand may have edited it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from calib.errors import MethodError
from calib.export.array import CalibratedArray
from calib.result import Calibration, Recording, as_document
from rigs.description import Channel, Intrinsics
from rigs.errors import DescriptionError, reason
from rigs.library import load_yaml
from rigs.remedies import remedies

MAX_BYTES = 10_000_000
ASYMMETRY = 1e-4  # of the largest entry: six digits are stored
_AGAIN = "or calibrate the session again"

Number = Annotated[float, Field(ge=-100, le=100)]
Row = tuple[Number, Number, Number]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, allow_inf_nan=False)


class _Microphone(_Part):
    channel: Channel
    position_m: Row
    covariance_m2: tuple[Row, Row, Row]


class _Session(_Part):
    name: str
    sha256: str


class _Recording(_Part):
    sample_rate_hz: float = Field(gt=0)
    channels: tuple[Channel, ...] = Field(min_length=1)
    picture_size_px: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]]


class _Camera(Intrinsics):
    model_config = ConfigDict(extra="ignore")


class _Result(_Part):
    format: Literal["acoustic-rig-calibration"]
    version: Literal[1]
    method: str
    software: str
    speed_of_sound_m_s: float = Field(ge=250, le=450)
    speed_of_sound_std_m_s: float = Field(ge=0)
    microphones: tuple[_Microphone, ...] = Field(min_length=1, max_length=64)
    camera: _Camera
    session: _Session | None = None
    sessions: tuple[_Session, ...] = ()
    recording: _Recording


def array_of(result: Calibration) -> CalibratedArray:
    """Take the array from a result, rounded as its file has it, so that exports of both are the same."""
    return _array(_Result.model_validate(as_document(result)))


def read_array(path: Path) -> CalibratedArray:
    """Read the array from a result's file.

    Raises
    ------
    MethodError
        Missing, no result, or edited into something impossible: one line with file, key and remedy.
    """
    try:
        document = load_yaml(_text(path), str(path))
        if not isinstance(document, dict) or document.get("format") != "acoustic-rig-calibration":
            raise MethodError(f"{path}: not a result: name a SESSION.calib.yaml that rig-calibrate wrote")
        result = _Result.model_validate(document)
    except DescriptionError as error:
        raise MethodError(str(error)) from error
    except ValidationError as error:
        raise MethodError(f"{path}: {remedies(error, _Result)[0]}; {_AGAIN}") from error
    _check(result, path)
    return _array(result)


def _array(result: _Result) -> CalibratedArray:
    sessions = (result.session,) if result.session else result.sessions
    return CalibratedArray(
        " + ".join(session.name for session in sessions),
        " + ".join(session.sha256 for session in sessions),
        result.method,
        result.software,
        tuple(microphone.channel for microphone in result.microphones),
        np.array([microphone.position_m for microphone in result.microphones]),
        np.array([microphone.covariance_m2 for microphone in result.microphones]),
        result.speed_of_sound_m_s,
        result.speed_of_sound_std_m_s,
        Intrinsics(**result.camera.model_dump()),
        Recording(**result.recording.model_dump()),
    )


def _text(path: Path) -> str:
    try:
        with path.open("rb") as stream:
            content = stream.read(MAX_BYTES + 1)
        if len(content) > MAX_BYTES:
            raise MethodError(f"{path}: larger than 10 MB, so not a result: name a SESSION.calib.yaml")
        return content.decode()
    except OSError as error:
        raise MethodError(f"{path}: cannot be read ({reason(error)}): name a result of rig-calibrate") from error
    except UnicodeDecodeError as error:
        raise MethodError(f"{path}: not UTF-8 text, so not a result: name a SESSION.calib.yaml") from error


def _check(result: _Result, path: Path) -> None:
    """Refuse what no single key shows.

    Raises
    ------
    MethodError
    """
    channels = [microphone.channel for microphone in result.microphones]
    for number, microphone in enumerate(result.microphones):
        where = f"{path}: microphones[{number}]"
        if channels.count(microphone.channel) > 1:
            raise MethodError(f"{where}.channel: {microphone.channel} is listed twice: give each its own, {_AGAIN}")
        if microphone.channel not in result.recording.channels:
            raise MethodError(
                f"{where}.channel: {microphone.channel} is none of recording.channels: put it right, {_AGAIN}"
            )
        covariance = np.array(microphone.covariance_m2)
        largest = np.abs(covariance).max()
        lopsided = np.abs(covariance - covariance.T).max() > ASYMMETRY * largest
        if lopsided or np.linalg.eigvalsh(covariance)[0] < -ASYMMETRY * largest:
            raise MethodError(
                f"{where}.covariance_m2: not symmetric with no negative eigenvalue, so no covariance: put it right, "
                f"{_AGAIN}"
            )
