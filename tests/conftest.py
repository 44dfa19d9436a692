"""Synthetic truth for the tests: an array, board poses, and TDOAs with noise of a known size."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from calib.problem import Estimate, TdoaProblem
from rigs.description import RigDescription
from rigs.geometry import Pose
from rigs.library import find_description

SPEED_M_S = 343.0
MICROPHONES_M = np.array(
    [
        (-0.21, -0.19, -0.18),
        (0.20, -0.22, -0.20),
        (-0.20, 0.21, -0.17),
        (0.19, 0.20, -0.21),
        (-0.22, -0.20, 0.16),
        (0.21, -0.21, 0.18),
        (-0.19, 0.22, 0.19),
        (0.22, 0.19, 0.17),
    ]
)
BUZZERS_M = np.array([(x, y, -0.005) for x in (-0.045, 0.1, 0.245) for y in (-0.045, 0.17)])
AISLAB = Path(__file__).parents[2] / "shared" / "data" / "aislab"


@dataclass(frozen=True)
class World:
    """What is true, and the problem that noisy measurements of it pose."""

    problem: TdoaProblem
    poses: list[Pose]
    truth: Estimate


def board_poses(n_poses: int, seed: int) -> list[Pose]:
    """Draw board poses 0.4 to 1 m before the camera, tilted by up to 35 degrees."""
    generator = np.random.default_rng(seed)
    poses = []
    for _ in range(n_poses):
        tilt = np.append(generator.uniform(-0.6, 0.6, 2), generator.uniform(-0.3, 0.3))
        depth_m = generator.uniform(0.4, 1.0)
        centre_m = np.append(generator.uniform(-0.25, 0.25, 2) * depth_m, depth_m)
        turned = Pose.from_rotation_vector(tilt, np.zeros(3))
        poses.append(Pose(turned.rotation, centre_m - turned.apply(np.array([0.1, 0.0625, 0.0]))))
    return poses


def make_world(
    *, n_poses: int = 25, noise_s: float = 0.0, seed: int = 0, pairs: list[tuple[int, int]] | None = None
) -> World:
    """Pose the problem of TDOAs from arrival times with Gaussian noise of `noise_s`."""
    poses = board_poses(n_poses, seed)
    sources_m = np.concatenate([pose.apply(BUZZERS_M) for pose in poses])
    arrivals_s = np.linalg.norm(MICROPHONES_M - sources_m[:, None], axis=2) / SPEED_M_S
    arrivals_s += noise_s * np.random.default_rng(seed + 1).standard_normal(arrivals_s.shape)
    pair_rows = np.array(pairs or list(combinations(range(8), 2)), dtype=np.int32)
    problem = TdoaProblem(
        sources_m=sources_m,
        pose=np.repeat(np.arange(n_poses, dtype=np.int32), len(BUZZERS_M)),
        tdoa_s=arrivals_s[:, pair_rows[:, 1]] - arrivals_s[:, pair_rows[:, 0]],
        pairs=pair_rows,
        n_mics=8,
        known_m=np.zeros((0, 3)),
    )
    return World(problem, poses, Estimate(MICROPHONES_M, SPEED_M_S))


@pytest.fixture
def aislab_folder() -> Path:
    """Return the folder of the published measurements, or skip."""
    if not AISLAB.is_dir():
        pytest.skip("the published measurements are not here: put them into ../shared/data/aislab")
    return AISLAB


@pytest.fixture(scope="session")
def simulated_description() -> RigDescription:
    """Return the rig that ships as `simulated`."""
    return find_description("simulated").description
