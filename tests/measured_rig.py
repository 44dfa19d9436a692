"""A rig whose corners and arrivals are drawn with Gaussian noise, without pictures or sound: a session at once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from conftest import BUZZERS_M, MICROPHONES_M, board_poses

from calib.camera import View, look
from calib.corners import PoseCorners
from calib.emissions import EmissionTdoas
from calib.flaws import Flaws
from calib.joint.arrivals import ArrivalTable
from calib.joint.assemble import assemble
from calib.joint.corners import CornerTable
from calib.joint.priors import corner_std_m, n_corners
from calib.joint.problem import JointProblem, Weights
from calib.joint.robust import JointSolution, solve_robustly
from calib.joint.start import find_start
from calib.joint.uncertainty import shared_covariance
from calib.joint.unknowns import Unknowns
from calib.sound import SoundArrivals
from rigs.board import board_corners_m
from rigs.description import RigDescription
from rigs.geometry import Pose
from rigs.library import find_description

CHANNELS = tuple(range(1, 9))
CAMERA = np.array([940.0, 938.0, 645.0, 356.0, 0.05, -0.08, 0.0005, -0.0004, 0.0])


@dataclass(frozen=True)
class Rig:
    """Truth and measurements.

    Parameters
    ----------
    description : RigDescription
    truth : Unknowns
    corners_px : (n_poses, n_corners, 2) array
    arrival_s, std_s : (n_emissions, 8) arrays
    corner_std_px : float
    """

    description: RigDescription
    truth: Unknowns
    corners_px: np.ndarray
    arrival_s: np.ndarray
    std_s: np.ndarray
    corner_std_px: float

    @property
    def pose(self) -> np.ndarray:
        return np.repeat(np.arange(len(self.truth.rotations), dtype=np.int32), len(BUZZERS_M))

    @property
    def corners(self) -> PoseCorners:
        return PoseCorners(np.arange(len(self.corners_px), dtype=np.int32), self.corners_px)

    @property
    def tdoas(self) -> EmissionTdoas:
        columns = np.array(list(combinations(range(8), 2)), dtype=np.int32)
        n = len(self.arrival_s)
        sound = SoundArrivals("matched", np.arange(n), CHANNELS, self.arrival_s, self.std_s, Flaws((n, 8)), np.ones(n))
        buzzer = np.tile(np.arange(1, len(BUZZERS_M) + 1, dtype=np.int32), n // len(BUZZERS_M))
        tdoa_s = self.arrival_s[:, columns[:, 1]] - self.arrival_s[:, columns[:, 0]]
        return EmissionTdoas(self.pose, buzzer, tdoa_s, columns + 1, [], sound)

    def view(self) -> View:
        return look(self.description.camera, self.description.board, self.corners)

    def assembled(self, *, channels: tuple[int, ...] = CHANNELS, **changes) -> tuple[JointProblem, Unknowns]:
        return assemble(self.description, self.view(), self.corners, self.tdoas, channels, **changes)

    def solved(self, **changes) -> JointSolution:
        problem, guess = self.assembled(**changes)
        return solve_robustly(problem, find_start(problem, guess, 0).at)

    def bound(self, **changes) -> np.ndarray:
        """Return the covariance that no estimator beats, priors counted in: at the truth, with the true variances."""
        problem, _ = self.assembled(**changes)
        stated = problem.stated_weights()
        corners = stated.corners * problem.corners.std_px**2 / self.corner_std_px**2
        return shared_covariance(problem, self.truth, Weights(stated.arrivals, corners))

    def errors_m(self, solution: JointSolution) -> np.ndarray:
        return solution.at.microphones_m - self.truth.microphones_m

    def with_outliers(self, share: float, seed: int = 0, size_s: float = 2e-3) -> Rig:
        generator = np.random.default_rng(seed)
        wrong = generator.random(self.arrival_s.shape) < share
        off_s = generator.uniform(-size_s, size_s, wrong.shape)
        return replace(self, arrival_s=np.where(wrong, self.arrival_s + off_s, self.arrival_s))


def bent_rig() -> RigDescription:
    """Return the simulated rig with a board of paper on cardboard."""
    description = find_description("simulated").description
    board = description.board.model_copy(update={"print_std_m": 1e-4, "flatness_std_m": 1e-3})
    return description.model_copy(update={"board": board})


def make_rig(
    seed: int = 0,
    *,
    n_poses: int = 25,
    arrival_std_s: float = 0.5e-6,
    corner_std_px: float = 0.05,
    description: RigDescription | None = None,
    poses: list[Pose] | None = None,
    microphones_m: np.ndarray = MICROPHONES_M,
) -> Rig:
    """Draw a rig: everything that its description admits to know badly is wrong by as much."""
    description = description or find_description("simulated").description
    generator = np.random.default_rng([seed, 1])
    board, medium = description.board, description.medium
    poses = poses or board_poses(n_poses, seed)
    buzzers_m = np.array([buzzer.position_m for buzzer in board.buzzers])
    truth = Unknowns.of(
        microphones_m + 0.005 * generator.standard_normal(microphones_m.shape),
        medium.speed_m_s() + medium.speed_std_m_s() * generator.standard_normal(),
        buzzers_m + board.buzzer_std_m * generator.standard_normal(buzzers_m.shape),
        CAMERA,
        poses,
        n_corners(board),
    )
    shared = truth.shared.copy()
    shared[truth.blocks.scale] += board.square_size_std_m / board.square_size_m * generator.standard_normal()
    bent = np.random.default_rng([seed, 3]).standard_normal((n_corners(board), 3))
    shared[truth.blocks.corners] = (corner_std_m(board) * bent).ravel()
    truth = replace(truth, shared=shared)
    corners = CornerTable(board_corners_m(board), np.zeros((len(poses), board.corners[0] * board.corners[1], 2)), 1.0)
    corners_px = -corners.residuals_px(truth)
    corners_px += corner_std_px * generator.standard_normal(corners_px.shape)
    pose = np.repeat(np.arange(len(poses)), len(buzzers_m))
    buzzer = np.tile(np.arange(len(buzzers_m)), len(poses))
    std_s = arrival_std_s * generator.uniform(0.5, 2.0, (len(pose), len(microphones_m)))
    table = ArrivalTable(pose, buzzer, np.zeros_like(std_s), std_s)
    arrival_s = table.flights(truth).times_s + std_s * generator.standard_normal(std_s.shape)
    arrival_s += np.arange(len(pose))[:, None]  # when each emission began
    return Rig(description, truth, corners_px, arrival_s, std_s, corner_std_px)
