"""Studies on several processes: on this machine's cores, and on a Dask cluster whose members die."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from dask_cluster import START_S, dask_cluster, wait_until

pytest.importorskip("distributed")

import pyarrow.parquet as pq

# 24 parts of a tenth of a second
STUDY = """
format: acoustic-study
version: 1
name: parts
repetitions: 120
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


@pytest.fixture
def rig_study(study):
    """Start the command as a process of its own; whatever still runs at the end is ended."""
    started = []

    def start(output: Path, *options: str, limited: bool = True) -> subprocess.Popen:
        threads = {"OPENBLAS_NUM_THREADS": "1"}
        environment = {name: value for name, value in os.environ.items() if name not in threads}
        program = "import sys; from calib.study.cli import main; sys.exit(main())"
        started.append(
            subprocess.Popen(
                [sys.executable, "-c", program, str(study), "-o", str(output), *options],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
                cwd=study.parent,
                env=environment | threads if limited else environment,
                start_new_session=True,
            )
        )
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.communicate()


def results(output: Path):
    return pq.read_table(output / "parts" / "results.parquet")


def n_parts(output: Path) -> int:
    return len(list((output / "parts" / "parts").glob("part-*.parquet")))


def test_a_killed_worker_loses_and_doubles_nothing(rig_study, tmp_path):
    alone, shared = tmp_path / "alone", tmp_path / "shared"
    with dask_cluster(tmp_path / "cluster", 2) as cluster:
        running = rig_study(shared, "--cluster", cluster.address)
        wait_until(lambda: n_parts(shared) >= 1 or running.poll() is not None)
        cluster.hold()
        assert running.poll() is None
        cluster.workers[0].kill()
        cluster.go_on()
        _, err = running.communicate(timeout=START_S)
    assert running.returncode == 0, err
    _, err = (only := rig_study(alone, "--workers", "1")).communicate(timeout=START_S)
    assert only.returncode == 0, err
    assert results(shared).column("repetition").to_pylist() == list(range(120))
    assert results(shared).equals(results(alone))


def test_the_tables_are_the_same_to_the_byte_whatever_the_number_of_workers(rig_study, study, tmp_path):
    """Threads of linear algebra add up in another order: one worker must not take what two do not."""
    changes = {
        "repetitions: 120": "repetitions: 30",
        "n_poses: 300": "n_poses: 60",
        "scale_s: 10.0e-6": "scale_s: 1.0e-6, buzzer_std_m: 0.0003",
        "methods: [ours-2]": "methods: [ours-1, ours-2], n_poses: [12, 24]",
    }
    text = study.read_text()
    for old, new in changes.items():
        text = text.replace(old, new)
    study.write_text(text)
    outputs = {number: tmp_path / number for number in ("1", "2")}
    for number, output in outputs.items():
        _, err = (running := rig_study(output, "--workers", number, limited=False)).communicate(timeout=START_S)
        assert running.returncode == 0, err
    for name in ("results.csv", "results.parquet", "summary.csv", "page.md"):
        one, two = ((output / "parts" / name).read_bytes() for output in outputs.values())
        assert one == two, name


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_of_all_local_workers_is_one_line(rig_study, tmp_path, number):
    output = tmp_path / "results"
    running = rig_study(output, "--workers", "2")
    wait_until(lambda: n_parts(output) >= 1 or running.poll() is not None)
    if number == signal.SIGINT:
        os.killpg(running.pid, number)  # as a terminal does: the workers get it, too
    else:
        running.send_signal(number)
    _, err = running.communicate(timeout=START_S)
    told = "rig-study: interrupted: run the same command again to go on; finished parts are kept\n"
    assert (running.returncode, err) == (130, told)
    assert 1 <= n_parts(output) < 24


def test_a_scheduler_that_dies_is_told_and_what_was_finished_stays(rig_study, tmp_path):
    output = tmp_path / "results"
    with dask_cluster(tmp_path / "cluster", 1) as cluster:
        running = rig_study(output, "--cluster", cluster.address)
        wait_until(lambda: n_parts(output) >= 1 or running.poll() is not None)
        cluster.hold()
        cluster.scheduler.kill()
        _, err = running.communicate(timeout=START_S)
    assert running.returncode == 3
    (line,) = err.splitlines()
    assert line.startswith("rig-study: tcp://127.0.0.1:")
    assert "the scheduler is lost: run the same command again" in line
    kept = {path.name: path.stat().st_mtime_ns for path in (output / "parts" / "parts").iterdir()}
    assert kept
    resumed = rig_study(output, "--workers", "2")
    _, err = resumed.communicate(timeout=START_S)
    assert resumed.returncode == 0, err
    assert results(output).column("repetition").to_pylist() == list(range(120))
    assert all((output / "parts" / "parts" / name).stat().st_mtime_ns == time for name, time in kept.items())


@pytest.mark.parametrize(
    ("address", "words", "exit_code"),
    [
        ("tcp://127.0.0.1:1", "tcp://127.0.0.1:1: no scheduler answers", 3),
        ("127.0.0.1:8786", "127.0.0.1:8786: not the address of a scheduler: give one such as tcp://", 2),
    ],
)
def test_a_cluster_that_is_not_there_is_told(rig_study, tmp_path, address, words, exit_code):
    running = rig_study(tmp_path / "results", "--cluster", address)
    _, err = running.communicate(timeout=START_S)
    assert running.returncode == exit_code
    assert words in err
    assert "Traceback" not in err
