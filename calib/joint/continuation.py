"""Where a solve ended, so that one of the same session with more poses starts there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.joint.problem import JointProblem
from calib.joint.unknowns import Unknowns


@dataclass(frozen=True)
class Continuation:
    """Where an earlier solve of fewer poses of the same session ended.

    Parameters
    ----------
    at : Unknowns
    pose : (n_poses,) integer array
        The session's numbers of its poses.
    scale : float
        Factor on the arrivals' stated standard deviations.
    """

    at: Unknowns
    pose: NDArray[np.int32]
    scale: float

    def fits(self, guess: Unknowns) -> bool:
        """Tell whether a problem has the same unknowns: the sync output may only now be seen, or be seen no more."""
        return self.at.blocks == guess.blocks

    def start(self, problem: JointProblem, guess: Unknowns, pose: NDArray[np.int32]) -> Unknowns:
        """Return where the next solve starts: new poses (n_poses,) are as `guess` has them."""
        shared = np.where(problem.priors.free, self.at.shared, guess.shared)
        rotations, translations_m = guess.rotations.copy(), guess.translations_m.copy()
        if not problem.priors.poses_held:
            _, new, old = np.intersect1d(pose, self.pose, return_indices=True)
            rotations[new], translations_m[new] = self.at.rotations[old], self.at.translations_m[old]
        return replace(guess, shared=shared, rotations=rotations, translations_m=translations_m)
