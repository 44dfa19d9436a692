"""A rig calibrated, and met again later: other board positions, other air, perhaps a microphone elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from conftest import BUZZERS_M, board_poses
from measured_rig import CHANNELS, Rig, make_rig

from calib.joint.arrivals import ArrivalTable
from calib.joint.corners import CornerTable
from calib.joint.session import refined_view
from calib.joint.uncertainty import shared_covariance
from calib.joint.unknowns import Unknowns
from calib.result import SOFTWARE, Recording
from calib.result_file import StoredCalibration
from calib.settings import Settings
from calib.verification.comparison import Comparison
from calib.verification.location import Located, Speed
from calib.verification.movement import MovementCheck, check_movement
from calib.verification.pipeline import calibrated_view, locate_emissions
from rigs.board import board_corners_m

MOVED_M = 0.003


@dataclass(frozen=True)
class Checked:
    """A verification at the level of corners and arrivals."""

    located: Located
    comparison: Comparison
    movement: MovementCheck

    @property
    def moved(self) -> list[int]:
        """Channels that the movement check names, -1 for the whole array, at the limit of 1 mm."""
        return sorted(motion.channel for motion in self.movement.motions if motion.farthest_m > 0.001)


def calibrated(rig: Rig) -> StoredCalibration:
    """Calibrate a rig jointly."""
    solution = rig.solved()
    covariance = shared_covariance(solution.problem, solution.at, solution.weights())
    speed = solution.at.blocks.speed
    return StoredCalibration(
        "first.calib.yaml",
        {"0" * 64: "first"},
        Settings(),
        SOFTWARE,
        CHANNELS,
        solution.at.microphones_m,
        covariance[:24, :24],
        solution.at.speed_m_s,
        float(np.sqrt(covariance[speed, speed][0, 0])),
        refined_view(rig.view(), solution).intrinsics,
        Recording.by(rig.description),
    )


def met_again(rig: Rig, seed: int, *, n_poses: int = 8, shifts_m: np.ndarray | float = 0.0) -> Rig:
    """Meet the same rig again, its microphones shifted by (8, 3)."""
    generator, medium = np.random.default_rng([seed, 7]), rig.description.medium
    poses = board_poses(n_poses, seed + 5000)
    shared = rig.truth.shared.copy()
    shared[rig.truth.blocks.speed] = medium.speed_m_s() + medium.speed_std_m_s() * generator.standard_normal()
    rotations, translations_m = (np.array([getattr(one, name) for one in poses]) for name in
                                 ("rotation", "translation_m"))  # fmt: skip
    truth = Unknowns(rig.truth.blocks, shared, rotations, translations_m)
    truth = truth.placed(truth.microphones_m + shifts_m)
    corners = CornerTable(board_corners_m(rig.description.board), np.zeros((n_poses, rig.corners_px.shape[1], 2)), 1.0)
    corners_px = -corners.residuals_px(truth)
    corners_px += rig.corner_std_px * generator.standard_normal(corners_px.shape)
    pose, buzzer = np.repeat(np.arange(n_poses), len(BUZZERS_M)), np.tile(np.arange(len(BUZZERS_M)), n_poses)
    std_s = generator.choice(rig.std_s.ravel(), (len(pose), len(CHANNELS)))
    times_s = ArrivalTable(pose, buzzer, np.zeros_like(std_s), std_s).flights(truth).times_s
    arrival_s = times_s + std_s * generator.standard_normal(std_s.shape) + np.arange(len(pose))[:, None]
    return Rig(rig.description, truth, corners_px, arrival_s, std_s, rig.corner_std_px)


def one_moved(seed: int) -> tuple[int, np.ndarray]:
    """Draw a microphone and shifts (8, 3) that move it by 3 mm in some direction."""
    generator = np.random.default_rng([seed, 9])
    direction, row = generator.standard_normal(3), int(generator.integers(len(CHANNELS)))
    shift_m = MOVED_M * direction / np.linalg.norm(direction)
    return CHANNELS[row], shift_m * (np.arange(len(CHANNELS)) == row)[:, None]


def checked(calibration: StoredCalibration, rig: Rig) -> Checked:
    """Verify a calibration on a rig met again."""
    view = calibrated_view(calibration, rig.description, rig.corners)
    medium = rig.description.medium
    located, comparison = locate_emissions(
        calibration, rig.description, view, rig.corners, rig.tdoas, Speed(medium.speed_m_s(), medium.speed_std_m_s())
    )
    movement = check_movement(calibration, rig.description, view, rig.corners, rig.tdoas)
    return Checked(located, comparison, movement)


def calibrated_rig(seed: int) -> tuple[Rig, StoredCalibration]:
    """Return a rig and its calibration."""
    rig = make_rig(seed)
    return rig, calibrated(rig)
