"""The result of a calibration, and the YAML file it leaves."""

from __future__ import annotations

import os
import tempfile
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from calib.camera import View
from calib.evaluation import Evaluation
from calib.evidence import Evidence
from calib.joint.next_pose import Suggestion
from calib.joint.observability import Weakest
from calib.joint.uncertainty import microphone_covariances
from calib.rejections import KINDS, Rejection
from calib.settings import Settings
from rigs import __version__
from rigs.description import RigDescription
from rigs.errors import TargetError, TargetExistsError, reason
from rigs.geometry import CAMERA_FRAME, TDOA_SIGN
from rigs.target import check_target

FloatArray = NDArray[np.float64]

SOFTWARE = f"acoustic-camera-rig {__version__}"
FORMAT = "acoustic-rig-calibration"
VERSION = 1


@dataclass(frozen=True)
class Residual:
    """How well TDOAs fit: robust standard deviation of all, root mean square of those used, and how many."""

    robust_sigma_s: float
    rms_s: float
    n_used: int
    n_rejected: int


@dataclass(frozen=True)
class HeldOut:
    """How well poses are predicted that took no part in the solve.

    Parameters
    ----------
    median_s : float
        Median absolute TDOA residual.
    robust_sigma_s : float
        1.4826 times that.
    spread_m : float
        Root mean square distance of a fold's microphones from their mean over the folds.
    """

    median_s: float
    robust_sigma_s: float
    spread_m: float


@dataclass(frozen=True)
class Recording:
    """What tools that read the session beside the result need to know of it.

    Parameters
    ----------
    sample_rate_hz : float
    channels : tuple of int
        Input channel of each column of `time_data`.
    picture_size_px : (int, int)
        Width and height.
    """

    sample_rate_hz: float
    channels: tuple[int, ...]
    picture_size_px: tuple[int, int]

    @classmethod
    def by(cls, description: RigDescription) -> Recording:
        """Return how a rig records."""
        audio = description.audio
        return cls(float(audio.sample_rate_hz), audio.recorded_channels(), description.camera.size_px)


@dataclass(frozen=True)
class SessionShare:
    """One of several sessions that a result rests on; each has a speed of sound of its own."""

    name: str
    sha256: str
    n_poses: int
    speed_of_sound_m_s: float
    speed_of_sound_std_m_s: float


@dataclass(frozen=True)
class Calibration:
    """Microphones in the camera frame.

    Parameters
    ----------
    session_name, session_sha256 : str
        What it was made from.
    method : str
    channels : tuple of int
        Input channel of each microphone.
    positions_m : (n_mics, 3) array
        Camera frame.
    array_covariance_m2 : (3 n_mics, 3 n_mics) array
        Of all microphones together.
    speed_of_sound_m_s, speed_of_sound_std_m_s : float
        Where the speed is held, the standard deviation is the rig description's.
    view : View
        Camera and board poses.
    recording : Recording
        How the session was recorded, of several the first.
    residual : Residual
    evaluation : Evaluation or None
    warnings : list of str
    sound : dict or None
        What was heard and what was wrong with it, in plain values; None where TDOAs were not measured in sound.
    held_out : HeldOut or None
        None for the paper's methods.
    suggestions : tuple of Suggestion
        Further board positions that would help most, the best first.
    evidence : Evidence or None
        Residuals of all measurements, for the report; the YAML file leaves them out.
    held : tuple of str
        Blocks of unknowns that the method was told to hold.
    weakest : Weakest or None
        How the array is known worst; None for the paper's methods.
    rejections : tuple of Rejection
        What the result does not rest on, and why.
    sessions : tuple of SessionShare
        Where it was made from several; the speed of sound is then their mean.
    settings : Settings
        What was chosen, so that it can be made again.
    """

    session_name: str
    session_sha256: str
    method: str
    channels: tuple[int, ...]
    positions_m: FloatArray
    array_covariance_m2: FloatArray
    speed_of_sound_m_s: float
    speed_of_sound_std_m_s: float
    view: View
    recording: Recording
    residual: Residual
    evaluation: Evaluation | None
    warnings: list[str]
    sound: dict[str, Any] | None = None
    held_out: HeldOut | None = None
    suggestions: tuple[Suggestion, ...] = ()
    held: tuple[str, ...] = ()
    weakest: Weakest | None = None
    rejections: tuple[Rejection, ...] = ()
    sessions: tuple[SessionShare, ...] = ()
    evidence: Evidence | None = None
    settings: Settings = field(default_factory=Settings)

    @property
    def covariance_m2(self) -> FloatArray:
        """Covariance (n_mics, 3, 3) of each microphone."""
        return microphone_covariances(self.array_covariance_m2, len(self.channels))

    @property
    def worst_std_m(self) -> FloatArray:
        """Standard deviation (n_mics,) of each microphone in its weakest direction."""
        return np.asarray(np.sqrt(np.linalg.eigvalsh(self.covariance_m2)[:, -1]))

    @property
    def std_m(self) -> FloatArray:
        """Standard deviations (n_mics, 3) of the positions."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance_m2, axis1=1, axis2=2)))


def as_document(result: Calibration) -> dict[str, Any]:
    """Return the result as plain values, as they stand in the YAML file."""
    document: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "frame": CAMERA_FRAME,
        "tdoa_sign": TDOA_SIGN,
        "method": result.method,
        "held": list(result.held),
        "settings": _settings(result.settings),
        "software": SOFTWARE,
        "speed_of_sound_m_s": _rounded(result.speed_of_sound_m_s, 4),
        "speed_of_sound_std_m_s": _rounded(result.speed_of_sound_std_m_s, 4),
        "microphones": [
            {
                "channel": int(channel),
                "position_m": _rounded(position, 7),
                "std_m": _rounded(std, 7),
                "covariance_m2": _significant(covariance),
            }
            for channel, position, std, covariance in zip(
                result.channels, result.positions_m, result.std_m, result.covariance_m2, strict=True
            )
        ],
        "residual": {
            "robust_sigma_s": float(f"{result.residual.robust_sigma_s:.6g}"),
            "rms_s": float(f"{result.residual.rms_s:.6g}"),
            "n_used": result.residual.n_used,
            "n_rejected": result.residual.n_rejected,
        },
        "camera": {
            "source": result.view.source,
            "focal_px": _rounded(result.view.intrinsics.focal_px, 4),
            "principal_px": _rounded(result.view.intrinsics.principal_px, 4),
            "distortion": _rounded(result.view.intrinsics.distortion, 8),
            "corner_rms_px": _rounded(result.view.rms_px, 4),
            "n_poses": len(result.view.board_to_camera),
        },
        "recording": {
            "sample_rate_hz": float(result.recording.sample_rate_hz),
            "channels": list(result.recording.channels),
            "picture_size_px": list(result.recording.picture_size_px),
        },
        "warnings": list(result.warnings),
    }
    if result.sessions:
        document["sessions"] = [
            asdict(share) | {name: _rounded(getattr(share, name), 4) for name in asdict(share) if "speed" in name}
            for share in result.sessions
        ]
    else:
        document["session"] = {"name": result.session_name, "sha256": result.session_sha256}
    if result.held_out is not None:
        document["held_out"] = {name: float(f"{value:.6g}") for name, value in asdict(result.held_out).items()}
    if result.weakest is not None:
        document["weakest"] = asdict(result.weakest) | {"std_m": _rounded(result.weakest.std_m, 7)}
    if result.suggestions:
        document["suggested_poses"] = [suggestion.sentence() for suggestion in result.suggestions]
    if result.sound is not None:
        document["sound"] = result.sound
    if result.rejections:
        document["rejected"] = {
            f"{kind}s": [rejection.document() for rejection in result.rejections if rejection.kind == kind]
            for kind in KINDS
        }
    if result.evaluation is not None:
        document["evaluation"] = asdict(result.evaluation)
    document["array_covariance_m2"] = _significant(result.array_covariance_m2)
    return document


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
    text = yaml.safe_dump(as_document(result), sort_keys=False, default_flow_style=None, width=120)
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise TargetError(f"{path}: cannot be made ({reason(error)}): choose another folder") from error
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        Path(temporary).chmod(0o644)
        _put_in_place(Path(temporary), path, overwrite=overwrite)
    finally:
        Path(temporary).unlink(missing_ok=True)


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


def _settings(settings: Settings) -> dict[str, Any]:
    """Return what was chosen besides the method, and what changes nothing of the answer."""
    chosen = {name: value for name, value in asdict(settings).items() if name not in {"method", "suggest_poses"}}
    return {name: list(value) if isinstance(value, tuple) else value for name, value in chosen.items()}


def _rounded(values: Any, digits: int) -> Any:
    if np.ndim(values) == 0:
        return round(float(values), digits)
    return [round(float(value), digits) for value in values]


def _significant(matrix: FloatArray) -> list[list[float]]:
    """Return a covariance to nine digits, the same for one microphone and for all."""
    return [[float(f"{value:.9g}") for value in row] for row in matrix]
