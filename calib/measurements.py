"""All that a solve by a method of the paper rests on, so that it can be solved again with a part of it changed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.answer import Answer
from calib.camera import View, corner_residuals_px, look
from calib.corners import PoseCorners
from calib.doubts import fit_doubts
from calib.emissions import EmissionTdoas
from calib.evidence import Evidence, arrivals_of_differences
from calib.fit import FittedTdoas
from calib.methods import make_problem, refit, solve
from calib.problem import Estimate, TdoaProblem
from calib.settings import Settings
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

    def answer(self) -> Answer:
        """Solve; the standard deviations come from solving again and again (jackknife).

        Raises
        ------
        MethodError, NotConvergedError
        """
        estimate = solve(self.problem, self.description, self.settings)
        covariance = self.covariance(estimate)
        residuals_s = self.problem.residuals(estimate)
        buzzer = self.tdoas.buzzer[np.isin(self.tdoas.pose, self.view.pose)]
        fitted = FittedTdoas(self.problem.pose, buzzer, residuals_s, self.problem.present, estimate.speed_of_sound_m_s)
        return Answer(
            microphones_m=estimate.microphones_m,
            array_covariance_m2=covariance[:-1, :-1],
            speed_of_sound_m_s=estimate.speed_of_sound_m_s,
            speed_of_sound_std_m_s=float(np.sqrt(covariance[-1, -1])),
            view=self.view,
            residual=fitted.residual(),
            warnings=fit_doubts(self.description, fitted),
            evidence=self.evidence(estimate, fitted),
        )

    def evidence(self, estimate: Estimate, fitted: FittedTdoas) -> Evidence:
        """Return the residuals of all measurements at an estimate."""
        problem, view = self.problem, self.view
        places_m = np.vstack([estimate.microphones_m, problem.known_m])
        residuals_s = arrivals_of_differences(fitted.residuals_s, problem.pairs, len(places_m))[:, : problem.n_mics]
        distances_m = np.linalg.norm(estimate.microphones_m - problem.sources_m[:, None], axis=2)
        corners_px = self.corners.corners_px[np.isin(self.corners.pose, view.pose)]
        corner_px = corner_residuals_px(corners_px, view.board_to_camera, self.description.board, view.intrinsics)
        used = np.isfinite(residuals_s)
        return Evidence(fitted.pose, fitted.buzzer, residuals_s, used, distances_m, corners_px, corner_px)

    def covariance(self, estimate: Estimate) -> FloatArray:
        """Return the covariance (3 n_mics + 1, 3 n_mics + 1) of an estimate: microphones, then the speed of sound."""

        def solved(part: Measurements) -> FloatArray:
            return refit(part.problem, estimate, part.description.medium.speed_m_s(), self.settings).vector()

        shifted = [solved(self.described(other)) for other in descriptions_off_by_one_std(self.description)]
        by_pose = jackknife_covariance(self.corners.pose, lambda poses: solved(self.without(poses)))
        return by_pose + shift_covariance(solved(self), shifted)
