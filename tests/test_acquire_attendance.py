"""What a capture does while a device does not answer: it stores sound, shows that it lives, and can be ended."""

import os
import signal
import time

import pytest
from test_acquire_faults_serial import Bench, capture_on

from acquire.attendance import Attendance
from acquire.clock import MonotonicClock
from acquire.errors import DeviceLostError, InterruptedCaptureError
from acquire.status import Status
from rigs.session.reader import Session


class Held(Bench):
    """A bench whose board stands still from its first emission on, until the capture has given up on it once."""

    def __init__(self, path):
        super().__init__(path)
        self.held_s, self.advice, self.n_samples = None, [], []

    def hold(self):
        os.kill(self.board.pid, signal.SIGSTOP)
        self.held_s = time.monotonic()

    def let_go(self):
        os.kill(self.board.pid, signal.SIGCONT)

    def show(self, status):
        super().show(status)
        if self.held_s is None and status.state.value == "firing":
            self.hold()
        elif status.state.value == "firing":
            self.advice.append(status.advice)


@pytest.fixture
def held(tmp_path):
    with Held(tmp_path / "port") as bench:
        bench.plug_in()
        yield bench
        bench.let_go()


def test_sound_is_stored_and_the_screen_alive_while_the_board_does_not_answer(held, tmp_path):
    held.deeds = {"waiting for the trigger board": held.let_go}
    capture_on(held, tmp_path / "s.h5")
    assert held.advice.count("waiting for the trigger board") > 5
    assert "had to wait" not in held.warnings()
    with Session.open(tmp_path / "s.h5") as session:
        assert session.poses["accepted"].sum() == 2
        assert not session.audio_blocks["flags"].any()


def test_a_wish_to_end_is_heard_while_the_board_does_not_answer(held, tmp_path):
    wants = lambda: "waiting for the trigger board" in held.advice  # noqa: E731
    with pytest.raises(InterruptedCaptureError):
        capture_on(held, tmp_path / "s.h5", stop_wanted=wants)
    assert "reconnecting" not in held.states
    with Session.open(tmp_path / "s.h5") as session:
        assert session.complete


def test_the_loss_of_another_device_waits_and_the_other_duties_go_on():
    done, status = [], Status("r", "s", (1,), 1, 1)

    def lose():
        raise DeviceLostError("gone", "audio")

    attendance = Attendance(status, MonotonicClock(), "trigger", [lose, lambda: done.append(1)])
    with attendance:
        attendance.glance()
        attendance.glance()
    assert done == [1, 1]
    with pytest.raises(DeviceLostError, match="gone"):
        attendance.check()


def test_what_raises_in_another_thread_is_raised_and_a_call_that_hangs_is_left_behind():
    def fail():
        raise DeviceLostError("gone", "trigger")

    def stop():
        raise InterruptedCaptureError("stopped")

    clock = MonotonicClock()
    with pytest.raises(DeviceLostError, match="gone"):
        clock.wait_for(fail, stop)
    with pytest.raises(InterruptedCaptureError):
        clock.wait_for(lambda: time.sleep(30), stop)
