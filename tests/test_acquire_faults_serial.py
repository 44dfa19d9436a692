"""What a capture does when the real firmware's board is unplugged, reset, or comes back as something else."""

import os
from contextlib import ExitStack

import numpy as np
import pytest
from capturing import SMALL, Listener, small_rig
from scripted_board import HELLO, ScriptedBoard
from simboard import running_board

from acquire.capture import capture
from acquire.errors import FirmwareError
from rigs.session.reader import Session

BUZZERS = [buzzer | {"id": number} for number, buzzer in enumerate(SMALL["board"]["buzzers"], start=1)]


class Bench(Listener):
    """A port under a lasting name, and hands that do something to its board when the capture says a line."""

    def __init__(self, path):
        super().__init__()
        self.path, self.stack, self.board, self.deeds = path, ExitStack(), None, {}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stack.close()

    def plug_in(self, board=None):
        self.board = self.stack.enter_context(board or running_board())
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(self.board.port)

    def unplug(self):
        self.stack.close()
        self.path.unlink()

    def say(self, message):
        super().say(message)
        for beginning in [text for text in self.deeds if text in message.text]:
            self.deeds.pop(beginning)()


@pytest.fixture
def bench(tmp_path):
    with Bench(tmp_path / "port") as bench:
        bench.plug_in()
        yield bench


def capture_on(bench, path, *, device_wait_s=30, **options):
    found = small_rig(
        trigger={"driver": "serial", "port": os.fspath(bench.path)},
        board={"buzzers": BUZZERS},
        capture={"still_s": 0.2, "poses": 2, "device_wait_s": device_wait_s},
        simulation={"faults": []},
    )
    capture(found, path, screen=bench, **options)


def accepted(session):
    return session.emissions[session.emissions["accepted"] == 1]


def test_a_board_that_is_unplugged_and_plugged_in_again_costs_a_pose(bench, tmp_path):
    bench.deeds = {"pose 1 of 2 is good": bench.unplug, "waiting for the trigger board": bench.plug_in}
    capture_on(bench, tmp_path / "s.h5")
    assert "the board is gone" in bench.warnings()
    with Session.open(tmp_path / "s.h5") as session:
        assert session.complete
        assert session.poses["accepted"].tolist()[:2] == [1, 0]
        assert session.poses["accepted"].sum() == 2
        assert any(b"the trigger board is there again (buzzer-board" in text for text in session.log["text"])
        assert np.diff(session.pings["board_time_s"]).min() < 0


def test_a_board_that_is_reset_fires_again_in_the_same_pose(bench, tmp_path):
    bench.deeds = {"pose 1 of 2 is good": bench.board.reset}
    capture_on(bench, tmp_path / "s.h5")
    assert "the board restarted (reset=" in bench.warnings()
    with Session.open(tmp_path / "s.h5") as session:
        assert session.poses["accepted"].sum() == 2
        boards_s = accepted(session)["board_time_s"]
        assert np.diff(boards_s).min() < 0


def test_another_firmware_after_a_reconnection_ends_the_session_with_exit_code_4(bench, tmp_path):
    other = ScriptedBoard(hello=HELLO.replace("buzzer-board", "grbl"))
    bench.deeds = {
        "pose 1 of 2 is good": bench.unplug,
        "waiting for the trigger board": lambda: bench.plug_in(other),
    }
    with pytest.raises(FirmwareError, match=r"the firmware there is grbl, not buzzer-board: .*; 1 pose saved") as end:
        capture_on(bench, tmp_path / "s.h5")
    assert end.value.exit_code == 4
    with Session.open(tmp_path / "s.h5") as session:
        assert session.complete


def test_a_board_that_answers_late_and_in_pieces_is_waited_for(bench, tmp_path, monkeypatch):
    monkeypatch.setattr("acquire.devices.board_hello._TRY_S", 0.1)
    babbler = ScriptedBoard(raw=b"123 ok us=42*")
    bench.deeds = {
        "pose 1 of 2 is good": bench.unplug,
        "waiting for the trigger board": lambda: bench.plug_in(babbler),
    }
    late = {"n": 0}

    def look(status):
        Bench.show(bench, status)
        late["n"] += status.state.value == "reconnecting"
        if late["n"] == 60:
            bench.unplug()
            bench.plug_in()

    bench.show = look
    capture_on(bench, tmp_path / "s.h5")
    with Session.open(tmp_path / "s.h5") as session:
        assert session.poses["accepted"].sum() == 2


def test_what_never_makes_sense_ends_the_session_with_exit_code_4_when_the_wait_is_over(bench, tmp_path, monkeypatch):
    monkeypatch.setattr("acquire.devices.board_hello._TRY_S", 0.1)
    babbler = ScriptedBoard(raw=b"grbl 1.1h")
    bench.deeds = {
        "pose 1 of 2 is good": bench.unplug,
        "waiting for the trigger board": lambda: bench.plug_in(babbler),
    }
    with pytest.raises(
        FirmwareError, match=r"not come back within 1 s.*is not the firmware buzzer-board.*1 pose saved"
    ):
        capture_on(bench, tmp_path / "s.h5", device_wait_s=1)
