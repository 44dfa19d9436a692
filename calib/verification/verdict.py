"""Pass or fail, against stated limits, and why."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.verification.comparison import Comparison
from calib.verification.location import Located
from calib.verification.movement import Motion, MovementCheck

MIN_LOCATED_SHARE = 0.8
FAR_BESIDE_DEG = 1.0  # no array that only aged is that far off


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
    alarms = movement.motions_beyond(limits.moved_m)
    failures = [*_motion_failures(movement, limits, alarms), *_sound_failures(located, comparison, limits)]
    return Verdict(limits, failures, alarms)


def _motion_failures(movement: MovementCheck, limits: Limits, alarms: list[Motion]) -> list[str]:
    """Say what moved, or that the calibration is not of this array at all."""
    if movement.is_foreign(limits.moved_m):
        why = (
            "this looks like another rig's calibration, or most microphones have moved by themselves (then calibrate "
            f"again). What contradicts it: {movement.contradiction}"
        )
        return [why]
    exchanged = {channel for pair in movement.swapped for channel in pair}
    found = [f"channels {first} and {second} look swapped: their microphones have exchanged places exactly; check the "
             "plugs" for first, second in movement.swapped]  # fmt: skip
    moved = [motion.sentence() for motion in alarms if motion.channel not in exchanged]
    return [*found, "array moved: " + "; ".join(moved)] if moved else found


def _sound_failures(located: Located, comparison: Comparison, limits: Limits) -> list[str]:
    """Say how many sounds could not be located, and how far beside their buzzers the others lie."""
    failures = []
    share = float(located.found.mean())
    if share < MIN_LOCATED_SHARE:
        failures.append(
            f"only {share:.0%} of the sounds could be located: is this the calibration of another rig, or are "
            "microphones swapped or dead?"
        )
    if located.found.any():
        median_deg = float(np.nanmedian(comparison.error_deg))
        is_far = median_deg > FAR_BESIDE_DEG
        if not median_deg <= limits.error_deg:
            failures.append(
                f"sounds lie {median_deg:.2f} degrees beside their buzzers in the median, the limit is "
                f"{limits.error_deg:g}{': is this the calibration of another rig?' if is_far else ''}"
            )
    return failures
