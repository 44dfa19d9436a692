"""Which board position would help most: the one that shrinks the worst microphone's ellipsoid the most.

What a pose would tell follows from where it would be, not from what would be measured there: its normal equations at
the present answer, its own six unknowns eliminated, add to the information that the session has.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from calib.joint.arrivals import ArrivalTable
from calib.joint.corners import CornerTable, project
from calib.joint.problem import JointProblem, Weights
from calib.joint.robust import JointSolution
from calib.joint.uncertainty import microphone_covariances
from calib.joint.unknowns import Unknowns, rotation_matrices

FloatArray = NDArray[np.float64]

DEPTHS_M = (0.4, 0.5, 0.7, 1.0)  # those of the bench guide
ASIDE = (-0.3, 0.0, 0.3)  # of the depth
TILT_RAD = np.radians(30.0)
TILTS = ((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
MARGIN = 0.03  # of the picture's width, free around the board
# Which edge comes nearer by a negative and by a positive turn, about x (right) and about y (down), z being forward.
NEARER_EDGES = (("bottom", "top"), ("left", "right"))
ONE_AFTER_ANOTHER = "each counts on those before it being captured, too"


@dataclass(frozen=True)
class Suggestion:
    """A board position worth capturing.

    Parameters
    ----------
    centre_m : (3,) array
        Of the board's squares (the mean of its corners), camera frame.
    tilt_deg : (float, float)
        About the camera's x and y axes.
    worst_std_m : float
        What it would leave of the worst microphone's largest standard deviation, with those before it captured too.
    now_m : float
        What that is now.
    """

    centre_m: FloatArray
    tilt_deg: tuple[float, float]
    worst_std_m: float
    now_m: float

    def sentence(self) -> str:
        """Say where to hold the board, in words of the picture, and what that is good for."""
        x, y, z = 1e3 * self.centre_m
        tilts = [f"by {abs(angle):.0f} degrees with the edge at the picture's {edges[angle > 0]} nearer"
                 for angle, edges in zip(self.tilt_deg, NEARER_EDGES, strict=True) if angle]  # fmt: skip
        turned = f"tilted {' and '.join(tilts)}" if tilts else "facing the camera"
        return (
            f"centre of the squares at x {x:+.0f}, y {y:+.0f}, z {z:.0f} mm, {turned}: the worst microphone to "
            f"{1e3 * self.worst_std_m:#.3g} mm (now {1e3 * self.now_m:#.3g} mm)"
        )


def suggest_poses(
    solution: JointSolution, size_px: tuple[int, int], n_mics: int, n_poses: int
) -> tuple[float, list[Suggestion]]:
    """Choose board positions one after the other.

    Parameters
    ----------
    solution : JointSolution
    size_px : (int, int)
        Width and height of the picture.
    n_mics : int
        How many of the microphones count (the first ones).
    n_poses : int
        How many to suggest.

    Returns
    -------
    The worst microphone's largest standard deviation now, in metres, and the positions; fewer where none is in view.
    """
    information = solution.problem.free_equations(solution.at, solution.weights()).complement()
    candidates = _in_view(solution, size_px)
    gains = [_information_of(solution, pose) for _, _, pose in candidates]
    now_m = _worst_std_m(solution, information, n_mics)
    chosen: list[Suggestion] = []
    while candidates and len(chosen) < n_poses:
        left_m = [_worst_std_m(solution, information + gain, n_mics) for gain in gains]
        best = int(np.argmin(left_m))
        centre_m, tilt, _ = candidates.pop(best)
        information = information + gains.pop(best)
        degrees = (float(np.degrees(tilt[0])), float(np.degrees(tilt[1])))
        chosen.append(Suggestion(centre_m, degrees, left_m[best], now_m))
    return now_m, chosen


def _in_view(solution: JointSolution, size_px: tuple[int, int]) -> list[tuple[FloatArray, FloatArray, Unknowns]]:
    """Return centres, tilts and poses of the candidates whose corners and buzzers all lie in the picture."""
    corners = solution.problem.corners
    if corners is None:
        return []
    board_m = solution.at.scale * corners.board_m
    found = []
    for depth_m, aside, down, tilt in product(DEPTHS_M, ASIDE, ASIDE, TILTS):
        centre_m = depth_m * np.array([aside, down, 1.0])
        turn_rad = TILT_RAD * np.array([*tilt, 0.0])
        rotation = rotation_matrices(turn_rad[None])[0]
        place_m = centre_m - rotation @ board_m.mean(axis=0)
        shown_m = np.concatenate([board_m, solution.at.buzzers_m])
        pixels, _, _ = project(shown_m @ rotation.T + place_m, solution.at.camera)
        margin_px = MARGIN * size_px[0]
        if (pixels > margin_px).all() and (pixels < np.array(size_px) - margin_px).all():
            pose = replace(solution.at, rotations=rotation[None], translations_m=place_m[None])
            found.append((centre_m, turn_rad[:2], pose))
    return found


def _information_of(solution: JointSolution, pose: Unknowns) -> FloatArray:
    """Return what one pose would tell of the free shared unknowns, every buzzer heard and every corner seen."""
    problem, n_buzzers, n_mics = solution.problem, pose.blocks.n_buzzers, pose.blocks.n_mics
    std_s = np.nanmedian(np.where(solution.used_arrivals, problem.arrivals.std_s, np.nan)) * solution.scales.arrivals
    arrivals = ArrivalTable(
        np.zeros(n_buzzers, dtype=np.intp), np.arange(n_buzzers), np.zeros((n_buzzers, n_mics)),
        np.full((n_buzzers, n_mics), std_s),
    )  # fmt: skip
    assert problem.corners is not None
    std_px = problem.corners.std_px * solution.scales.corners
    corners = CornerTable(problem.corners.board_m, np.zeros((1, len(problem.corners.board_m), 2)), std_px)
    unprimed = replace(problem.priors, std=np.where(problem.priors.free, np.inf, 0.0))
    alone = JointProblem(arrivals, corners, unprimed)
    return alone.free_equations(pose, Weights(arrivals.information, corners.information)).complement()


def _worst_std_m(solution: JointSolution, information: FloatArray, n_mics: int) -> float:
    scale = np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)
    assert solution.problem.priors.free[: 3 * n_mics].all()  # so that microphones stand first among the free ones
    return float(np.sqrt(np.linalg.eigvalsh(microphone_covariances(covariance, n_mics))[:, -1].max()))
