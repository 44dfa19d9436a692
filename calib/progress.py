"""How far a session is calibrated, as plain values: a line of `rig-calibrate --follow`, in docs/calibration.md."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from calib.result import Calibration
from rigs.session.reader import Session

FORMAT = "acoustic-rig-progress"
VERSION = 1


def progress(
    state: str, session: Session, result: Calibration | None = None, *, missing: str | None = None,
    target: Path | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Return what is known so far; every key is always there, None where there is nothing to say.

    Parameters
    ----------
    state : {"waiting", "solved", "closed", "cut off"}
    session : Session
    result : Calibration or None
    missing : str or None
        Why there is no result.
    target : Path or None
        Where the result was written.
    """
    said = {
        "format": FORMAT,
        "version": VERSION,
        "state": state,
        "session": session.name,
        "n_poses": int(np.count_nonzero(session.poses["accepted"])),
        "poses_needed": session.description.min_poses,
        "missing": missing,
        "result": None if target is None else str(target),
    }
    return said | (_figures(result) if result is not None else dict.fromkeys(FIGURES))


FIGURES = (
    "poses_used", "rms_std_m", "rmse_m", "worst", "weakest", "microphones", "speed_of_sound_m_s",
    "speed_of_sound_std_m_s", "residual_s", "n_rejected", "warnings", "next_pose",
)  # fmt: skip


def _figures(result: Calibration) -> dict[str, Any]:
    worst_m = result.worst_std_m
    worst = int(np.argmax(worst_m))
    microphones = [
        {"channel": channel, "position_m": _short(position_m), "std_m": _short(std_m), "worst_std_m": _short(own_m)}
        for channel, position_m, std_m, own_m in zip(
            result.channels, result.positions_m, result.std_m, worst_m, strict=True
        )
    ]
    figures = (
        len(result.view.pose),
        _short(np.sqrt(np.trace(result.array_covariance_m2) / len(result.channels))),
        None if result.evaluation is None else _short(result.evaluation.rmse_m),
        {"channel": result.channels[worst], "std_m": _short(worst_m[worst])},
        None if result.weakest is None else asdict(result.weakest) | {"std_m": _short(result.weakest.std_m)},
        microphones,
        round(result.speed_of_sound_m_s, 4),
        _short(result.speed_of_sound_std_m_s),
        _short(result.residual.robust_sigma_s),
        result.residual.n_rejected,
        list(result.warnings),
        _next_pose(result),
    )
    return dict(zip(FIGURES, figures, strict=True))


def _next_pose(result: Calibration) -> dict[str, Any] | None:
    if not result.suggestions:
        return None
    suggestion = result.suggestions[0]
    return {
        "text": suggestion.sentence(),
        "centre_m": _short(suggestion.centre_m),
        "tilt_deg": _short(suggestion.tilt_deg),
        "worst_std_m": _short(suggestion.worst_std_m),
    }


def _short(values: Any) -> Any:
    """Return numbers with six digits."""
    if np.ndim(values) == 0:
        return float(f"{float(values):.6g}")
    return [float(f"{value:.6g}") for value in values]
