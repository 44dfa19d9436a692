"""The files of the published measurements (AISLAB, SUSTech), read and checked; lengths become metres."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from rigs.description import Intrinsics
from rigs.errors import ImportFormatError
from rigs.geometry import Pose

FloatArray = NDArray[np.float64]
Problem = Literal[28, 7, 8]

N_POSES = 69
N_BUZZERS = 6
_N_CORNERS = 72
_CAMERA_FILE = "new_cameraParams_69.mat"
_POSES_FILE = "location.mat"
_TDOA_FILES: dict[Problem, str] = {
    28: "my_measurement_2_69_new.mat",
    7: "my_measurement_3_69_new.mat",
    8: "my_measurement_1_69_new.mat",
}


@dataclass(frozen=True)
class PublishedCamera:
    """What MATLAB's calibration of the camera left behind.

    Parameters
    ----------
    intrinsics : Intrinsics
        As OpenCV has them: pixel centres counted from 0, where MATLAB counts from 1.
    poses : list of Pose
        `board_to_camera` of each picture.
    corners_m : (72, 3) array
        Places of the corners in the board frame, in MATLAB's order (column after column).
    reprojection_errors_px : (69, 72, 2) array
        Reprojected minus detected, as MATLAB's `cameraParameters` defines it.
    """

    intrinsics: Intrinsics
    poses: list[Pose]
    corners_m: FloatArray
    reprojection_errors_px: FloatArray


def read_camera(folder: Path) -> PublishedCamera:
    """Read the camera's calibration from `folder`.

    Raises
    ------
    ImportFormatError
        The file is missing or not of the known form, or the reader of MATLAB objects is not installed.
    """
    path = _find(folder, _CAMERA_FILE)
    content = _load(path, _matlab_objects())
    try:
        fields = content["cameraParams"].properties["any"][0, 0]
    except (AttributeError, KeyError, IndexError, TypeError) as error:
        raise _foreign(path, "no cameraParameters object named cameraParams in it") from error

    def numbers(name: str, *shape: int) -> FloatArray:
        return _numbers(path, name, fields[name] if name in (fields.dtype.names or ()) else None, shape)

    matrix, distortion = (
        numbers("K", 3, 3),
        [*numbers("RadialDistortion", 1, 2)[0], *numbers("TangentialDistortion", 1, 2)[0]],
    )
    turns, shifts_mm = numbers("RotationVectors", N_POSES, 3), numbers("TranslationVectors", N_POSES, 3)
    return PublishedCamera(
        intrinsics=Intrinsics(
            focal_px=(matrix[0, 0], matrix[1, 1]),
            principal_px=(matrix[0, 2] - 1, matrix[1, 2] - 1),
            distortion=(*distortion, 0.0),
        ),
        poses=[Pose.from_rotation_vector(turn, shift / 1000) for turn, shift in zip(turns, shifts_mm, strict=True)],
        corners_m=np.pad(numbers("WorldPoints", _N_CORNERS, 2), ((0, 0), (0, 1))) / 1000,
        reprojection_errors_px=numbers("ReprojectionErrors", _N_CORNERS, 2, N_POSES).transpose(2, 0, 1),
    )


def read_poses(folder: Path) -> list[Pose]:
    """Read the 69 published board poses, `board_to_camera`, from `folder`.

    Raises
    ------
    ImportFormatError
        The file is missing or not of the known form.
    """
    path = _find(folder, _POSES_FILE)
    location = _load(path, _scipy_loadmat()).get("location")
    if not isinstance(location, np.ndarray) or location.shape != (1, N_POSES) or location.dtype.names != ("R", "t"):
        raise _foreign(path, f"location should be a (1, {N_POSES}) struct with the fields R and t")
    return [
        Pose(_numbers(path, "R", entry["R"], (3, 3)), _numbers(path, "t", entry["t"], (1, 3))[0] / 1000)
        for entry in location[0]
    ]


def read_tdoas(folder: Path, problem: Problem) -> FloatArray:
    """Read the published TDOAs in seconds, (414, problem), row = 6 * pose + buzzer, from `folder`.

    Raises
    ------
    ImportFormatError
        The file is missing or not of the known form.
    """
    path = _find(folder, _TDOA_FILES[problem])
    measurement = _load(path, _scipy_loadmat()).get("measurement")
    return _numbers(path, "measurement", measurement, (N_POSES * N_BUZZERS, problem))


def _find(folder: Path, name: str) -> Path:
    """Find a file in the folder, or up to two folders below as in a clone of the authors' repositories."""
    if not folder.is_dir():
        raise ImportFormatError(f"{folder}: no such folder: give the one with the published files")
    found = (path for pattern in (name, f"*/{name}", f"*/*/{name}") for path in sorted(folder.glob(pattern)))
    path = next(found, None)
    if path is None:
        raise ImportFormatError(f"{folder}: {name} is missing: copy it from the authors' repository")
    return path


def _load(path: Path, load: Callable[[str], dict[str, Any]]) -> dict[str, Any]:
    try:
        return load(str(path))
    except Exception as error:  # parsers of a damaged file raise whatever they stumble on
        raise _foreign(path, "cannot be read as a MATLAB file") from error


def _scipy_loadmat() -> Callable[[str], dict[str, Any]]:
    from scipy.io import loadmat  # noqa: PLC0415 (slow to import)

    return cast(Callable[[str], dict[str, Any]], loadmat)


def _matlab_objects() -> Callable[[str], dict[str, Any]]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # mat-io sets an option that pandas 3 calls old
            from matio import load_from_mat  # noqa: PLC0415 (optional)
    except ImportError as error:
        raise ImportFormatError(
            "the package mat-io, which reads MATLAB objects, is missing: pip install 'acoustic-camera-rig[aislab]'"
        ) from error
    return cast(Callable[[str], dict[str, Any]], load_from_mat)


def _numbers(path: Path, name: str, value: Any, shape: tuple[int, ...]) -> FloatArray:
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu":
        raise _foreign(path, f"{name} is missing or not an array of numbers")
    if value.shape != shape:
        raise _foreign(path, f"{name} has the shape {value.shape}, not {shape}")
    if np.isinf(value).any():
        raise _foreign(path, f"{name} holds infinite numbers")
    return np.asarray(value, dtype=float)


def _foreign(path: Path, reason: str) -> ImportFormatError:
    return ImportFormatError(f"{path}: {reason}: is it the published file, and whole?")
