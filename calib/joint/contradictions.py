"""Whether what is known beforehand contradicts the measurements so much that no answer would be right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.errors import NotEnoughDataError
from calib.joint.descend import descend
from calib.joint.robust import JointSolution
from calib.joint.suspects import Suspect

MOST_SUSPECTS = 4  # more at once are not all wrong: something else is
BETTER = 0.5  # of the misfit that the intrinsics as held leave
TRIAL_STEPS = 10


def check_suspects(suspects: list[Suspect], doubts: list[str]) -> None:
    """Refuse an answer for which half the rig description had to be wrong.

    Raises
    ------
    NotEnoughDataError
    """
    if len(suspects) > MOST_SUSPECTS:
        raise NotEnoughDataError(
            f"rig description and measurements contradict each other in {len(suspects)} places at once, so no answer "
            f"would be right ({doubts[0]}; and {len(suspects) - 1} more): check camera.intrinsics, "
            "board.square_size_m, board.buzzers and medium"
        )


def check_held_intrinsics(solution: JointSolution, usual_std: NDArray[np.float64]) -> None:
    """Refuse intrinsics that are held although pictures and sound fit others much better.

    Parameters
    ----------
    solution : JointSolution
    usual_std : (9,) array
        Standard deviations of the intrinsics where they are not held.

    Raises
    ------
    NotEnoughDataError
    """
    problem, camera = solution.problem, solution.at.blocks.camera
    if problem.corners is None or problem.priors.free[camera].any():
        return
    freed = replace(problem, priors=problem.priors.with_std(camera, usual_std))
    trial = descend(freed, solution.at, solution.weights(), TRIAL_STEPS)
    if trial.cost < BETTER * solution.cost:
        held_px, found_px = problem.priors.mean[camera][0], trial.end.camera[0]
        raise NotEnoughDataError(
            f"intrinsics with a focal length of {held_px:.0f} px are held, but pictures and sound contradict them and "
            f"fit {found_px:.0f} px: do not hold them, or calibrate the camera again"
        )
