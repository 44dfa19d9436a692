"""The serial board against the simulated Uno that runs the real firmware: clocks, restarts, and a whole session."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
import yaml
from capturing import rig_text
from simboard import BUZZER_PINS, LED_PIN, running_board
from simulated import make_description

from acquire.devices.board_clock import BoardClock
from acquire.devices.board_serial import SerialBoard
from acquire.errors import DeviceError, DeviceRestartedError
from rigs.session.reader import Session
from rigs.waveform import Waveform

SHORT = Waveform("sweep", 0.005, 1000.0, 8000.0)
QUESTION_S, REPLY_S = 0.003, 0.006  # a ping's ways: 1.5 ms and 3.7 ms where nothing holds it up
BIN = Path(sys.executable).parent
SIX_BUZZERS = [
    {"id": 1 + 3 * row + column, "position_m": (-0.045 + 0.145 * column, -0.045 + 0.215 * row, -0.005)}
    for row in range(2)
    for column in range(3)
]


@pytest.fixture
def board():
    with running_board() as board:
        yield board


@pytest.fixture
def opened(board):
    serial_board = SerialBoard(board.port, SHORT, [1, 6])
    serial_board.open()
    yield serial_board
    serial_board.close()


class NotedClock(BoardClock):
    """A board clock that remembers its pings: the two host times and the board's reading."""

    noted: ClassVar[list[tuple[float, float, int]]] = []

    def add(self, earliest_s, latest_s, board_us):
        self.noted.append((earliest_s, latest_s, board_us))
        super().add(earliest_s, latest_s, board_us)


def clock_zero_s(board, starts):
    """Return when, since power-on, the board's clock read zero, from the first edges of what was played."""
    first_edges_s = board.trace().pin(LED_PIN)[0][::2]
    zeros_s = first_edges_s - np.array([start.board_time_s for start in starts])
    assert np.ptp(zeros_s) < 50e-6  # how exactly the firmware stamps is for its own tests to say
    return np.median(zeros_s)


def wait_for_trace(board, starts):
    """Wait until the last emission's end is in the trace; the pings before it were then written down as well."""
    end_s = time.monotonic() + 20
    while len(board.trace().pin(LED_PIN)[0]) < 2 * len(starts):
        assert time.monotonic() < end_s, "the trace does not tell all that was played"
        time.sleep(0.005)


def undisturbed_pings(board, opened):
    """Play until there are 40 pings that the computer did not hold up, as the simulated board's own notes tell.

    Returns the pings (n, 3), earliest and latest host times and board times in seconds, and when the board really read
    its clock (n,): all as on a board that never stands still, as no real one does.
    """
    starts = []
    while len(starts) < 800:
        for _ in range(40):
            starts.append(opened.play(1, SHORT))
            time.sleep(0.01)
        wait_for_trace(board, starts)
        pace = board.pace()
        earliest_s, latest_s, board_us = np.array(NotedClock.noted).T
        power_on_s = clock_zero_s(board, starts) + 1e-6 * board_us
        read_s = pace.host_time_s(power_on_s)
        before_s, after_s = read_s - earliest_s, latest_s - read_s
        kept = np.flatnonzero((before_s < QUESTION_S) & (after_s < REPLY_S))[-60:]
        if len(kept) >= 40:
            late_s = pace.late_s(power_on_s)
            pings = np.stack([earliest_s - late_s, latest_s - late_s, 1e-6 * board_us], axis=1)
            return pings[kept], (read_s - late_s)[kept], len(board_us)
    pytest.fail("hardly any ping went through undisturbed: this computer is too busy")


def test_the_fitted_clock_tells_when_the_board_read_its_own(board, monkeypatch):
    monkeypatch.setattr("acquire.devices.board_serial.BoardClock", NotedClock)
    monkeypatch.setattr(NotedClock, "noted", [])
    opened = SerialBoard(board.port, SHORT, [1])
    opened.open()
    pings, read_s, n_pings = undisturbed_pings(board, opened)
    opened.close()
    clock = BoardClock()
    for earliest_s, latest_s, board_s in pings:
        clock.add(earliest_s, latest_s, round(1e6 * board_s))
    error_s = clock.host_s(pings[:, 2]) - read_s
    constant_s = np.median(error_s)
    p95_s = np.percentile(np.abs(error_s - constant_s), 95)
    pings_p95_s = np.percentile(np.abs(clock.residuals_s()), 95)
    print(  # noqa: T201
        f"board clock to host clock: {len(pings)} of {n_pings} pings; 95 % within {1e6 * p95_s:.0f} us of what the "
        f"board did, apart from {1e6 * constant_s:.0f} us throughout, within {1e6 * pings_p95_s:.0f} us of the pings"
    )
    assert p95_s < 0.0005
    assert abs(constant_s) < 0.002  # a reply takes longer than the question


def test_emissions_begin_when_the_board_says(board, opened):
    starts = []
    for buzzer in (1, 3, 6, 1):
        starts.append((buzzer, opened.play(buzzer, SHORT)))
        time.sleep(0.03)
    opened.close()
    board.settle()
    trace, pace = board.trace(), board.pace()
    for buzzer, start in starts:
        edges_s, _ = trace.pin(BUZZER_PINS[buzzer])
        first_s = clock_zero_s(board, [start for _, start in starts]) + start.board_time_s
        assert np.abs(edges_s - first_s).min() < 50e-6
        stalls_s = np.ptp(pace.host_s - pace.board_s)  # the clock may have been fitted in one of them
        assert start.host_time_s == pytest.approx(pace.host_time_s(first_s), abs=0.002 + stalls_s)


def test_a_board_that_is_reset_in_mid_session_is_opened_again(board, opened):
    opened.play(1, SHORT)
    board.reset()
    time.sleep(0.05)
    with pytest.raises(DeviceRestartedError):
        opened.read_clock()
    opened.open()
    assert opened.play(6, SHORT).board_time_s < 2
    opened.close()
    assert len(board.trace().pin(BUZZER_PINS[6])[0]) > 10


def test_a_board_that_is_pulled_out_in_mid_session_is_named():
    with running_board() as board:
        opened = SerialBoard(board.port, SHORT, [1])
        opened.open()
    with pytest.raises(DeviceError, match="the board is gone"):
        opened.play(1, SHORT)


@pytest.fixture
def starved(board):
    """Let the board stand still again and again, as on a computer that is too busy to simulate it."""
    generator, ends = np.random.default_rng(2), threading.Event()

    def starve():
        while not ends.wait(generator.uniform(0.2, 1.5)):
            os.kill(board.pid, signal.SIGSTOP)
            time.sleep(generator.uniform(0.05, 0.6))
            os.kill(board.pid, signal.SIGCONT)

    thread = threading.Thread(target=starve)
    thread.start()
    yield board
    ends.set()
    thread.join()


@pytest.mark.parametrize("pace", ["board", "starved"])
def test_a_session_with_the_serial_board_calibrates(pace, request, tmp_path):
    """Microphones and camera are simulated and hear and see, in real time, what the real firmware plays."""
    board = request.getfixturevalue(pace)
    description = make_description(
        trigger={"driver": "serial", "port": board.port},
        board={"buzzers": SIX_BUZZERS, "buzzer_std_m": 0.0001},
        camera={"size_px": (640, 480), "intrinsics": {"focal_px": (474.0, 474.0), "principal_px": (319.5, 239.5)}},
        signal={"gap_s": 0.15},
        capture={"poses": 4, "still_s": 0.3},
        simulation={"rt60_s": 0.1},
    )
    (tmp_path / "rig.yaml").write_text(rig_text(description))
    for command in (["rig-capture", "--session", "s1", "--seed", "5"], ["rig-calibrate", "s1.h5"]):
        done = subprocess.run(
            [BIN / command[0], *command[1:]], cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr
    with Session.open(tmp_path / "s1.h5") as session:
        emissions = session.emissions
        accepted = emissions[emissions["accepted"] == 1]
        host_s, board_s = emissions["host_time_s"], emissions["board_time_s"]
    played = {(row["pose"], row["buzzer"]) for row in accepted}
    assert played == {(pose, buzzer["id"]) for pose in range(4) for buzzer in SIX_BUZZERS}
    assert len(accepted) == 24
    assert np.all(np.diff(host_s) > 0.2)
    pace = board.pace()
    stalls_s = np.ptp(pace.host_s - pace.board_s)
    assert np.ptp(host_s) == pytest.approx(np.ptp(board_s), abs=0.01 + stalls_s)
    result = yaml.safe_load((tmp_path / "s1.calib.yaml").read_text())
    assert result["evaluation"]["rmse_m"] < 0.003
    assert result["residual"]["robust_sigma_s"] < 1e-6
