"""What the session can hardly tell, in words and millimetres, and what to capture to mend it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.joint.robust import JointSolution
from calib.joint.unknowns import CAMERA_VALUES
from rigs.description import Camera, Intrinsics

FloatArray = NDArray[np.float64]

LITTLE_TILT_DEG = 5.0
LARGE_STD_M = 0.002
STRAINED_SIGMAS = 3.0
CORRELATED = 0.5


def board_tilts_deg(rotations: FloatArray) -> tuple[float, float]:
    """Return how widely boards are tilted (root mean square) about the axis of most and of least tilt.

    Normals of boards that are tilted about one axis only lie on a great circle; the least tilt is that out of it.
    """
    normals = rotations[:, :, 2]
    _, most, least = np.linalg.svd(normals, compute_uv=False) / np.sqrt(len(normals))
    return float(np.degrees(most)), float(np.degrees(least))


def observability_doubts(
    solution: JointSolution, covariance: FloatArray, camera: Camera, channels: tuple[int, ...]
) -> list[str]:
    """Say what weakens the answer as a whole."""
    return [
        *_tilt_doubts(solution.at.rotations),
        *_focal_doubts(solution, camera),
        *_weakest_doubts(solution, covariance, len(channels)),
    ]


def weakest_motion(solution: JointSolution, covariance: FloatArray, n_mics: int) -> tuple[str, float]:
    """Name the motion of the array that is known worst and the unknown that goes along, with how well it is known.

    Returns
    -------
    The words, and the root mean square of the motion over the microphones, in metres (one standard deviation).
    """
    among = covariance[: 3 * n_mics, : 3 * n_mics]
    values, vectors = np.linalg.eigh(among)
    rms_m = float(np.sqrt(values[-1] / n_mics))
    motion = _named_motion(solution.at.microphones_m[:n_mics], vectors[:, -1])
    along = covariance[:, : 3 * n_mics] @ vectors[:, -1] / np.sqrt(values[-1])
    std = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    tied = np.where(np.diag(covariance) > 0, np.abs(along) / std, 0.0)
    tied[solution.at.blocks.microphones] = 0.0
    worst = int(np.argmax(tied))
    goes_along = f", along with {_unknown_name(solution, worst)}" if tied[worst] > CORRELATED else ""
    return f"the array is known worst in {motion}: {1e3 * rms_m:{_digits(rms_m)}} mm per microphone{goes_along}", rms_m


def _digits(rms_m: float) -> str:
    return ".1f" if rms_m >= LARGE_STD_M else ".2g"


def _tilt_doubts(rotations: FloatArray) -> list[str]:
    little = board_tilts_deg(rotations)[1]
    if little >= LITTLE_TILT_DEG:
        return []
    doubt = (
        f"the boards' tilts about one axis differ by {little:.1f} degrees only: focal length and depth can hardly be "
        "told apart; tilt the board by 30 degrees both ways, about both axes"
    )
    return [doubt]


def _focal_doubts(solution: JointSolution, camera: Camera) -> list[str]:
    if not isinstance(camera.intrinsics, Intrinsics):
        return []
    given_px, found_px = camera.intrinsics.focal_px[0], float(solution.at.camera[0])
    std_px = solution.problem.priors.std[solution.at.blocks.camera][0]
    if std_px == 0 or abs(found_px - given_px) < STRAINED_SIGMAS * std_px:
        return []
    doubt = (
        f"the focal length came out at {found_px:.0f} px, camera.intrinsics gives {given_px:.0f} px: sound and "
        "pictures do not agree on depth; calibrate the camera with tilted boards"
    )
    return [doubt]


def _weakest_doubts(solution: JointSolution, covariance: FloatArray, n_mics: int) -> list[str]:
    words, rms_m = weakest_motion(solution, covariance, n_mics)
    return [words] if rms_m >= LARGE_STD_M else []


def _named_motion(places_m: FloatArray, direction: FloatArray) -> str:
    centred_m = places_m - places_m.mean(axis=0)
    shifts = [np.tile(axis, (len(places_m), 1)) for axis in np.eye(3)]
    turns = [np.cross(axis, centred_m) for axis in np.eye(3)]
    names = [f"{kind} {axis}" for kind in ("its place along", "its turn about") for axis in "xyz"]
    motions = [*shifts, *turns, centred_m]
    shares = [abs(motion.ravel() @ direction) / max(float(np.linalg.norm(motion)), 1e-12) for motion in motions]
    return [*names, "its size"][int(np.argmax(shares))]


def _unknown_name(solution: JointSolution, place: int) -> str:
    blocks = solution.at.blocks
    if place < blocks.speed.start:
        return "a channel's delay"
    if place < blocks.buzzers.start:
        return "the speed of sound"
    if place < blocks.scale.start:
        return "the buzzers' places"
    if place < blocks.camera.start:
        return "the size of the squares"
    return f"the camera's {CAMERA_VALUES[place - blocks.camera.start]}"
