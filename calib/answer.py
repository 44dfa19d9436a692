"""What every method answers with."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from calib.camera import View
from calib.result import HeldOut, Residual

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Answer:
    """Microphones, how sure they are, and what else came out.

    Parameters
    ----------
    microphones_m : (n_mics, 3) array
        Camera frame.
    covariance_m2 : (n_mics, 3, 3) array
    speed_of_sound_m_s, speed_of_sound_std_m_s : float
    view : View
        Camera and board poses.
    residual : Residual
    warnings : list of str
    held_out : HeldOut or None
    suggestions : list of str
        Further board positions that would help most, the best first.
    array_covariance_m2 : (3 n_mics, 3 n_mics) array or None
        Of all microphones together.
    """

    microphones_m: FloatArray
    covariance_m2: FloatArray
    speed_of_sound_m_s: float
    speed_of_sound_std_m_s: float
    view: View
    residual: Residual
    warnings: list[str] = field(default_factory=list)
    held_out: HeldOut | None = None
    suggestions: list[str] = field(default_factory=list)
    array_covariance_m2: FloatArray | None = None
