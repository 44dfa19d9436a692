"""`rig-calibrate --follow`: solves while `rig-capture`, another process, records."""

import contextlib
import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from capturing import captured, rig_text, small_description, small_rig
from conftest import write_measured_session

from calib.cli import command
from calib.corners import find_corners
from calib.follow import Follower
from calib.progress import FIGURES
from calib.settings import Settings
from calib.windows import EmissionWindows
from rigs.command import run
from rigs.errors import SessionError
from rigs.session.reader import Session
from rigs.session.watching import Growth

BIN = Path(sys.executable).parent
BUZZERS = [
    {"id": 1 + 3 * row + column, "position_m": (-0.045 + 0.145 * column, -0.045 + 0.215 * row, -0.005)}
    for row in range(2)
    for column in range(3)
]
RIG = {
    "board": {"buzzers": BUZZERS, "buzzer_std_m": 0.0001},
    "capture": {"poses": 8, "frame_interval_s": 0.2},
    "camera": {"fps": 5},
}
FIRST = 6


class Bench:
    """A capture that is stopped and goes on as a test wants it, and what follows it."""

    def __init__(self, folder: Path, *options: str) -> None:
        (folder / "rig.yaml").write_text(rig_text(small_description(**RIG)))
        self.path = folder / "s1.h5"
        self.capture = subprocess.Popen([BIN / "rig-capture", "--session", "s1"], cwd=folder, stdout=subprocess.DEVNULL)
        while not self.path.exists():
            time.sleep(0.01)
        self.pause()
        arguments = [BIN / "rig-calibrate", "s1.h5", "--follow", *options]
        self.follower = subprocess.Popen(
            arguments, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.lines: list[dict] = []

    def pause(self) -> None:
        self.capture.send_signal(signal.SIGSTOP)

    def resume(self) -> None:
        self.capture.send_signal(signal.SIGCONT)

    def record_until(self, n_poses: int) -> None:
        """Let the capture go on until so many poses are saved."""
        self.resume()
        n = 0
        while n < n_poses:
            time.sleep(0.02)
            with contextlib.suppress(SessionError), Session.open(self.path) as session:
                n = np.count_nonzero(session.poses["accepted"])
        self.pause()

    def read_until(self, state: str) -> dict:
        while (line := json.loads(self.follower.stdout.readline())) and line["state"] != state:
            self.lines.append(line)
        self.lines.append(line)
        return line

    def close(self) -> None:
        for program in (self.capture, self.follower):
            if program.poll() is None:
                program.kill()
                program.send_signal(signal.SIGCONT)
            program.wait()
        self.follower.stdout.close()
        self.follower.stderr.close()


@pytest.fixture
def bench(tmp_path):
    bench = Bench(tmp_path)
    yield bench
    bench.close()


def test_a_session_is_followed_to_its_end_and_gives_what_it_gives_at_once(bench):
    assert bench.read_until("waiting")["poses_needed"] == 6
    bench.record_until(FIRST)
    solved = bench.read_until("solved")
    bench.resume()
    bench.read_until("closed")
    assert bench.follower.wait(60) == 0
    assert bench.follower.stderr.read() == ""
    n_poses = [line["n_poses"] for line in bench.lines]
    assert n_poses == sorted(n_poses)
    assert n_poses[-1] == 8
    assert all(set(line) == set(bench.lines[0]) >= set(FIGURES) for line in bench.lines)
    assert solved["poses_used"] >= FIRST
    assert solved["rmse_m"] < 0.003
    assert "centre of the squares at" in solved["next_pose"]["text"]
    assert {line["state"] for line in bench.lines} == {"waiting", "solved", "closed"}
    followed = bench.path.with_suffix(".calib.yaml")
    assert bench.lines[-1]["result"] == followed.name
    assert bench.lines[-1]["rms_std_m"] < solved["rms_std_m"]
    bench.path.with_suffix(".arrivals.npz").unlink()
    at_once = bench.path.with_name("at-once.yaml")
    subprocess.run([BIN / "rig-calibrate", bench.path, "-o", at_once], check=True, stdout=subprocess.DEVNULL)
    assert at_once.read_text() == followed.read_text()


def test_a_killed_capture_is_told_and_what_is_there_is_solved(bench):
    bench.record_until(FIRST)
    bench.read_until("solved")
    bench.capture.kill()
    bench.resume()
    last = bench.read_until("cut off")
    assert bench.follower.wait(60) == 0
    assert last["poses_used"] >= FIRST
    assert any("cut off" in warning for warning in last["warnings"])
    assert yaml.safe_load(bench.path.with_suffix(".calib.yaml").read_text())["warnings"] == last["warnings"]


def test_a_capture_killed_too_early_gives_no_result(bench):
    bench.record_until(2)
    bench.capture.kill()
    bench.resume()
    assert "at least 6 are needed" in bench.read_until("cut off")["missing"]
    assert bench.follower.wait(60) == 5
    assert "at least 6 are needed" in bench.follower.stderr.read()
    assert not bench.path.with_suffix(".calib.yaml").exists()


def test_ctrl_c_ends_it(bench):
    bench.read_until("waiting")
    bench.follower.send_signal(signal.SIGINT)
    assert bench.follower.wait(60) == 130
    assert "Traceback" not in bench.follower.stderr.read()


def test_a_reader_that_goes_away_does_not_cost_the_result(tmp_path, simulated_description):
    write_measured_session(tmp_path / "s1.h5", simulated_description)
    follower = subprocess.Popen(
        [BIN / "rig-calibrate", "s1.h5", "--follow"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    follower.stdout.close()
    assert follower.wait(60) == 0
    assert follower.stderr.read() == b""
    follower.stderr.close()
    assert (tmp_path / "s1.calib.yaml").exists()


class Part:
    """A session when it had so many poses."""

    def __init__(self, session: Session, n_poses: int) -> None:
        self._session = session
        self.poses = session.poses[:n_poses]
        self.complete = False

    def __getattr__(self, name: str):
        return getattr(self._session, name)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "s1.h5"
    captured(path, small_rig(**RIG), seed=3)
    with Session.open(path) as session:
        yield session


def test_nothing_is_looked_at_or_listened_to_twice(whole, monkeypatch, tmp_path):
    looked, heard, started, lines = [], [], [], []
    read, batches = whole.picture, EmissionWindows.batches
    monkeypatch.setattr(whole, "picture", lambda frame: looked.append(frame) or read(frame), raising=False)
    monkeypatch.setattr("calib.corners.find_corners", find_corners)
    monkeypatch.setattr("calib.joint.session.find_start", counted("calib.joint.start", "find_start", started))
    follower = Follower(Settings(), lines.append)
    for n_poses in (5, 6, 7, 8):
        if n_poses == 7:  # by now it is known what the buzzers sound like
            monkeypatch.setattr(
                EmissionWindows, "batches", lambda self, rows: heard.extend(rows.tolist()) or batches(self, rows)
            )
        follower.look(Part(whole, n_poses))
        follower.look(Part(whole, n_poses))
    assert [line["state"] for line in lines] == ["waiting", "solved", "solved", "solved"]
    assert len(looked) == len(set(looked))
    assert sorted(heard) == list(range(36, 48))
    assert len(started) == 1
    final = []
    n_looked = len(looked)
    Follower.finish.__get__(follower)(whole, Growth.CLOSED, tmp_path / "a.yaml", overwrite=False)
    assert len(looked) == n_looked
    fresh = Follower(Settings(), final.append)
    fresh.finish(whole, Growth.CLOSED, tmp_path / "b.yaml", overwrite=False)
    assert (tmp_path / "a.yaml").read_text() == (tmp_path / "b.yaml").read_text()
    np.testing.assert_allclose(
        [mic["position_m"] for mic in lines[3]["microphones"]],
        [mic["position_m"] for mic in final[0]["microphones"]],
        atol=1e-4,
    )


def counted(module: str, name: str, calls: list):
    function = getattr(sys.modules[module], name)
    return lambda *arguments: calls.append(1) or function(*arguments)


def test_a_solve_that_went_astray_is_begun_anew(whole, monkeypatch):
    """If poses fit much worse than those before, where they led is not clung to."""
    lines, started = [], []
    follower = Follower(Settings(), lines.append)
    follower.look(Part(whole, 7))
    before = follower._memory.continuation
    follower._memory.continuation = replace(before, scale=before.scale / 10)
    monkeypatch.setattr("calib.joint.session.find_start", counted("calib.joint.start", "find_start", started))
    follower.look(Part(whole, 8))
    assert started == [1]
    assert lines[-1]["rmse_m"] < 0.001


def test_a_session_of_measured_arrivals_is_followed_too(tmp_path, simulated_description, capsys):
    path = write_measured_session(tmp_path / "s1.h5", simulated_description)
    assert run("rig-calibrate", command, [str(path), "--follow"]) == 0
    (line,) = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert (line["state"], line["poses_used"]) == ("closed", 12)


@pytest.mark.parametrize(
    ("options", "reason"),
    [(["--method", "ours-2"], "--follow solves by joint only"), (["-o", "nowhere/a.yaml"], "there is no folder")],
)
def test_what_cannot_be_followed_is_said_at_once(tmp_path, simulated_description, capsys, options, reason):
    path = write_measured_session(tmp_path / "s1.h5", simulated_description)
    assert run("rig-calibrate", command, [str(path), "--follow", *options]) == 2
    assert reason in capsys.readouterr().err
    assert run("rig-calibrate", command, [str(tmp_path / "no.h5"), "--follow"]) == 5
