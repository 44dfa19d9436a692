"""Exports as plain text: ODAS's configuration, a camera as Kalibr writes it, CSV and JSON."""

from __future__ import annotations

import csv
import io
import json

import yaml

from calib.export.heading import heading
from calib.result_file import StoredCalibration
from rigs.geometry import CAMERA_FRAME

AXES = "xyz"


def odas_cfg(array: StoredCalibration) -> bytes:
    """Return the blocks `mapping` and `general` of a configuration of ODAS, with covariances and speed of sound."""
    microphones = ",\n".join(
        "        {\n"
        f"            mu = {_listed(place_m, '+.7f')};\n"
        f"            sigma2 = {_listed(covariance.ravel(), '+.6e')};\n"
        "            direction = ( +0.0, +0.0, +1.0 );\n"
        "            angle = ( 180.0, 180.0 );\n"
        "        }"
        for place_m, covariance in zip(array.positions_m, array.covariance_m2, strict=True)
    )
    variance = array.speed_of_sound_std_m_s**2
    comments = "\n".join(f"# {line}" for line in heading(array))
    return f"""{comments}
# Put these two blocks in the place of your configuration's own. mapping counts the sound card's inputs from 1.

mapping:
{{
    map: {_listed(array.channels, "d")};
}};

general:
{{
    epsilon = 1E-20;
    size: {{ hopSize = 512; frameSize = 1024; }};
    samplerate: {{ mu = {round(array.recording.sample_rate_hz)}; sigma2 = 0.01; }};
    speedofsound: {{ mu = {array.speed_of_sound_m_s:.4f}; sigma2 = {variance:.6e}; }};
    mics = (
{microphones}
    );
    spatialfilters = ( {{ direction = ( +0.0, +0.0, +1.0 ); angle = ( 180.0, 180.0 ); }} );
    nThetas = 181;
    gainMin = 0.25;
}};
""".encode()


def kalibr_yaml(array: StoredCalibration) -> bytes:
    """Return the camera as Kalibr's camchain has it.

    Kalibr's `radtan` has no k3. With one the model is called plumb_bob, as ROS does, which Kalibr refuses to misread.
    """
    *radtan, k3 = array.intrinsics.distortion
    camera = {
        "camera_model": "pinhole",
        "intrinsics": [*array.intrinsics.focal_px, *array.intrinsics.principal_px],
        "distortion_model": "plumb_bob" if k3 else "radtan",
        "distortion_coeffs": [*radtan, k3] if k3 else radtan,
        "resolution": list(array.recording.picture_size_px),
        "rostopic": "/camera/image_raw",
    }
    lines = [*heading(array), "Camera: fx, fy, cx, cy in pixels; k1, k2, p1, p2 (and k3); width, height in pixels."]
    comments = "".join(f"# {line}\n" for line in lines)
    return (comments + yaml.safe_dump({"cam0": camera}, sort_keys=False, default_flow_style=None)).encode()


def microphones_csv(array: StoredCalibration) -> bytes:
    """Return a table, a row per microphone, below comments that begin with #."""
    upper = [(row, column) for row in range(3) for column in range(row, 3)]
    stream = io.StringIO()
    stream.writelines(f"# {line}\n" for line in heading(array))
    table = csv.writer(stream, lineterminator="\n")
    covariances = [f"cov_{AXES[row]}{AXES[column]}_m2" for row, column in upper]
    table.writerow(
        ["channel", "column", *(f"{axis}_m" for axis in AXES), *(f"std_{axis}_m" for axis in AXES), *covariances]
    )
    for row, channel in enumerate(array.channels):
        place = [f"{value:.7f}" for value in array.positions_m[row]] + [f"{std:.6g}" for std in array.std_m[row]]
        table.writerow([channel, array.columns[row], *place, *(f"{array.covariance_m2[row][at]:.6g}" for at in upper)])
    return stream.getvalue().encode()


def microphones_json(array: StoredCalibration) -> bytes:
    """Return everything under names that say their units."""
    document = {
        "made_by": array.software,
        "method": array.method,
        "session": {"name": array.session_names, "sha256": " + ".join(array.sessions)},
        "frame": CAMERA_FRAME,
        "speed_of_sound_m_s": array.speed_of_sound_m_s,
        "speed_of_sound_std_m_s": array.speed_of_sound_std_m_s,
        "sample_rate_hz": array.recording.sample_rate_hz,
        "microphones": [
            {
                "channel": channel,
                "column": column,
                "position_m": place_m.tolist(),
                "std_m": std_m.tolist(),
                "covariance_m2": covariance.tolist(),
            }
            for channel, column, place_m, std_m, covariance in zip(
                array.channels, array.columns, array.positions_m, array.std_m, array.covariance_m2, strict=True
            )
        ],
        "camera": array.intrinsics.model_dump(mode="json") | {"picture_size_px": list(array.recording.picture_size_px)},
    }
    return (json.dumps(document, indent=1) + "\n").encode()


def _listed(values: object, form: str) -> str:
    return f"( {', '.join(format(value, form) for value in values)} )"  # type: ignore[attr-defined]
