"""The result of a calibration."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.camera import View
from calib.evaluation import Evaluation
from calib.evidence import Evidence
from calib.joint.next_pose import Suggestion
from calib.joint.observability import Weakest
from calib.joint.uncertainty import microphone_covariances
from calib.rejections import Rejection
from calib.settings import Settings
from rigs import __version__
from rigs.description import RigDescription

FloatArray = NDArray[np.float64]

SOFTWARE = f"acoustic-camera-rig {__version__}"


@dataclass(frozen=True)
class Residual:
    """How well TDOAs fit: robust standard deviation of all, root mean square of those used, and how many."""

    robust_sigma_s: float
    rms_s: float
    n_used: int
    n_rejected: int


@dataclass(frozen=True)
class HeldOut:
    """How well poses are predicted that took no part in the solve.

    Parameters
    ----------
    median_s : float
        Median absolute TDOA residual.
    robust_sigma_s : float
        1.4826 times that.
    spread_m : float
        Root mean square distance of a fold's microphones from their mean over the folds.
    """

    median_s: float
    robust_sigma_s: float
    spread_m: float


@dataclass(frozen=True)
class ChannelDelays:
    """How late each channel is after the first one.

    Parameters
    ----------
    delay_s, std_s : (n_sessions, n_mics) array
    """

    delay_s: FloatArray
    std_s: FloatArray


@dataclass(frozen=True)
class Recording:
    """What tools that read the session beside the result need to know of it.

    Parameters
    ----------
    sample_rate_hz : float
    channels : tuple of int
        Input channel of each column of `time_data`.
    picture_size_px : (int, int)
        Width and height.
    """

    sample_rate_hz: float
    channels: tuple[int, ...]
    picture_size_px: tuple[int, int]

    @classmethod
    def by(cls, description: RigDescription) -> Recording:
        """Return how a rig records."""
        audio = description.audio
        return cls(float(audio.sample_rate_hz), audio.recorded_channels(), description.camera.size_px)


@dataclass(frozen=True)
class SessionShare:
    """One of several sessions that a result rests on; each has a speed of sound of its own."""

    name: str
    sha256: str
    n_poses: int
    speed_of_sound_m_s: float
    speed_of_sound_std_m_s: float


@dataclass(frozen=True)
class Calibration:
    """Microphones in the camera frame.

    Parameters
    ----------
    session_name, session_sha256 : str
        What it was made from.
    method : str
    channels : tuple of int
        Input channel of each microphone.
    positions_m : (n_mics, 3) array
        Camera frame.
    array_covariance_m2 : (3 n_mics, 3 n_mics) array
        Of all microphones together.
    speed_of_sound_m_s, speed_of_sound_std_m_s : float
        Where the speed is held, the standard deviation is the rig description's.
    view : View
        Camera and board poses.
    recording : Recording
        How the session was recorded, of several the first.
    residual : Residual
    evaluation : Evaluation or None
    warnings : list of str
    sound : dict or None
        What was heard and what was wrong with it, in plain values; None where TDOAs were not measured in sound.
    held_out : HeldOut or None
        None for the paper's methods.
    suggestions : tuple of Suggestion
        Further board positions that would help most, the best first.
    evidence : Evidence or None
        Residuals of all measurements, for the report; the YAML file leaves them out.
    held : tuple of str
        Blocks of unknowns that the method was told to hold.
    weakest : Weakest or None
        How the array is known worst; None for the paper's methods.
    rejections : tuple of Rejection
        What the result does not rest on, and why.
    sessions : tuple of SessionShare
        Where it was made from several; the speed of sound is then their mean.
    delays : ChannelDelays or None
        Where they were to be found.
    settings : Settings
        What was chosen, so that it can be made again.
    """

    session_name: str
    session_sha256: str
    method: str
    channels: tuple[int, ...]
    positions_m: FloatArray
    array_covariance_m2: FloatArray
    speed_of_sound_m_s: float
    speed_of_sound_std_m_s: float
    view: View
    recording: Recording
    residual: Residual
    evaluation: Evaluation | None
    warnings: list[str]
    sound: dict[str, Any] | None = None
    held_out: HeldOut | None = None
    suggestions: tuple[Suggestion, ...] = ()
    held: tuple[str, ...] = ()
    weakest: Weakest | None = None
    rejections: tuple[Rejection, ...] = ()
    sessions: tuple[SessionShare, ...] = ()
    evidence: Evidence | None = None
    delays: ChannelDelays | None = None
    settings: Settings = field(default_factory=Settings)

    @property
    def covariance_m2(self) -> FloatArray:
        """Covariance (n_mics, 3, 3) of each microphone."""
        return microphone_covariances(self.array_covariance_m2, len(self.channels))

    @property
    def worst_std_m(self) -> FloatArray:
        """Standard deviation (n_mics,) of each microphone in its weakest direction."""
        return np.asarray(np.sqrt(np.linalg.eigvalsh(self.covariance_m2)[:, -1]))

    @property
    def std_m(self) -> FloatArray:
        """Standard deviations (n_mics, 3) of the positions."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance_m2, axis1=1, axis2=2)))
