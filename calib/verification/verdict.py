"""Pass or fail, against stated limits, and why."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.verification.comparison import Comparison
from calib.verification.location import Located
from calib.verification.movement import Motion, MovementCheck

MIN_LOCATED_SHARE = 0.8


@dataclass(frozen=True)
class Limits:
    """What passes.

    Parameters
    ----------
    error_deg : float
        Largest median angle at the camera between sounds located and buzzers seen.
    moved_m : float
        Largest motion of a microphone that is no alarm; shorter ones do no harm.
    """

    error_deg: float = 0.25
    moved_m: float = 0.001


@dataclass(frozen=True)
class Verdict:
    """Why it failed, in words; passed where there is no reason to fail.

    Parameters
    ----------
    limits : Limits
    failures : list of str
    alarms : list of Motion
        What moved farther than the limit.
    """

    limits: Limits
    failures: list[str]
    alarms: list[Motion]

    @property
    def passed(self) -> bool:
        """Whether the calibration is good."""
        return not self.failures


def judge(located: Located, comparison: Comparison, movement: MovementCheck, limits: Limits) -> Verdict:
    """Hold errors and motions against the limits."""
    failures = []
    alarms = [motion for motion in movement.motions if motion.farthest_m > limits.moved_m]
    if alarms:
        failures.append("array moved: " + "; ".join(motion.sentence() for motion in alarms))
    share = float(located.found.mean())
    if share < MIN_LOCATED_SHARE:
        failures.append(
            f"only {share:.0%} of the sounds could be located: is this the calibration of another rig, or are "
            "microphones swapped or dead?"
        )
    if located.found.any():
        median_deg = float(np.nanmedian(comparison.error_deg))
        if not median_deg <= limits.error_deg:
            failures.append(
                f"sounds lie {median_deg:.2f} degrees beside their buzzers in the median, the limit is "
                f"{limits.error_deg:g}"
            )
    return Verdict(limits, failures, alarms)
