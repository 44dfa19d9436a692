"""All that a solve rests on, so that it can be solved again with a part of it changed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.camera import View, look
from calib.corners import PoseCorners
from calib.emissions import EmissionTdoas
from calib.methods import Settings, make_problem, refit, speed_prior
from calib.problem import TdoaProblem
from calib.solve import Solution
from calib.uncertainty import descriptions_off_by_one_std, jackknife_covariance, shift_covariance
from rigs.description import RigDescription

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Measurements:
    """Corners and TDOAs of a session, the rig they were taken with, and how to solve.

    Parameters
    ----------
    description : RigDescription
    corners : PoseCorners
    tdoas : EmissionTdoas
    settings : Settings
    """

    description: RigDescription
    corners: PoseCorners
    tdoas: EmissionTdoas
    settings: Settings

    @cached_property
    def view(self) -> View:
        """The camera and the board's poses."""
        return look(self.description.camera, self.description.board, self.corners)

    @cached_property
    def problem(self) -> TdoaProblem:
        """The TDOAs and the places in the camera frame where they came from."""
        return make_problem(self.description, self.view, self.tdoas, self.settings)

    def without(self, poses: NDArray[np.int32]) -> Measurements:
        """Return the measurements without some poses (n,)."""
        return replace(self, corners=self.corners.only(~np.isin(self.corners.pose, poses)))

    def described(self, description: RigDescription) -> Measurements:
        """Return the same measurements, taken to be of another rig."""
        return replace(self, description=description)

    def covariance(self, solution: Solution) -> FloatArray:
        """Return the covariance (3 n_mics + 1, 3 n_mics + 1) of a solution: microphones, then the speed of sound."""

        def solved(part: Measurements) -> FloatArray:
            used = solution.used[np.isin(self.problem.pose, part.view.pose)]
            return refit(part.problem, solution, used, self.settings, speed_prior(part.description)).vector()

        shifted = [solved(self.described(other)) for other in descriptions_off_by_one_std(self.description)]
        by_pose = jackknife_covariance(self.corners.pose, lambda poses: solved(self.without(poses)))
        return by_pose + shift_covariance(solved(self), shifted)
