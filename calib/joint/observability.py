"""What the session can hardly tell, in words and millimetres, and what to capture to mend it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.joint.robust import JointSolution
from calib.joint.unknowns import CAMERA_VALUES
from rigs.description import Camera, Intrinsics

FloatArray = NDArray[np.float64]

LITTLE_TILT_DEG = 5.0
BENT_M = 0.001
LARGE_STD_M = 0.002
STRAINED_SIGMAS = 3.0
CORRELATED = 0.5


@dataclass(frozen=True)
class Weakest:
    """How the array is known worst.

    Parameters
    ----------
    motion : str
        In words.
    std_m : float
        Root mean square over the microphones.
    along_with : str or None
        The unknown that goes along with it, if one does.
    """

    motion: str
    std_m: float
    along_with: str | None


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
        *_flatness_doubts(solution),
        *_focal_doubts(solution, camera),
        *_weakest_doubts(weakest_motion(solution, covariance, len(channels))),
    ]


def _tilt_doubts(rotations: FloatArray) -> list[str]:
    little = board_tilts_deg(rotations)[1]
    if little >= LITTLE_TILT_DEG:
        return []
    doubt = (
        f"the boards' tilts about one axis differ by {little:.1f} degrees only: focal length and depth can hardly be "
        "told apart; tilt the board by 30 degrees both ways, about both axes"
    )
    return [doubt]


def _flatness_doubts(solution: JointSolution) -> list[str]:
    """Say how bent the board is: what is left of its corners' heights over the plane that fits them best."""
    corners, heights_m = solution.problem.corners, solution.at.shared[solution.at.blocks.corners][2::3]
    if corners is None or not len(heights_m):
        return []
    plane = np.column_stack([corners.board_m[:, :2], np.ones(len(heights_m))])
    bend_m = float(np.ptp(heights_m - plane @ np.linalg.lstsq(plane, heights_m, rcond=None)[0]))
    if bend_m < BENT_M:
        return []
    doubt = (
        f"the board is bent by {1e3 * bend_m:.1f} mm: its shape was found along with the rest, but a stiff and flat "
        "plate needs fewer poses"
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
        f"the focal length came out at {found_px:.0f} px, camera.intrinsics gives {given_px:.0f} px: "
        "this session does not agree with it; calibrate the camera with a flat board, tilted both ways"
    )
    return [doubt]


def weakest_motion(solution: JointSolution, covariance: FloatArray, n_mics: int) -> Weakest:
    """Return the motion of the array that is known worst, and the unknown that goes along with it."""
    values, vectors = np.linalg.eigh(covariance[: 3 * n_mics, : 3 * n_mics])
    motion = _named_motion(solution.at.microphones_m[:n_mics], vectors[:, -1])
    along = covariance[:, : 3 * n_mics] @ vectors[:, -1] / np.sqrt(values[-1])
    std = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    tied = np.where(np.diag(covariance) > 0, np.abs(along) / std, 0.0)
    tied[solution.at.blocks.microphones] = 0.0
    worst = int(np.argmax(tied))
    goes_along = _unknown_name(solution, worst) if tied[worst] > CORRELATED else None
    return Weakest(motion, float(np.sqrt(values[-1] / n_mics)), goes_along)


def _weakest_doubts(weakest: Weakest) -> list[str]:
    if weakest.std_m < LARGE_STD_M:
        return []
    goes_along = f", along with {weakest.along_with}" if weakest.along_with else ""
    return [f"the array is known worst in {weakest.motion}: {1e3 * weakest.std_m:.1f} mm per microphone{goes_along}"]


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
    if blocks.camera.start <= place < blocks.camera.stop:
        return f"the camera's {CAMERA_VALUES[place - blocks.camera.start]}"
    names = {
        "a channel's delay": blocks.delays,
        "the speed of sound": blocks.speed,
        "the buzzers' places": blocks.buzzers,
        "the size of the squares": blocks.scale,
        "the flatness of the board": blocks.corners,
        "a buzzer's latency after the sync output": blocks.latencies,
    }
    return next(name for name, block in names.items() if block.start <= place < block.stop)
