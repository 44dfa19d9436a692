"""What held values are wrong by: a value that is not solved for has its error all the same, and passes it on.

Every error comes from independent sources: a value of the rig description that is off by its standard deviation, and
the noise of the corners from which intrinsics and poses were fitted beforehand. Each source is a step of the held
values; what it does to the others, times itself and summed up, is its share in the covariance (B. D. Tapley,
B. E. Schutz and G. H. Born, Statistical Orbit Determination, 2004, chapter 6: consider covariance). Corners that are
used twice, for the fit and for the solve, need no further term: what they say of a pose whose camera is known is
independent of what they say of the camera.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.joint.corners import CornerTable
from calib.joint.equations import NormalEquations
from calib.joint.unknowns import POSE_SIZE, Unknowns

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class HeldErrors:
    """Steps that held values may be off by, each of unit variance and independent of the others.

    Parameters
    ----------
    shared : (n_sources, n_shared) array
    poses : (n_sources, n_poses, 6) array
    alone : (n_poses, 6, 6) array
        Six more sources for each pose, which touch it alone; a row is a step.
    """

    shared: FloatArray
    poses: FloatArray
    alone: FloatArray


@dataclass(frozen=True)
class CornerFit:
    """A fit of the poses, and of the camera if nothing else was known of it, to corners alone.

    Parameters
    ----------
    corners : CornerTable
        With the standard deviation that the fit shows.
    at : Unknowns
        What was found, on a perfect board.
    camera_found : bool
    """

    corners: CornerTable
    at: Unknowns
    camera_found: bool

    @classmethod
    def of(cls, corners: CornerTable, at: Unknowns, *, camera_found: bool) -> CornerFit:
        """Take the corners' standard deviation from how well they fit."""
        residuals_px = corners.residuals_px(at)
        n_free = np.isfinite(residuals_px).sum() - POSE_SIZE * len(at.rotations) - 8 * camera_found
        std_px = float(np.sqrt(np.nansum(residuals_px**2) / max(n_free, 1)))
        return cls(replace(corners, std_px=max(std_px, 1e-6 * corners.std_px)), at, camera_found)

    def only(self, poses: BoolArray) -> CornerFit:
        """Return the fit of some of the poses (n_poses,)."""
        return replace(self, corners=self.corners.only(poses), at=self.at.only(poses))

    def errors(self, std: FloatArray) -> HeldErrors:
        """Return what all values are off by, those of the rig description by `std` (n_shared,)."""
        at, camera = self.at, self.at.blocks.camera
        equations = self.corners.normal_equations(at, self.corners.information)
        found = np.zeros(at.blocks.size, dtype=bool)
        found[camera] = self.camera_found & (std[camera] > 0)
        shared = described_errors(np.where(found, 0.0, std))
        if found.any():
            shared = _with_camera(shared, equations, found, std)
        followed = np.linalg.solve(equations.poses, equations.border.swapaxes(1, 2))
        poses = -np.einsum("pks,ns->npk", followed, shared, optimize=True)
        return HeldErrors(shared, poses, np.linalg.inv(np.linalg.cholesky(equations.poses)))


def described_errors(std: FloatArray) -> FloatArray:
    """Return the steps (n_sources, n_shared) of values that are off by `std`, one by one."""
    known = np.flatnonzero((std > 0) & np.isfinite(std))
    steps = np.zeros((len(known), len(std)))
    steps[np.arange(len(known)), known] = std[known]
    return steps


def _with_camera(shared: FloatArray, equations: NormalEquations, found: BoolArray, std: FloatArray) -> FloatArray:
    """Let the camera that was found follow errors of the board, and scatter with the corners."""
    information = equations.complement()
    by_camera = information[np.ix_(found, found)] + np.diag(1 / std[found] ** 2)
    shared = shared.copy()
    shared[:, found] = -np.linalg.solve(by_camera, information[found] @ shared.T).T
    scatter = np.zeros((int(found.sum()), len(std)))
    scale = np.sqrt(np.diag(by_camera))
    scatter[:, found] = np.linalg.inv(np.linalg.cholesky(by_camera / np.outer(scale, scale))) / scale
    return np.vstack([shared, scatter])
