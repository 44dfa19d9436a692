"""A calibration as its file has it: read, checked, and compared with the session it is to be used on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from calib.errors import ResultFileError
from calib.result import FORMAT, VERSION
from calib.settings import Method
from rigs.description import Intrinsics, RigDescription
from rigs.errors import reason

FloatArray = NDArray[np.float64]

LARGEST_FILE = 10_000_000
MIN_CHANNELS = 5  # four find a place, the fifth tells whether it is right
ROUNDING = 1e-4  # of the larger of two entries that should be alike


@dataclass(frozen=True)
class ArrayCalibration:
    """What verification needs of a calibration.

    Parameters
    ----------
    method : str
    channels : tuple of int
        Input channel of each microphone.
    positions_m : (n_mics, 3) array
        Camera frame.
    covariance_m2 : (3 n_mics, 3 n_mics) array
        Of all coordinates together.
    speed_of_sound_m_s, speed_of_sound_std_m_s : float
        Of the air at the time.
    intrinsics : Intrinsics
    sessions : dict of str to str
        What it was made from: SHA-256 of each session, and its name.
    """

    method: Method
    channels: tuple[int, ...]
    positions_m: FloatArray
    covariance_m2: FloatArray
    speed_of_sound_m_s: float
    speed_of_sound_std_m_s: float
    intrinsics: Intrinsics
    sessions: dict[str, str]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, allow_inf_nan=False)


Metres = Annotated[float, Field(ge=-100, le=100)]
Row = tuple[float, float, float]


class _Microphone(_Part):
    channel: Annotated[int, Field(ge=1, le=1024)]
    position_m: tuple[Metres, Metres, Metres]
    covariance_m2: tuple[Row, Row, Row]


class _Camera(_Part):
    focal_px: tuple[float, float]
    principal_px: tuple[float, float]
    distortion: tuple[float, float, float, float, float]


class _Session(_Part):
    name: str
    sha256: str


class _Document(_Part):
    method: Method
    speed_of_sound_m_s: Annotated[float, Field(ge=250, le=450)]
    speed_of_sound_std_m_s: Annotated[float, Field(ge=0, le=50)]
    microphones: Annotated[list[_Microphone], Field(min_length=1, max_length=64)]
    array_covariance_m2: list[list[float]]
    camera: _Camera
    session: _Session | None = None
    sessions: tuple[_Session, ...] = ()


def read_calibration(path: Path) -> ArrayCalibration:
    """Read a result of `rig-calibrate`.

    Raises
    ------
    ResultFileError
        Naming what is wrong, and where in the file.
    """
    document = _document(path)
    try:
        stored = _Document.model_validate(document)
        intrinsics = Intrinsics(**stored.camera.model_dump())
    except ValidationError as error:
        raise ResultFileError(f"{path}: {_first_fault(error)}; {_AGAIN}") from error
    sessions = stored.sessions if stored.session is None else (stored.session,)
    if not sessions:
        raise ResultFileError(f"{path}: session: field required; {_AGAIN}")
    channels = tuple(microphone.channel for microphone in stored.microphones)
    if len(set(channels)) < len(channels):
        raise ResultFileError(f"{path}: microphones: a channel is listed twice; {_AGAIN}")
    return ArrayCalibration(
        stored.method,
        channels,
        np.array([microphone.position_m for microphone in stored.microphones]),
        _whole_covariance(path, stored),
        stored.speed_of_sound_m_s,
        stored.speed_of_sound_std_m_s,
        intrinsics,
        {session.sha256: session.name for session in sessions},
    )


def check_fit(calibration: ArrayCalibration, description: RigDescription, path: Path) -> None:
    """Refuse a calibration that cannot be of the rig that recorded a session.

    Raises
    ------
    ResultFileError
    """
    n_known, present = len(calibration.channels), description.audio.channels
    if n_known < MIN_CHANNELS:
        raise ResultFileError(
            f"{path}: it has {n_known} microphones, at least {MIN_CHANNELS} are needed to locate and to check a sound"
        )
    strange = [channel for channel in calibration.channels if channel not in present]
    if strange:
        raise ResultFileError(
            f"{path}: it has a microphone on channel {strange[0]}, the session's rig ({description.name}) has "
            f"{', '.join(map(str, present))}: is it another rig's calibration?"
        )
    middle_px = np.array(calibration.intrinsics.principal_px) / np.array(description.camera.size_px)
    if not ((middle_px > 0.25) & (middle_px < 0.75)).all():
        width, height = description.camera.size_px
        raise ResultFileError(
            f"{path}: its camera's middle lies at {calibration.intrinsics.principal_px[0]:.0f}, "
            f"{calibration.intrinsics.principal_px[1]:.0f} px, the session's pictures are {width} x {height}: is it "
            "another camera's calibration, or one at another picture size?"
        )


_AGAIN = "was it edited by hand? Make it again with rig-calibrate"


def _document(path: Path) -> Mapping[str, Any]:
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise ResultFileError(f"{path}: far too large for a calibration: name a .calib.yaml")
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ResultFileError(f"{path}: {reason(error)}: name a result of rig-calibrate") from error
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError, ValueError) as error:
        raise ResultFileError(f"{path}: not readable as YAML ({reason(error)}); {_AGAIN}") from error
    if not isinstance(document, Mapping) or document.get("format") != FORMAT:
        raise ResultFileError(f"{path}: not a result of rig-calibrate: name a .calib.yaml")
    if document.get("version") != VERSION:
        raise ResultFileError(
            f"{path}: of version {document.get('version')!r}, this software reads {VERSION}: use what made it"
        )
    if "array_covariance_m2" not in document:
        raise ResultFileError(
            f"{path}: has no array_covariance_m2, so expected errors are unknown: make it again with rig-calibrate"
        )
    return document


def _first_fault(error: ValidationError) -> str:
    fault = error.errors()[0]
    where = ".".join(str(part) for part in fault["loc"]) or "the file"
    return f"{where}: {fault['msg'][0].lower()}{fault['msg'][1:]}"


def _whole_covariance(path: Path, stored: _Document) -> FloatArray:
    """Return the covariance of all coordinates.

    Raises
    ------
    ResultFileError
        It is no covariance, or not that of the microphones beside it.
    """
    size = 3 * len(stored.microphones)
    rows = stored.array_covariance_m2
    if [len(row) for row in rows] != [size] * size:
        raise ResultFileError(
            f"{path}: array_covariance_m2: not the {size} x {size} numbers that {len(stored.microphones)} microphones "
            f"need; {_AGAIN}"
        )
    covariance = np.array(rows)
    blocks = np.array([microphone.covariance_m2 for microphone in stored.microphones])
    scale = float(np.diag(covariance).max())
    for number, block in enumerate(blocks):
        place = slice(3 * number, 3 * number + 3)
        if np.abs(covariance[place, place] - block).max() > ROUNDING * scale:
            raise ResultFileError(
                f"{path}: microphones.{number}.covariance_m2 and array_covariance_m2 contradict each other; {_AGAIN}"
            )
    uneven = float(np.abs(covariance - covariance.T).max())
    if not scale > 0 or uneven > ROUNDING * scale or np.linalg.eigvalsh(covariance)[0] < -ROUNDING * scale:
        raise ResultFileError(f"{path}: array_covariance_m2: not a covariance; {_AGAIN}")
    return covariance
