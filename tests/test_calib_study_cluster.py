"""Studies on several processes: on this machine's cores, and on a Dask cluster whose members die."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from dask_cluster import dask_cluster, wait_until

pytest.importorskip("distributed")

import pyarrow.parquet as pq

# 20 parts of a tenth of a second
STUDY = """
format: acoustic-study
version: 1
name: parts
repetitions: 100
speed_of_sound_m_s: 343
arrays: {ring: {kind: ring, n_mics: 8, radius_m: 0.25, rise_m: 0.3}}
boards: {bench: {kind: rig, rig: bench8}}
pose_sets: {many: {kind: drawn, n_poses: 300}}
noises: {10 us: {law: gaussian, scale_s: 10.0e-6}}
runs:
  - {arrays: [ring], boards: [bench], pose_sets: [many], noises: [10 us], methods: [ours-2]}
"""


@pytest.fixture
def study(tmp_path):
    path = tmp_path / "parts.yaml"
    path.write_text(STUDY)
    return path


def rig_study(study: Path, output: Path, *options: str) -> subprocess.Popen:
    program = "import sys; from calib.study.cli import main; sys.exit(main())"
    return subprocess.Popen(
        [sys.executable, "-c", program, str(study), "-o", str(output), *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=study.parent,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
    )


def results(output: Path):
    return pq.read_table(output / "parts" / "results.parquet")


def n_parts(output: Path) -> int:
    return len(list((output / "parts" / "parts").glob("part-*.parquet")))


def test_a_killed_worker_loses_and_doubles_nothing(study, tmp_path):
    alone, shared = tmp_path / "alone", tmp_path / "shared"
    with dask_cluster(tmp_path / "cluster", 2) as cluster:
        running = rig_study(study, shared, "--cluster", cluster.address)
        wait_until(lambda: n_parts(shared) >= 3 or running.poll() is not None)
        cluster.workers[0].kill()
        seen = n_parts(shared)
        _, err = running.communicate(timeout=300)
    assert running.returncode == 0, err
    assert 3 <= seen < n_parts(shared)  # it was killed in mid-run
    assert rig_study(study, alone, "--workers", "1").wait(timeout=300) == 0
    assert results(shared).column("repetition").to_pylist() == list(range(100))
    assert results(shared).equals(results(alone))


def test_a_scheduler_that_dies_is_told_and_what_was_finished_stays(study, tmp_path):
    output = tmp_path / "results"
    with dask_cluster(tmp_path / "cluster", 1) as cluster:
        running = rig_study(study, output, "--cluster", cluster.address)
        wait_until(lambda: n_parts(output) >= 3 or running.poll() is not None)
        cluster.scheduler.kill()
        _, err = running.communicate(timeout=300)
    assert running.returncode == 3
    (line,) = [line for line in err.splitlines() if line.startswith("rig-study:")]
    assert "the scheduler is lost" in line
    assert "Traceback" not in err
    kept = {path.name: path.stat().st_mtime_ns for path in (output / "parts" / "parts").iterdir()}
    assert len(kept) >= 3
    resumed = rig_study(study, output, "--workers", "2")
    _, err = resumed.communicate(timeout=300)
    assert resumed.returncode == 0, err
    assert results(output).column("repetition").to_pylist() == list(range(100))
    assert all((output / "parts" / "parts" / name).stat().st_mtime_ns == time for name, time in kept.items())


def test_interrupting_keeps_what_was_finished(study, tmp_path):
    output = tmp_path / "results"
    running = rig_study(study, output, "--workers", "1")
    wait_until(lambda: n_parts(output) >= 2 or running.poll() is not None)
    running.send_signal(signal.SIGINT)
    _, err = running.communicate(timeout=60)
    assert running.returncode == 130
    assert err.splitlines()[-1] == "rig-study: interrupted"
    assert 2 <= n_parts(output) < 100
    assert not (output / "parts" / "results.parquet").exists()


@pytest.mark.parametrize(
    ("address", "words", "exit_code"),
    [
        ("tcp://127.0.0.1:1", "tcp://127.0.0.1:1: no scheduler answers", 3),
        ("127.0.0.1:8786", "127.0.0.1:8786: not the address of a scheduler: give one such as tcp://", 2),
    ],
)
def test_a_cluster_that_is_not_there_is_told(study, tmp_path, address, words, exit_code):
    running = rig_study(study, tmp_path / "results", "--cluster", address)
    _, err = running.communicate(timeout=60)
    assert running.returncode == exit_code
    assert words in err
    assert "Traceback" not in err
