"""What a verification leaves: a folder with the figures, the pictures and the film, whole or not at all."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from calib.outputs import check_writable
from calib.verification.film import write_film
from calib.verification.movement import WHOLE_ARRAY
from calib.verification.overlay import bar_px, overlay
from calib.verification.pipeline import Verification
from calib.verification.statistics import Spread, spreads
from rigs import __version__
from rigs.errors import TargetError, TargetExistsError
from rigs.geometry import CAMERA_FRAME
from rigs.session.picture import encode
from rigs.session.reader import Session
from rigs.target import no_folder, whole_folder

Picture = NDArray[np.uint8]

FORMAT, VERSION = "acoustic-rig-verification", 1
FIGURES, FILM = "verification.yaml", "overlay.mp4"
MAX_PICTURES, MAX_SCENES = 12, 120


def check_folder(folder: Path, *, overwrite: bool) -> None:
    """Refuse early what `write_folder` would refuse; only an earlier verification is ever replaced.

    Raises
    ------
    TargetError
    """
    if folder.name in ("", "..") or not folder.parent.is_dir():
        raise TargetError(no_folder(folder))
    check_writable(folder.parent)
    if not (folder.exists() or folder.is_symlink()):
        return
    if not overwrite:
        raise TargetExistsError(f"{folder}: already there: add --overwrite, or name another --output")
    if folder.is_symlink() or not _is_ours(folder):
        raise TargetExistsError(f"{folder}: not a verification, so not replaced: name another --output")


def write_folder(
    verification: Verification,
    session: Session,
    folder: Path,
    *,
    overwrite: bool = False,
    tell: Callable[[str], None] = lambda _: None,
) -> str | None:
    """Write everything into a folder of its own and put that in place; return the film's codec, None without one.

    Raises
    ------
    TargetError
        Something of this name is there, or the folder cannot be written to.
    """
    check_folder(folder, overwrite=overwrite)
    with whole_folder(folder, replace=overwrite) as unfinished:
        codec = _write_pictures(verification, session, unfinished, tell) if len(session.frames) else None
        text = yaml.safe_dump(as_document(verification, codec), sort_keys=False, default_flow_style=None, width=200)
        (unfinished / FIGURES).write_text(text, encoding="utf-8")
    return codec


def as_document(verification: Verification, codec: str | None) -> dict[str, Any]:
    """Return the verification as plain values."""
    verdict, calibration = verification.verdict, verification.calibration
    document: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "frame": CAMERA_FRAME,
        "software": f"acoustic-camera-rig {__version__}",
        "passed": verdict.passed,
        "failures": list(verdict.failures),
        "limits": asdict(verdict.limits),
        "session": verification.session_name,
        "calibration": {
            "file": calibration.name,
            "method": calibration.method,
            "sessions": [{"name": name, "sha256": sha256} for sha256, name in calibration.sessions.items()],
            "made_again_without_these_poses": verification.made_again,
        },
        "speed_of_sound_m_s": round(verification.located.speed.m_s, 3),
        "speed_of_sound_std_m_s": round(verification.located.speed.std_m_s, 3),
        "n_emissions": len(verification.row),
        "n_located": int(verification.located.found.sum()),
        "errors": {spread.name: _figures(spread) for spread in spreads(verification)},
        "movement": _movement(verification),
        "warnings": list(verification.warnings),
        "emissions": list(_emissions(verification)),
    }
    if codec is not None:
        document["film"] = {"file": FILM, "codec": codec}
    return document


def _movement(verification: Verification) -> dict[str, Any]:
    verdict, movement = verification.verdict, verification.movement
    untold = movement.unseen(verdict.limits.moved_m)
    return {
        "told": not untold,
        **({"why_not": untold} if untold else {}),
        "smallest_told_m": float(f"{movement.resolution_m:.3g}") if movement.resolutions_m else None,
        "smallest_told_by_channel_m": {
            int(channel): float(f"{resolution_m:.3g}") for channel, resolution_m in movement.resolutions_m.items()
        },
        "unchecked_channels": list(verification.unchecked),
        "swapped_channels": [list(pair) for pair in movement.swapped],
        "another_rig": movement.is_foreign(verdict.limits.moved_m),
        "moved": [
            {
                "what": "array" if motion.channel == WHOLE_ARRAY else int(motion.channel),
                "shift_m": [round(float(value), 6) for value in motion.shift_m],
                "std_m": round(motion.std_m, 6),
                "farthest_m": round(motion.farthest_m, 6),
                "turn_deg": round(motion.turn_deg, 4),
                "alarm": motion in verdict.alarms,
            }
            for motion in movement.motions
        ],
    }


def _figures(spread: Spread) -> dict[str, Any]:
    return {
        key: None if value is None else float(f"{value:.4g}") for key, value in asdict(spread).items() if key != "name"
    }


def _emissions(verification: Verification) -> Iterator[dict[str, Any]]:
    comparison, located = verification.comparison, verification.located
    for number, row in enumerate(verification.row):
        entry: dict[str, Any] = {
            "row": int(row), "pose": int(verification.pose[number]), "buzzer": int(verification.buzzer[number]),
            "seen_px": [round(float(value), 3) for value in comparison.seen_px[number]],
        }  # fmt: skip
        if located.found[number]:
            entry |= {
                "located_px": [round(float(value), 3) for value in comparison.located_px[number]],
                "located_m": [round(float(value), 6) for value in located.places_m[number]],
                "error_px": round(float(comparison.error_px[number]), 3),
                "error_deg": round(float(comparison.error_deg[number]), 5),
                "error_m": round(float(comparison.error_m[number]), 6),
                "expected_px": round(float(comparison.expected_px[number]), 3),
            }
        if verification.maps is not None:
            entry["steered_px"] = [round(float(value), 2) for value in verification.maps[number].peak_px]
        yield entry


def _write_pictures(
    verification: Verification, session: Session, folder: Path, tell: Callable[[str], None]
) -> str | None:
    tell("drawing pictures")
    poses = np.unique(verification.pose)
    for pose in poses[_spread(len(poses), MAX_PICTURES)]:
        picture = overlay(_photo(session, int(pose)), verification, np.flatnonzero(verification.pose == pose))
        (folder / f"pose-{int(pose):03d}.png").write_bytes(encode(picture).tobytes())
    tell("drawing the film")
    scenes = _spread(len(verification.row), MAX_SCENES)
    width, height = verification.size_px
    return write_film(folder / FILM, _scenes(verification, session, scenes), (width, height + bar_px(width)))


def _scenes(verification: Verification, session: Session, scenes: NDArray[np.intp]) -> Iterator[Picture]:
    pose, photo = None, np.zeros((0, 0), dtype=np.uint8)
    for number in scenes:
        if verification.pose[number] != pose:
            pose = verification.pose[number]
            photo = _photo(session, int(pose))
        yield overlay(photo, verification, np.array([number]))


def _photo(session: Session, pose: int) -> Picture:
    """Return the middle frame of a pose."""
    frames = np.flatnonzero(session.frames["pose"] == pose)
    if len(frames) == 0:
        width, height = session.description.camera.size_px
        return np.zeros((height, width), dtype=np.uint8)
    return session.picture(int(frames[len(frames) // 2]))


def _spread(n: int, n_most: int) -> NDArray[np.intp]:
    """Choose at most so many of n things, evenly, the first and the last among them."""
    return np.unique(np.linspace(0, n - 1, min(n, n_most)).round().astype(np.intp))


def _is_ours(folder: Path) -> bool:
    try:
        with (folder / FIGURES).open("rb") as stream:
            return stream.read(64).startswith(f"format: {FORMAT}".encode())
    except OSError:
        return False
