"""The paper's published poses and TDOAs, as studies use them; stand-ins for the poses where they are not there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.study.description import DrawnPoses
from rigs.geometry import Pose
from rigs.session.aislab_files import N_POSES, read_poses, read_tdoas

FloatArray = NDArray[np.float64]
STAND_IN = DrawnPoses(kind="drawn", n_poses=N_POSES, nearest_m=0.45, furthest_m=1.0, tilt_deg=30, width=0.25, seed=1)


@dataclass(frozen=True)
class Published:
    """What the authors published.

    Parameters
    ----------
    poses : list of Pose
        The 69 board poses; drawn ones where `stand_in`.
    tdoa_s : mapping of int to (414, number) array
        TDOAs by how many each emission has: 7, 28, or 8 (against the ninth microphone). Empty where `stand_in`.
    stand_in : bool
    """

    poses: list[Pose]
    tdoa_s: Mapping[int, FloatArray] = field(default_factory=dict)
    stand_in: bool = False


def read_published(folder: Path | None) -> Published:
    """Read the published files, or make stand-ins for the poses where no folder is given.

    Raises
    ------
    rigs.errors.ImportFormatError
        A file is missing or not of the known form.
    """
    if folder is None:
        return Published(drawn_poses(STAND_IN), stand_in=True)
    return Published(
        read_poses(folder), {7: read_tdoas(folder, 7), 28: read_tdoas(folder, 28), 8: read_tdoas(folder, 8)}
    )


def drawn_poses(wanted: DrawnPoses) -> list[Pose]:
    """Draw board poses before the camera; the board's origin is moved so that its middle is in view."""
    generator = np.random.default_rng(wanted.seed)
    poses = []
    for _ in range(wanted.n_poses):
        tilt_rad = np.radians(wanted.tilt_deg) * generator.uniform(-1, 1, 3) * (1.0, 1.0, 0.5)
        depth_m = generator.uniform(wanted.nearest_m, wanted.furthest_m)
        middle_m = np.append(depth_m * generator.uniform(-wanted.width, wanted.width, 2), depth_m)
        turned = Pose.from_rotation_vector(tilt_rad, np.zeros(3))
        poses.append(Pose(turned.rotation, middle_m - turned.apply(np.array([0.08, 0.07, 0.0]))))
    return poses
