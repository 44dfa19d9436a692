"""What every method answers with."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from calib.camera import View
from calib.evidence import Evidence
from calib.joint.continuation import Continuation
from calib.joint.next_pose import Suggestion
from calib.joint.observability import Weakest
from calib.joint.uncertainty import microphone_covariances
from calib.rejections import Rejection
from calib.result import ChannelDelays, HeldOut, Residual

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Answer:
    """Microphones, how sure they are, and what else came out.

    Parameters
    ----------
    microphones_m : (n_mics, 3) array
        Camera frame.
    array_covariance_m2 : (3 n_mics, 3 n_mics) array
        Of all microphones together.
    speed_of_sound_m_s, speed_of_sound_std_m_s : float
        Of several sessions the mean.
    view : View
        Camera and board poses.
    residual : Residual
    warnings : list of str
    held_out : HeldOut or None
    suggestions : list of Suggestion
        Further board positions that would help most, the best first.
    rejections : list of Rejection
        What the solve left out.
    evidence : Evidence or None
        Residuals of all measurements.
    weakest : Weakest or None
        How the array is known worst.
    continuation : Continuation or None
        Where a solve of more poses may start.
    speeds_m_s, speed_stds_m_s : tuple of float
        Speed of sound of each session, where there are several.
    delays : ChannelDelays or None
        Where they were to be found.
    """

    microphones_m: FloatArray
    array_covariance_m2: FloatArray
    speed_of_sound_m_s: float
    speed_of_sound_std_m_s: float
    view: View
    residual: Residual
    warnings: list[str] = field(default_factory=list)
    held_out: HeldOut | None = None
    suggestions: list[Suggestion] = field(default_factory=list)
    rejections: list[Rejection] = field(default_factory=list)
    weakest: Weakest | None = None
    continuation: Continuation | None = None
    speeds_m_s: tuple[float, ...] = ()
    speed_stds_m_s: tuple[float, ...] = ()
    evidence: Evidence | None = None
    delays: ChannelDelays | None = None

    @property
    def covariance_m2(self) -> FloatArray:
        """Covariance (n_mics, 3, 3) of each microphone."""
        return microphone_covariances(self.array_covariance_m2, len(self.microphones_m))
