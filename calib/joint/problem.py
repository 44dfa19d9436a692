"""The joint problem: what was measured, and what is known beforehand."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce
from operator import add

import numpy as np
from numpy.typing import NDArray

from calib.joint.arrivals import ArrivalTable
from calib.joint.corners import CornerTable
from calib.joint.equations import NormalEquations
from calib.joint.held import CornerFit
from calib.joint.onsets import OnsetTable
from calib.joint.unknowns import Unknowns

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class Priors:
    """What is known of the shared unknowns beforehand.

    Parameters
    ----------
    mean : (n_shared,) array
    std : (n_shared,) array
        0 holds a value that is known exactly, infinity leaves it free.
    poses_held : bool
        The poses have no unknowns.
    held : (n_shared,) bool array, or False
        Held at `mean`, which is off by `std` all the same.
    """

    mean: FloatArray
    std: FloatArray
    poses_held: bool = False
    held: BoolArray | bool = False

    @property
    def free(self) -> BoolArray:
        """Which unknowns (n_shared,) are to be found."""
        return (self.std > 0) & np.logical_not(self.held)

    @property
    def information(self) -> FloatArray:
        """Weights 1 / std^2 (n_shared,); 0 where nothing is known, and where the value is held."""
        known = self.free & np.isfinite(self.std)
        return np.where(known, 1 / np.where(known, self.std, 1.0) ** 2, 0.0)

    def with_std(self, where: slice | BoolArray, std: float | FloatArray) -> Priors:
        """Return the priors with another standard deviation of some unknowns, which are held no longer."""
        changed, held = self.std.copy(), np.broadcast_to(self.held, self.std.shape).copy()
        changed[where], held[where] = std, False
        return replace(self, std=changed, held=held)


@dataclass(frozen=True)
class Weights:
    """How much measurements count: arrivals (n_emissions, n_mics) in 1/s^2, corners (n_poses, n_corners) in 1/px^2.

    Onsets (n_emissions,) in 1/s^2; None: as far as they fit.
    """

    arrivals: FloatArray
    corners: FloatArray
    onsets: FloatArray | None = None


@dataclass(frozen=True)
class JointProblem:
    """Arrivals, corners, and priors.

    Parameters
    ----------
    arrivals : ArrivalTable
    corners : CornerTable or None
        None where the poses are held.
    priors : Priors
    onsets : OnsetTable or None
        None where nothing tells when emissions began.
    fit : CornerFit or None
        What intrinsics or poses are held at, where corners alone said it.
    """

    arrivals: ArrivalTable
    corners: CornerTable | None
    priors: Priors
    onsets: OnsetTable | None = None
    fit: CornerFit | None = None

    def stated_weights(self) -> Weights:
        """Return the weights that the stated standard deviations give."""
        return Weights(
            self.arrivals.information, np.zeros((0, 0)) if self.corners is None else self.corners.information
        )

    def only(self, poses: BoolArray) -> JointProblem:
        """Return the problem of some of the poses (n_poses,)."""
        emissions = poses[self.arrivals.pose]
        numbers = np.cumsum(poses) - 1
        arrivals = self.arrivals.only(emissions)
        return replace(
            self,
            arrivals=replace(arrivals, pose=numbers[arrivals.pose]),
            corners=None if self.corners is None else self.corners.only(poses),
            onsets=None if self.onsets is None else self.onsets.only(emissions),
            fit=None if self.fit is None else self.fit.only(poses),
        )

    def with_onset_weights(self, weights: Weights, at: Unknowns) -> Weights:
        """Return the weights with those of the onsets as far as they fit, so that they stay while a step is sought."""
        if self.onsets is None or weights.onsets is not None:
            return weights
        return replace(weights, onsets=self.onsets.weights(self.arrivals, at, weights.arrivals))

    def normal_equations(self, at: Unknowns, weights: Weights) -> NormalEquations:
        """Linearise at some values; the equations of all unknowns, held ones too."""
        return self.with_all_else(reduce(add, self.measured_equations(at, weights)), at, weights)

    def measured_equations(self, at: Unknowns, weights: Weights) -> list[NormalEquations]:
        """Return the equations of the arrivals, and those of the corners where there are any."""
        arrivals = self.arrivals.normal_equations(at, weights.arrivals)
        return [arrivals, *([self.corners.normal_equations(at, weights.corners)] if self.corners is not None else [])]

    def with_all_else(self, equations: NormalEquations, at: Unknowns, weights: Weights) -> NormalEquations:
        """Return the equations of arrivals and corners with those of onsets and priors."""
        if self.onsets is not None:
            own = self.with_onset_weights(weights, at).onsets
            assert own is not None
            equations = equations + self.onsets.normal_equations(self.arrivals, at, weights.arrivals, own)
        information, deviation = self.priors.information, self.priors.mean - at.shared
        return replace(
            equations,
            shared=equations.shared + np.diag(information),
            shared_gradient=equations.shared_gradient + information * deviation,
            cost=equations.cost + 0.5 * float(np.sum(information * deviation**2)),
        )

    def free_equations(self, at: Unknowns, weights: Weights) -> NormalEquations:
        """Linearise at some values; the equations of what is to be found."""
        return self.normal_equations(at, weights).only(self.priors.free, poses_free=not self.priors.poses_held)
