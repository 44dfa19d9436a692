"""The exports by name, and the files that each makes."""

from __future__ import annotations

from collections.abc import Callable

from calib.errors import MethodError
from calib.export.arrays import matlab_mat, positions_npy, pyroomacoustics_loader
from calib.export.listings import kalibr_yaml, microphones_csv, microphones_json, odas_cfg
from calib.export.markup import acoular_xml, ros2_launch_xml, urdf
from calib.result_file import StoredCalibration

Write = Callable[[StoredCalibration], bytes]

# For each name, the endings of its files and what makes them.
FORMATS: dict[str, dict[str, Write]] = {
    "acoular": {".acoular.xml": acoular_xml},
    "pyroomacoustics": {".pyroomacoustics.npy": positions_npy, ".pyroomacoustics.py": pyroomacoustics_loader},
    "odas": {".odas.cfg": odas_cfg},
    "ros2": {".ros2.launch.xml": ros2_launch_xml},
    "urdf": {".urdf": urdf},
    "kalibr": {".kalibr.yaml": kalibr_yaml},
    "matlab": {".microphones.mat": matlab_mat},
    "csv": {".microphones.csv": microphones_csv},
    "json": {".microphones.json": microphones_json},
}


def chosen_formats(names: str | None) -> tuple[str, ...]:
    """Return the exports that a list such as "acoular,odas" or "all" means.

    Raises
    ------
    MethodError
        One is not known.
    """
    if names is None:
        return ()
    chosen = [name.strip() for name in names.split(",")]
    unknown = next((name for name in chosen if name not in {*FORMATS, "all"}), None)
    if unknown is not None:
        raise MethodError(f"--export: {unknown!r} is not known: give all, or some of {','.join(FORMATS)}")
    return tuple(FORMATS) if "all" in chosen else tuple(dict.fromkeys(chosen))


def endings(names: tuple[str, ...]) -> list[str]:
    """Return the endings of the files that exports make."""
    return [ending for name in names for ending in FORMATS[name]]


def export(array: StoredCalibration, names: tuple[str, ...]) -> dict[str, bytes]:
    """Return the content of each export's files by their endings."""
    return {ending: write(array) for name in names for ending, write in FORMATS[name].items()}
