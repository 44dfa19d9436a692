"""Synthetic truth for the tests: an array, board poses, and TDOAs with noise of a known size."""

from __future__ import annotations

import signal
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
import yaml

from calib.problem import Estimate, TdoaProblem
from rigs.board import board_corners_m, project
from rigs.description import Intrinsics, RigDescription
from rigs.geometry import Pose
from rigs.library import find_description
from rigs.session.layout import MeasuredTdoas, Truth
from rigs.session.writer import SessionWriter

LONGEST_FIRST = ("test_virtual_bench_session", "test_end_to_end", "test_acquire_board_simboard")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # in a shell's background: no program would hear Ctrl-C
    signal.signal(signal.SIGINT, signal.default_int_handler)

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
BUZZERS_M = np.array([buzzer.position_m for buzzer in find_description("simulated").description.board.buzzers])
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
    *,
    n_poses: int = 25,
    noise_s: float = 0.0,
    seed: int = 0,
    pairs: list[tuple[int, int]] | None = None,
    buzzer_errors_m: float = 0.0,
    speed_m_s: float = SPEED_M_S,
) -> World:
    """Pose the problem of TDOAs from arrival times with Gaussian noise, and buzzers a little out of place."""
    poses = board_poses(n_poses, seed)
    sources_m = np.concatenate([pose.apply(BUZZERS_M) for pose in poses])
    sounding_m = BUZZERS_M + buzzer_errors_m * np.random.default_rng(seed + 2).standard_normal(BUZZERS_M.shape)
    sounding_m = np.concatenate([pose.apply(sounding_m) for pose in poses])
    arrivals_s = np.linalg.norm(MICROPHONES_M - sounding_m[:, None], axis=2) / speed_m_s
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
    return World(problem, poses, Estimate(MICROPHONES_M, speed_m_s))


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


def write_measured_session(
    path: Path,
    description: RigDescription,
    *,
    n_poses: int = 12,
    tdoa_s: np.ndarray | None = None,
    pairs: list[tuple[int, int]] | None = None,
    corners_px: np.ndarray | None = None,
    accepted: int | None = None,
    seed: int = 0,
    noise_s: float = 1e-6,
    first_pose: int = 0,
    wrong_scales: bool = False,
) -> Path:
    """Write a session that starts at measured corners and TDOAs (0.05 px); the first `accepted` poses count."""
    errors_m = description.board.buzzer_std_m
    wrong_c, wrong_square = np.random.default_rng(seed + 4).standard_normal(2) if wrong_scales else (0.0, 0.0)
    speed_m_s = description.medium.speed_m_s() + wrong_c * description.medium.speed_std_m_s()
    printed = description.board.square_size_m + wrong_square * description.board.square_size_std_m
    world = make_world(
        n_poses=n_poses, noise_s=noise_s, pairs=pairs, seed=seed, buzzer_errors_m=errors_m, speed_m_s=speed_m_s
    )
    intrinsics = Intrinsics(focal_px=(940.0, 940.0), principal_px=(640.0, 360.0))
    described = description.model_copy(
        update={"camera": description.camera.model_copy(update={"intrinsics": intrinsics})}
    )
    if corners_px is None:
        points_m = board_corners_m(description.board) * printed / description.board.square_size_m
        corners_px = np.array([project(points_m, pose, intrinsics) for pose in world.poses])
        corners_px += np.random.default_rng(seed + 3).normal(scale=0.05, size=corners_px.shape)
    channels = np.array(description.audio.channels, dtype=np.int32)
    tdoas = MeasuredTdoas(world.problem.tdoa_s if tdoa_s is None else tdoa_s, channels[world.problem.pairs])
    with SessionWriter.create(
        path,
        name=path.stem,
        description_text=yaml.safe_dump(described.model_dump(mode="json", exclude_none=True)),
        n_channels=len(channels),
        sample_rate_hz=48000.0,
        versions={"software": "tests"},
        truth=Truth(MICROPHONES_M, "simulation", speed_of_sound_m_s=speed_m_s),
        corners_px=corners_px,
        tdoas=tdoas,
    ) as writer:
        for pose in range(n_poses):
            counts = accepted is None or pose < accepted
            writer.append_pose(
                pose=first_pose + pose, start_host_time_s=np.nan, end_host_time_s=np.nan, accepted=counts
            )
            for buzzer in description.board.buzzers:
                writer.append_emission(
                    pose=first_pose + pose,
                    buzzer=buzzer.id,
                    repeat=0,
                    waveform="sweep",
                    board_time_s=np.nan,
                    host_time_s=np.nan,
                    expected_sample=-1,
                    accepted=True,
                )
    return path


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with what takes minutes, so that no core is left with it at the end."""
    items.sort(key=lambda item: [item.path.stem != each for each in LONGEST_FIRST])
