"""Whether a calibration can be of the rig that recorded a session."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calib.errors import ResultFileError
from calib.result_file import StoredCalibration
from rigs.description import RigDescription

MIN_CHANNELS = 5  # four find a place, the fifth tells whether it is right


def check_fit(calibration: StoredCalibration, description: RigDescription, path: Path) -> None:
    """Refuse a calibration that cannot be of the rig that recorded a session.

    Raises
    ------
    ResultFileError
    """
    n_known, present = len(calibration.channels), description.audio.channels
    if n_known < MIN_CHANNELS:
        raise ResultFileError(
            f"{path}: it has {n_known} microphones, at least {MIN_CHANNELS} are needed to locate and to check a sound"
        )
    strange = [channel for channel in calibration.channels if channel not in present]
    if strange:
        raise ResultFileError(
            f"{path}: it has a microphone on channel {strange[0]}, the session's rig ({description.name}) has "
            f"{', '.join(map(str, present))}: is it another rig's calibration?"
        )
    middle_px = np.array(calibration.intrinsics.principal_px) / np.array(description.camera.size_px)
    if not ((middle_px > 0.25) & (middle_px < 0.75)).all():
        width, height = description.camera.size_px
        raise ResultFileError(
            f"{path}: its camera's middle lies at {calibration.intrinsics.principal_px[0]:.0f}, "
            f"{calibration.intrinsics.principal_px[1]:.0f} px, the session's pictures are {width} x {height}: is it "
            "another camera's calibration, or one at another picture size?"
        )
