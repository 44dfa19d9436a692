"""The published measurements (AISLAB, SUSTech) as a session that begins at measured corners and TDOAs.

Source: Li, Wang, Li, Kong, "Improved Extrinsic Calibration of Acoustic Cameras via Batch Optimization",
arXiv 2502.06196; files of the authors' repository AISLAB-sustech/AcousticCamera.
"""

from __future__ import annotations

import math
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
import yaml
from numpy.typing import NDArray

import rigs
from rigs.board import board_corners_m, project
from rigs.description import Board, RigDescription
from rigs.errors import RigError, TargetExistsError
from rigs.library import parse_description, shipped_rigs
from rigs.session.aislab_files import N_BUZZERS, N_POSES, Problem, PublishedCamera, read_camera, read_poses, read_tdoas
from rigs.session.layout import MeasuredTdoas, Truth
from rigs.session.writer import SessionWriter
from rigs.target import check_target

FloatArray = NDArray[np.float64]
Layout = Literal["A", "B"]

# Two sets of buzzer places that the authors use, on the board, in millimetres.
BUZZERS_MM: dict[Layout, list[tuple[int, int, int]]] = {
    "A": [(195, -2, 0), (-40, -5, 5), (195, 140, 5), (-40, 140, 2), (200, 60, 5), (-40, 60, 5)],
    "B": [(200, 0, 2), (-40, 0, 2), (200, 140, 2), (-40, 140, 2), (200, 60, 2), (-40, 60, 2)],
}
AUTHORS_LAYOUT: dict[Problem, Layout] = {28: "A", 7: "B", 8: "B"}
REFERENCE_CHANNEL = 9
REFERENCE_ON_BOARD_M = np.array([-0.09, -0.037, -0.007])  # at the first pose
RULER_M = np.array(
    [
        [0.0, 0.0, 0.0], [0.37, 0.0, 0.0], [0.0, 0.4, 0.0], [0.0, -0.006, 0.395],
        [0.365, 0.385, 0.0], [0.37, -0.006, 0.395], [-0.002, 0.395, 0.395], [0.39, 0.395, 0.395],
    ]
)  # fmt: skip
ARRAY_ORIGIN_M = np.array([-0.18, -0.28, -0.24])  # in the camera frame; the authors assume that nothing is tilted
_HEADING = "# The rig of arXiv 2502.06196, with the published intrinsics.\n"


def import_aislab(
    folder: Path, target: Path, *, problem: Problem = 28, layout: Layout | None = None, overwrite: bool = False
) -> None:
    """Turn the published files into a session with measured corners, measured TDOAs and the ruler's truth.

    Parameters
    ----------
    folder : Path
        Where the files are, or a clone of the authors' repository.
    target : Path
        The session file to write.
    problem : {28, 7, 8}
        TDOAs of each emission: all pairs, against microphone 1, or against the ninth microphone.
    layout : {"A", "B"}, optional
        Buzzer places; by default those that the authors use for the problem.
    overwrite : bool
        Replace the target where it exists.

    Raises
    ------
    ImportFormatError
        A file is missing or not of the known form.
    TargetExistsError
        The target is there and `overwrite` is false.
    RigError
        The target's folder is missing.
    """
    _check_target(target, overwrite=overwrite)
    camera, poses, tdoa_s = read_camera(folder), read_poses(folder), read_tdoas(folder, problem)
    reference_m = poses[0].apply(REFERENCE_ON_BOARD_M) if problem == 8 else None
    text = _description_text(camera, problem, layout or AUTHORS_LAYOUT[problem], reference_m)
    description = parse_description(text, "kinect8.yaml (shipped, as imported)")
    with TemporaryDirectory(dir=target.parent, prefix=f".{target.name}.") as folder_beside:
        partial = Path(folder_beside) / target.name
        corners = corners_px(camera, description.board)
        _write(partial, description, text, corners, MeasuredTdoas(tdoa_s, _pairs(problem)))
        partial.replace(target)


def corners_px(camera: PublishedCamera, board: Board) -> FloatArray:
    """Rebuild the detected corners (69, 72, 2) in pixels, in the order of `board_corners_m`.

    Detected = reprojected - reprojection error. MATLAB counts its corners column after column, the board row after row.
    """
    projected = np.array([project(camera.corners_m, pose, camera.intrinsics) for pose in camera.poses])
    detected = projected - camera.reprojection_errors_px
    row_after_row = np.lexsort((camera.corners_m[:, 0], camera.corners_m[:, 1]))
    if not np.allclose(camera.corners_m[row_after_row], board_corners_m(board)):
        raise RigError("kinect8.yaml: the board is not the published one: 9 x 8 corners, squares of 0.02 m")
    return np.asarray(detected[:, row_after_row])


def _check_target(target: Path, *, overwrite: bool) -> None:
    if target.is_file() and not overwrite:
        raise TargetExistsError(f"{target}: exists already: name another file, or replace it with --overwrite")
    check_target(target, replaces="session" if overwrite else None)


def _description_text(camera: PublishedCamera, problem: Problem, layout: Layout, reference_m: FloatArray | None) -> str:
    rig: dict[str, Any] = yaml.safe_load(shipped_rigs()["kinect8"])
    rig["name"] = f"aislab {problem} TDOAs, layout {layout}"
    rig["signal"] = {"kind": "tone", "gap_s": 0.4}  # the paper's; kinect8 ships a better one
    rig["camera"]["intrinsics"] = camera.intrinsics.model_dump(mode="json")
    rig["board"]["buzzers"] = [
        {"id": number, "position_m": [coordinate / 1000 for coordinate in place_mm]}
        for number, place_mm in enumerate(BUZZERS_MM[layout], start=1)
    ]
    if reference_m is not None:
        rig["audio"]["reference_microphone"] = {"channel": REFERENCE_CHANNEL, "position_m": reference_m.tolist()}
    return _HEADING + yaml.safe_dump(rig, sort_keys=False, default_flow_style=None)


def _pairs(problem: Problem) -> NDArray[np.int32]:
    """Return the channels (i, j) of each column, counted from 1."""
    microphones = range(1, len(RULER_M) + 1)
    pairs = {
        28: list(combinations(microphones, 2)),
        7: [(1, j) for j in microphones[1:]],
        8: [(REFERENCE_CHANNEL, j) for j in microphones],
    }
    return np.array(pairs[problem], dtype=np.int32)


def _write(path: Path, description: RigDescription, text: str, corners: FloatArray, tdoas: MeasuredTdoas) -> None:
    with SessionWriter.create(
        path,
        name=description.name,
        description_text=text,
        n_channels=len(description.audio.recorded_channels()),
        sample_rate_hz=description.audio.sample_rate_hz,
        versions={"software": f"acoustic-camera-rig {rigs.__version__}", "source": "AISLAB-sustech/AcousticCamera"},
        truth=Truth(RULER_M + ARRAY_ORIGIN_M, "ruler"),
        corners_px=corners,
        tdoas=tdoas,
    ) as writer:
        for pose in range(N_POSES):
            _append_pose(writer, pose, description)


def _append_pose(writer: SessionWriter, pose: int, description: RigDescription) -> None:
    for buzzer in range(1, N_BUZZERS + 1):
        writer.append_emission(
            pose=pose,
            buzzer=buzzer,
            repeat=0,
            waveform=description.signal.waveform().label(),
            board_time_s=math.nan,  # not published, as are all times
            host_time_s=math.nan,
            expected_sample=-1,
            accepted=True,
        )
    writer.append_pose(pose=pose, start_host_time_s=math.nan, end_host_time_s=math.nan, accepted=True)
