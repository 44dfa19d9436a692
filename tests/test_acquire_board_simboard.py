"""The serial board against the simulated Uno that runs the real firmware: clocks, restarts, and a whole session."""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from capturing import rig_text
from simboard import BUZZER_PINS, running_board
from simulated import make_description

from acquire.devices.board_serial import SerialBoard
from acquire.errors import DeviceError, DeviceRestartedError
from rigs.session.reader import Session
from rigs.waveform import Waveform

SHORT = Waveform("sweep", 0.005, 1000.0, 8000.0)
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


def pinged_p95_s(serial_board):
    """Return the 95th percentile of the residuals of the fitted clock, and how many pings it is of."""
    for _ in range(40):
        serial_board.play(1, SHORT)
        time.sleep(0.02)
    residuals_s = np.abs(serial_board.clock.residuals_s())
    return np.percentile(residuals_s, 95), len(residuals_s)


def test_the_fitted_clock_leaves_little_of_the_pings(opened):
    """On a busy computer the simulated board stands still now and then, as no real one does: so three tries."""
    for _ in range(3):
        p95_s, n_pings = pinged_p95_s(opened)
        print(f"board clock to host clock, {n_pings} pings: 95 % within {1e6 * p95_s:.0f} us")  # noqa: T201
        if p95_s < 0.0005 and n_pings > 30:
            return
    pytest.fail("the residual is above 0.5 ms")


def test_emissions_begin_when_the_board_says(board, opened):
    starts = []
    for buzzer in (1, 3, 6, 1):
        starts.append((buzzer, opened.play(buzzer, SHORT)))
        time.sleep(0.03)
    opened.close()
    trace = board.trace()
    told_s = np.array([start.board_time_s for _, start in starts])
    host_s = np.array([start.host_time_s for _, start in starts])
    edges_s = [trace.pin(BUZZER_PINS[buzzer])[0] for buzzer, _ in starts]
    first_s = np.array([edges_s[0][0], edges_s[1][0], edges_s[2][0], edges_s[3][edges_s[3] > told_s[2]][0]])
    assert np.ptp(first_s - told_s) < 50e-6  # how exactly the firmware stamps is for its own tests to say
    assert host_s - host_s[0] == pytest.approx(first_s - first_s[0], abs=0.002)


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


def test_a_session_with_the_serial_board_calibrates(board, tmp_path):
    """Microphones and camera are simulated and hear and see, in real time, what the real firmware plays."""
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
            [BIN / command[0], *command[1:]], cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr
    with Session.open(tmp_path / "s1.h5") as session:
        emissions = session.emissions
        assert emissions["accepted"].sum() >= 20  # of 24; a starved simulated board may cost one
        host_s, board_s = emissions["host_time_s"], emissions["board_time_s"]
    assert np.all(np.diff(host_s) > 0.2)
    assert np.ptp(host_s) == pytest.approx(np.ptp(board_s), rel=0.05)
    result = yaml.safe_load((tmp_path / "s1.calib.yaml").read_text())
    assert result["evaluation"]["rmse_m"] < 0.003
    assert result["residual"]["robust_sigma_s"] < 1e-6
