"""What every trigger board must do, whether simulated or at a serial port."""

from contextlib import ExitStack

import pytest
from scripted_board import ScriptedBoard
from simboard import running_board
from simulated import make_description

from acquire.clock import MonotonicClock
from acquire.devices.board_serial import SerialBoard
from acquire.devices.choose import choose_devices
from acquire.errors import DeviceError
from rigs.waveform import Waveform

SOUND = Waveform("sweep", 0.1, 1000.0, 8000.0)
BUZZERS = [buzzer.id for buzzer in make_description().board.buzzers]


@pytest.fixture(params=["simulated", "serial", "serial heard by the simulated room", "scripted"])
def trigger_and_clock(request):
    """Return a trigger board, not yet opened, and the clock that its host times are of."""
    with ExitStack() as stack:
        if request.param == "simulated":
            rig = choose_devices(make_description())
            yield rig.trigger, rig.clock
        elif request.param == "scripted":
            yield SerialBoard(stack.enter_context(ScriptedBoard()).port, SOUND, BUZZERS), MonotonicClock()
        else:
            port = stack.enter_context(running_board()).port
            rig = choose_devices(make_description(trigger={"driver": "serial", "port": port}))
            trigger = rig.trigger if "heard" in request.param else SerialBoard(port, SOUND, BUZZERS)
            stack.callback(trigger.close)
            yield trigger, rig.clock


@pytest.fixture
def opened(trigger_and_clock):
    trigger, clock = trigger_and_clock
    trigger.open()
    yield trigger, clock
    trigger.close()


def test_it_names_its_firmware_and_version(trigger_and_clock):
    trigger, _ = trigger_and_clock
    name, version, *_ = trigger.open().split(" ")
    trigger.close()
    trigger.close()
    assert name
    assert version[0].isdecimal()


def test_an_emission_is_told_by_both_clocks(opened):
    trigger, clock = opened
    starts = []
    for buzzer in BUZZERS[:2]:
        before_s = clock.now_s()
        starts.append(trigger.play(buzzer, SOUND))
        assert before_s - 0.01 < starts[-1].host_time_s < clock.now_s() + 0.01
        clock.sleep_s(0.2)
    first, second = starts
    board_s, host_s = (second.board_time_s - first.board_time_s, second.host_time_s - first.host_time_s)
    assert board_s == pytest.approx(host_s, abs=0.01)
    assert host_s > 0.19


def test_a_board_that_sounds_refuses_the_next_sound(opened):
    trigger, _ = opened
    trigger.play(BUZZERS[0], SOUND)
    with pytest.raises(DeviceError, match=f"busy, cannot play buzzer {BUZZERS[1]} yet; wait until the last sound ends"):
        trigger.play(BUZZERS[1], SOUND)


def test_a_buzzer_that_is_not_there_is_named(opened):
    with pytest.raises(DeviceError, match="there is no buzzer 99; this board has"):
        opened[0].play(99, SOUND)


def test_a_board_that_is_not_open_says_so(opened):
    trigger, _ = opened
    trigger.close()
    with pytest.raises(DeviceError, match="not open; open it first"):
        trigger.play(BUZZERS[0], SOUND)
