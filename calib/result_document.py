"""The document of a result: plain values, as they stand in its YAML file."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.rejections import KINDS
from calib.result import SOFTWARE, Calibration
from calib.settings import Settings
from rigs.geometry import CAMERA_FRAME, TDOA_SIGN

FloatArray = NDArray[np.float64]

DIGESTED = ("speed_of_sound_m_s", "speed_of_sound_std_m_s", "microphones", "camera", "recording", "array_covariance_m2")
FORMAT = "acoustic-rig-calibration"
VERSION = 1


def as_document(result: Calibration) -> dict[str, Any]:
    """Return the result as plain values."""
    document = _without_digest(result)
    return document | {"digest": digest_of(document)}


def digest_of(document: dict[str, Any]) -> str:
    """Return the SHA-256 of what is used of a result, to tell that a hand has changed it."""
    used = {key: document.get(key) for key in DIGESTED}
    return f"sha256:{hashlib.sha256(json.dumps(used, sort_keys=True, default=str).encode()).hexdigest()}"


def _without_digest(result: Calibration) -> dict[str, Any]:
    return {
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
        "microphones": _microphones(result),
        "residual": {name: _six_digits(value) for name, value in asdict(result.residual).items()},
        "camera": _camera(result),
        "recording": {
            "sample_rate_hz": float(result.recording.sample_rate_hz),
            "channels": list(result.recording.channels),
            "picture_size_px": list(result.recording.picture_size_px),
        },
        "warnings": list(result.warnings),
        **_sources(result),
        **_findings(result),
        "array_covariance_m2": _significant(result.array_covariance_m2),
    }


def _microphones(result: Calibration) -> list[dict[str, Any]]:
    return [
        {
            "channel": int(channel),
            "position_m": _rounded(position, 7),
            "std_m": _rounded(std, 7),
            "covariance_m2": _significant(covariance),
        }
        for channel, position, std, covariance in zip(
            result.channels, result.positions_m, result.std_m, result.covariance_m2, strict=True
        )
    ]


def _camera(result: Calibration) -> dict[str, Any]:
    intrinsics = result.view.intrinsics
    return {
        "source": result.view.source,
        "focal_px": _rounded(intrinsics.focal_px, 4),
        "principal_px": _rounded(intrinsics.principal_px, 4),
        "distortion": _rounded(intrinsics.distortion, 8),
        "corner_rms_px": _rounded(result.view.rms_px, 4),
        "n_poses": len(result.view.board_to_camera),
    }


def _sources(result: Calibration) -> dict[str, Any]:
    if not result.sessions:
        return {"session": {"name": result.session_name, "sha256": result.session_sha256}}
    shares = [asdict(share) for share in result.sessions]
    return {
        "sessions": [
            {name: _rounded(value, 4) if "speed" in name else value for name, value in share.items()}
            for share in shares
        ]
    }


def _findings(result: Calibration) -> dict[str, Any]:
    """Return what not every result has."""
    found: dict[str, Any] = {}
    if result.held_out is not None:
        found["held_out"] = {name: _six_digits(value) for name, value in asdict(result.held_out).items()}
    if result.weakest is not None:
        found["weakest"] = asdict(result.weakest) | {"std_m": _rounded(result.weakest.std_m, 7)}
    if result.suggestions:
        found["suggested_poses"] = [suggestion.sentence() for suggestion in result.suggestions]
    if result.sound is not None:
        found["sound"] = result.sound
    if result.delays is not None:
        names = [share.name for share in result.sessions] or [result.session_name]
        found["delays"] = [
            {"session": name, "channel": int(channel), "delay_s": _six_digits(delay_s), "std_s": _six_digits(std_s)}
            for name, delays_s, stds_s in zip(names, result.delays.delay_s, result.delays.std_s, strict=True)
            for channel, delay_s, std_s in zip(result.channels, delays_s, stds_s, strict=True)
        ]
    if result.rejections:
        found["rejected"] = {
            f"{kind}s": [rejection.document() for rejection in result.rejections if rejection.kind == kind]
            for kind in KINDS
        }
    if result.evaluation is not None:
        found["evaluation"] = asdict(result.evaluation)
    return found


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


def _six_digits(value: float) -> float:
    return value if isinstance(value, int) else float(f"{value:.6g}")
