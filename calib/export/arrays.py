"""Exports as arrays: NumPy's for pyroomacoustics, and MATLAB's."""

from __future__ import annotations

import io

import numpy as np
from scipy.io import savemat

from calib.export.heading import heading
from calib.result_file import StoredCalibration
from rigs.geometry import CAMERA_FRAME


def positions_npy(array: StoredCalibration) -> bytes:
    """Return the positions (3, n_mics)."""
    stream = io.BytesIO()
    np.save(stream, np.ascontiguousarray(array.positions_m.T))
    return stream.getvalue()


def pyroomacoustics_loader(array: StoredCalibration) -> bytes:
    """Return a few lines of Python that load the positions into a microphone array."""
    comments = "".join(f"# {line}\n" for line in heading(array))
    return f"""{comments}
from pathlib import Path

import numpy as np
import pyroomacoustics as pra

positions_m = np.load(Path(__file__).with_suffix(".npy"))  # (3, {len(array.channels)})
speed_of_sound_m_s = {array.speed_of_sound_m_s!r}
array = pra.MicrophoneArray(positions_m, fs={round(array.recording.sample_rate_hz)})
""".encode()


def matlab_mat(array: StoredCalibration) -> bytes:
    """Return a MATLAB file (version 5) of one struct, `array`."""
    stream = io.BytesIO()
    values = {
        "heading": "\n".join(heading(array)),
        "made_by": array.software,
        "frame": CAMERA_FRAME,
        "channels": np.array(array.channels, dtype=float),
        "columns_from_1": np.array(array.columns, dtype=float) + 1,  # as MATLAB counts
        "positions_m": array.positions_m,
        "std_m": array.std_m,
        "covariance_m2": np.moveaxis(array.covariance_m2, 0, 2),
        "speed_of_sound_m_s": array.speed_of_sound_m_s,
        "speed_of_sound_std_m_s": array.speed_of_sound_std_m_s,
        "sample_rate_hz": array.recording.sample_rate_hz,
        "focal_px": np.array(array.intrinsics.focal_px),
        "principal_px": np.array(array.intrinsics.principal_px),
        "distortion": np.array(array.intrinsics.distortion),
        "picture_size_px": np.array(array.recording.picture_size_px, dtype=float),
    }
    savemat(stream, {"array": values}, long_field_names=True, oned_as="row")
    return stream.getvalue()
