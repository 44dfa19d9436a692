"""A session at the virtual bench as a user checks, captures and calibrates it, and what came of it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.optimize import linprog

from calib.evaluation import Evaluation, evaluate
from rigs.board import board_corners_m, find_corners, project
from rigs.description import Intrinsics
from rigs.geometry import Pose
from rigs.session.reader import Session
from virtual_bench.bench import ENVIRONMENT_FILE, RIG_FILE
from virtual_bench.truth import BenchTruth, read_truth

BIN, TESTS = Path(sys.executable).parent, Path(__file__).parents[1]


@dataclass(frozen=True)
class Outcome:
    """What came of a session.

    Parameters
    ----------
    session_path : Path
    truth : BenchTruth
    evaluation : Evaluation
        The calibrated microphones against the true ones.
    said : str
        What capture and calibration told the user.
    check : dict
        What rig-check said before, as JSON.
    """

    session_path: Path
    truth: BenchTruth
    evaluation: Evaluation
    said: str
    check: dict[str, Any]


@contextmanager
def bench_program(folder: Path, *options: str) -> Iterator[dict[str, str]]:
    """Run `python -m virtual_bench` until the block ends, and give the environment that programs need at it."""
    command = [sys.executable, "-m", "virtual_bench", "--folder", str(folder), *options]
    environment = os.environ | {"PYTHONPATH": str(TESTS)}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, env=environment, start_new_session=True
    ) as program:
        try:
            assert "the bench runs" in program.stdout.readline(), "the bench did not start"
            lines = (folder / ENVIRONMENT_FILE).read_text().splitlines()
            yield os.environ | dict(line.removeprefix("export ").split("=", 1) for line in lines)
        finally:
            program.terminate()
            program.communicate(timeout=30)
    assert program.returncode == 0, f"the bench ended with exit code {program.returncode}"


def captured_and_calibrated(folder: Path, poses: int, seed: int = 0) -> Outcome:
    """Check a bench of its own, capture a session at it, calibrate it, and compare with the truth since the check.

    Parameters
    ----------
    folder : Path
        Where all files go.
    poses : int
    seed : int
        Of the bench.
    """
    path = folder / "s1.h5"
    with bench_program(folder, "--seed", str(seed)) as environment:
        check = json.loads(_run("rig-check", "--json", "--rig", folder / RIG_FILE, env=environment))
        began_s = time.monotonic()
        said = _run("rig-capture", "--session", path, "--rig", folder / RIG_FILE, "--poses", poses, env=environment)
    said += _run("rig-calibrate", path, env=dict(os.environ))
    truth = read_truth(folder)
    truth = replace(truth, emissions=[emission for emission in truth.emissions if emission.on_s > began_s])
    result = yaml.safe_load(path.with_suffix(".calib.yaml").read_text())
    positions_m = np.array([microphone["position_m"] for microphone in result["microphones"]])
    return Outcome(path, truth, evaluate(positions_m, truth.microphones_m, "virtual bench"), said, check)


def onset_offsets_s(session: Session) -> NDArray[np.float64]:
    """Return how much later than the board's ON event says each accepted emission was heard (n_emissions,)."""
    onsets = session.onsets
    expected = onsets["predicted_sample"] / session.sample_rate_hz - onsets["latency_s"]
    offsets_s = onsets["measured_sample"] / session.sample_rate_hz - expected
    return offsets_s[(session.emissions["accepted"] == 1) & np.isfinite(offsets_s)]


def bench_offsets_s(session: Session, truth: BenchTruth) -> NDArray[np.float64]:
    """Return how much later than the true edges each accepted emission was heard (n_emissions,), by one line.

    The line runs under the stamps of all blocks, so it holds where no sample was lost. What these vary is the bench's
    own fault, and the way of the sound; what `onset_offsets_s` vary more is the capture's.
    """
    rows = np.flatnonzero(session.emissions["accepted"] == 1)
    on_s = np.array([emission.on_s for emission in truth.emissions])[rows]
    sample_s = session.audio_blocks["first_sample"] / session.sample_rate_hz
    late_s = session.audio_blocks["host_time_s"] - sample_s
    begin_s = late_s[0]
    under = np.column_stack([sample_s, np.ones_like(sample_s)])
    slope, first_s = linprog(-under.mean(axis=0), under, late_s - begin_s, bounds=(None, None)).x
    measured_s = session.onsets["measured_sample"][rows] / session.sample_rate_hz
    return begin_s + measured_s * (1 + slope) + first_s - on_s


def spread_p95_s(offsets_s: NDArray[np.float64]) -> float:
    """Return the 95th percentile of the distances from the median."""
    return float(np.percentile(np.abs(offsets_s - np.median(offsets_s)), 95))


def corner_errors_px(session: Session, truth: BenchTruth) -> NDArray[np.float64]:
    """Return the root mean square error of the corners in the first and last picture of each accepted pose (n, 2)."""
    document, board = truth.document, session.description.board
    matrix = np.array(document["camera_matrix"])
    intrinsics = Intrinsics(
        focal_px=(matrix[0, 0], matrix[1, 1]),
        principal_px=(matrix[0, 2], matrix[1, 2]),
        distortion=tuple(document["distortion"]),
    )
    printed_m = board_corners_m(board) * document["square_size_m"] / board.square_size_m
    errors_px = []
    for row in session.poses[session.poses["accepted"] == 1]:
        frames = np.flatnonzero(session.frames["pose"] == row["pose"])
        matrix = np.array(place_at(truth, row["start_host_time_s"])["board_to_camera"])
        expected_px = project(printed_m, Pose(matrix[:3, :3], matrix[:3, 3]), intrinsics)
        seen_px = [find_corners(session.picture(int(frame)), board) for frame in (frames[0], frames[-1])]
        errors_px.append([_rms_px(corners_px - expected_px) for corners_px in seen_px])
    return np.array(errors_px)


def _rms_px(errors_px: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.sum(errors_px**2, axis=1))))


def place_at(truth: BenchTruth, host_time_s: float) -> dict:
    """Return the place where the board stood at a host time, or came from last."""
    return [place for place in truth.document["places"] if place["reached_s"] <= host_time_s][-1]


def _run(script: str, *arguments: object, env: dict[str, str]) -> str:
    command = [str(word) for word in (BIN / script, *arguments)]
    done = subprocess.run(command, capture_output=True, text=True, env=env, timeout=900, check=False)
    assert done.returncode == 0, f"{script} ended with exit code {done.returncode}:\n{done.stdout}{done.stderr}"
    return done.stdout + done.stderr
