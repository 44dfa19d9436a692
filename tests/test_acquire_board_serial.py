"""The serial board against a board that makes every fault of the line."""

import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from scripted_board import HELLO, ScriptedBoard, framed

from acquire.devices.board_link import BoardLink
from acquire.devices.board_serial import SerialBoard
from acquire.errors import DeviceError, DeviceRestartedError, FirmwareError
from rigs.waveform import Waveform

SHORT = Waveform("sweep", 0.005, 1000.0, 8000.0)
LONG = Waveform("sweep", 0.4, 1000.0, 8000.0)


@pytest.fixture(autouse=True)
def short_waits(monkeypatch):
    monkeypatch.setattr("acquire.devices.board_link._TIMEOUT_S", 0.3)
    monkeypatch.setattr("acquire.devices.board_hello._TRY_S", 0.2)


@pytest.fixture
def scripted():
    with ScriptedBoard() as board:
        yield board


@pytest.fixture
def opened(scripted):
    board = SerialBoard(scripted.port, SHORT, [1, 6])
    board.open()
    yield board
    board.close()


def played(opened, scripted):
    """Play once, and see that the start that is told is the one of the board's last emission."""
    start = opened.play(1, SHORT)
    assert start.board_time_s == pytest.approx(1e-6 * scripted.started[-1])
    assert start.host_time_s == pytest.approx(scripted._start_s + start.board_time_s, abs=0.02)
    return start


def test_opening_names_the_firmware_and_silences_the_board(scripted):
    board = SerialBoard(scripted.port, SHORT, [1])
    assert board.open() == "buzzer-board 1.2.3 on uno"
    assert scripted.verbs()[:3] == ["hello", "stop", "status"]
    board.close()
    board.close()
    assert scripted.verbs()[-1] == "stop"


def test_an_emission_is_told_by_both_clocks(opened, scripted):
    first = played(opened, scripted)
    time.sleep(0.3)  # long beside how late a busy computer takes a reply
    second = played(opened, scripted)
    assert second.board_time_s > first.board_time_s
    assert opened.clock.rate == pytest.approx(1, abs=0.005)
    assert scripted.plays == 2


@pytest.mark.parametrize("fault", ["garbage", "old reply", "lose reply"])
def test_a_fault_of_the_line_costs_no_second_emission(opened, scripted, fault):
    scripted.faults["play"] = [fault]
    played(opened, scripted)
    assert scripted.plays == 1


@pytest.mark.parametrize("fault", ["lose command", "spoil command"])
def test_a_command_that_never_arrived_is_sent_again(opened, scripted, fault):
    scripted.faults["play"] = [fault]
    played(opened, scripted)
    assert scripted.plays == 1
    assert scripted.verbs().count("play") == 2


def test_a_lost_reply_is_looked_into_before_playing_again(opened, scripted):
    scripted.faults["play"] = ["lose all"]
    played(opened, scripted)
    verbs = scripted.verbs()
    assert verbs[verbs.index("play") :] == ["play", "status", "play"]
    assert scripted.plays == 2  # the first began nobody knows when, so another was needed
    assert scripted.started[1] - scripted.started[0] > 500_000  # the room has rung out


@pytest.mark.parametrize("fault", ["lose reply", "spoil reply", "spoil command", "garbage", "old reply"])
def test_a_ping_is_asked_again(opened, scripted, fault):
    scripted.faults["ping"] = [fault]
    played(opened, scripted)


def test_a_command_that_never_gets_through_ends_with_one_clear_line(opened, scripted):
    scripted.faults["play"] = ["spoil command"] * 3
    with pytest.raises(DeviceError, match=r"did not take `play`, 3 times: check its cable"):
        opened.play(1, SHORT)
    assert scripted.plays == 0


def test_a_board_that_falls_mute_is_named(opened, scripted):
    scripted.faults["play"] = ["mute"]
    with pytest.raises(DeviceError, match=r"did not answer `status` within 0.3 s"):
        opened.play(1, SHORT)


def test_a_board_that_restarted_between_emissions_says_so_and_is_opened_again(opened, scripted):
    played(opened, scripted)
    scripted.restart()
    with pytest.raises(DeviceRestartedError, match=r"restarted \(reset=brownout\): check its cable and its power"):
        opened.play(1, SHORT)
    with pytest.raises(DeviceError, match="not open"):
        opened.play(1, SHORT)
    opened.open()
    assert played(opened, scripted).board_time_s < 3


@pytest.mark.parametrize("verb", ["hello", "stop", "status", "ping", "play"])
def test_a_late_reply_to_an_earlier_link_is_not_taken_for_ours(opened, scripted, verb):
    scripted.faults["play"], scripted.late_for = ["late reply"], verb
    with pytest.raises(DeviceRestartedError):
        opened.play(1, SHORT)
    opened.open()
    played(opened, scripted)
    assert scripted.plays == 1
    assert scripted.verbs().count("play") == 2


def test_a_reply_that_came_while_the_host_stood_still_is_read(opened, scripted, monkeypatch):
    sent = BoardLink._send

    def stand_still_after(link, line):
        sent(link, line)
        time.sleep(0.4)  # longer than the host waits

    monkeypatch.setattr("acquire.devices.board_link.BoardLink._send", stand_still_after)
    n_commands = len(scripted.commands)
    played(opened, scripted)
    assert scripted.verbs()[n_commands:] == ["ping", "play"]


def test_no_number_is_used_on_two_links(scripted, monkeypatch):
    monkeypatch.setattr("time.monotonic_ns", lambda: 7_000_000_000)  # links that number by the clock would clash
    for _ in range(3):
        board = SerialBoard(scripted.port, SHORT, [1])
        board.open()
        board.close()
    numbers = [command.split(" ")[0] for command in scripted.commands]
    assert len(set(numbers)) == len(numbers) > 30


@pytest.mark.parametrize("fault", ["restart", "unlucky restart"])
def test_a_board_that_restarts_on_play_says_so(opened, scripted, fault):
    scripted.faults["play"] = [fault]
    with pytest.raises(DeviceRestartedError):
        opened.play(1, SHORT)
    assert scripted.plays == 0


def test_a_board_that_restarts_while_it_sounds_says_so_when_its_clock_is_read(opened, scripted):
    played(opened, scripted)
    scripted.restart()
    with pytest.raises(DeviceRestartedError):
        opened.read_clock()


def test_readings_of_the_clock_are_given_once(opened, scripted):
    assert len(opened.read_clock()) == 9  # eight of the opening
    played(opened, scripted)
    first, second = opened.read_clock()
    assert first.earliest_s < first.latest_s < second.latest_s
    assert first.board_s < scripted.started[-1] * 1e-6 < second.board_s


def test_a_board_that_is_pulled_out_is_named(tmp_path):
    port = tmp_path / "ttyACM0"  # a name of its own: another test's board may be given the number of the one pulled out
    with ScriptedBoard() as scripted:
        port.symlink_to(scripted.port)
        board = SerialBoard(str(port), SHORT, [1])
        board.open()
    port.unlink()
    with pytest.raises(DeviceError, match=r"the board is gone"):
        board.play(1, SHORT)
    with pytest.raises(DeviceError, match="there is no such port"):
        board.open()
    board.close()


def test_a_busy_board_is_not_disturbed(opened, scripted):
    opened.play(1, LONG)
    with pytest.raises(DeviceError, match=r"busy, cannot play buzzer 6 yet; wait until the last sound ends"):
        opened.play(6, LONG)
    assert scripted.plays == 1


def test_a_sound_that_outlasts_its_time_on_the_host_is_waited_for(opened, scripted):
    scripted.play_lag_s = 0.3  # the board stood still, or its clock is slow
    played(opened, scripted)
    time.sleep(0.1)
    played(opened, scripted)
    assert scripted.plays == 2
    assert scripted.started[1] - scripted.started[0] > 300_000
    assert scripted.verbs().count("play") == 3


def test_a_board_that_never_falls_silent_is_given_up(opened, scripted, monkeypatch):
    monkeypatch.setattr("acquire.devices.board_serial._OVERDUE_S", 0.05)
    scripted.play_lag_s = 60.0
    played(opened, scripted)
    time.sleep(0.1)
    with pytest.raises(DeviceError, match=r"did not take `play`, 3 times"):
        opened.play(1, SHORT)


def test_noise_before_the_command_costs_no_second_emission(opened, scripted):
    scripted.faults["play"] = ["noise before"]
    played(opened, scripted)
    assert scripted.plays == 1
    assert scripted.verbs().count("play") == 1


def test_a_board_that_stopped_itself_says_why(opened, scripted):
    scripted.say(framed("! fault code=2 name=pin"))
    scripted.faults["play"] = ["fault"]
    with pytest.raises(DeviceError, match=r"has stopped itself \(fault pin\): check its wiring"):
        opened.play(1, SHORT)


def test_a_board_in_fault_is_not_opened(scripted):
    scripted.state = "fault"
    with pytest.raises(DeviceError, match="has stopped itself"):
        SerialBoard(scripted.port, SHORT, [1]).open()


def test_a_later_boot_banner_only_delays_the_hello(scripted):
    scripted.faults["hello"] = ["restart"]
    board = SerialBoard(scripted.port, SHORT, [1])
    assert board.open().startswith("buzzer-board")
    board.close()


@pytest.mark.parametrize(
    ("hello", "problem"),
    [
        (HELLO.replace("proto=1", "proto=2"), "buzzer-board 1.2.3 speaks protocol 2, this program protocol 1"),
        (HELLO.replace("buzzer-board", "grbl"), "the firmware there is grbl, not buzzer-board"),
        (HELLO.replace("max_us=500000 ", ""), "the board's reply has no number max_us"),
    ],
)
def test_a_firmware_that_does_not_fit_is_refused_with_the_command_to_run(hello, problem):
    with ScriptedBoard(hello=hello) as scripted, pytest.raises(FirmwareError) as refusal:
        SerialBoard(scripted.port, SHORT, [1]).open()
    assert problem in str(refusal.value)
    assert f"rig-flash --port {scripted.port}" in str(refusal.value)
    assert refusal.value.exit_code == 4
    assert scripted.verbs() == ["hello"]


def test_another_program_on_the_board_is_a_firmware_error():
    with (
        ScriptedBoard(raw=b"Hello, I blink\r\n") as scripted,
        pytest.raises(FirmwareError, match=r"not the firmware buzzer-board: put ours on it: rig-flash --port"),
    ):
        SerialBoard(scripted.port, SHORT, [1]).open()


def test_a_board_that_only_answers_what_was_asked_long_before_is_no_other_firmware():
    late = framed("1 ok us=42")
    with ScriptedBoard(raw=late) as scripted, pytest.raises(DeviceError, match="the board answers too late"):
        SerialBoard(scripted.port, SHORT, [1]).open()


def test_a_board_can_be_let_go_while_another_thread_waits_for_it(scripted, monkeypatch):
    monkeypatch.setattr("acquire.devices.board_link._TIMEOUT_S", 20.0)
    board = SerialBoard(scripted.port, SHORT, [1])
    board.open()
    scripted.faults["ping"] = ["lose command"]
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(board.read_clock)
        while scripted.faults["ping"]:
            time.sleep(0.001)
        board.close()
        assert isinstance(waiting.exception(), DeviceError)
    assert scripted.verbs()[-2:] == ["ping", "stop"]


def test_a_board_that_says_nothing_is_a_device_error():
    with (
        ScriptedBoard(raw=b"") as scripted,
        pytest.raises(DeviceError, match=r"no answer; is this the buzzer board\? .* rig-flash --port"),
    ):
        SerialBoard(scripted.port, SHORT, [1]).open()


@pytest.mark.parametrize(
    ("waveform", "buzzers", "problem"),
    [
        (SHORT, [1, 7], "there is no buzzer 7; this board has 1 to 6"),
        (Waveform("sweep", 0.6, 1000.0, 8000.0), [1], "600000 us long, only 5000 to 500000 us"),
        (Waveform("sweep", 0.1, 1000.0, 21000.0), [1], "at 21000 Hz, only whole numbers of 50 to 20000 Hz"),
        (Waveform("tone", 0.1, 440.5, 440.5), [1], "at 440.5 Hz, only whole numbers"),
        (Waveform("mls", 1023 / 40000, 0.0, 20000.0, 10, 40000.0), [1], "at 40000 Hz, only whole numbers of 1000"),
    ],
)
def test_what_the_board_cannot_play_is_refused_before_anything_sounds(scripted, waveform, buzzers, problem):
    with pytest.raises(DeviceError, match=problem):
        SerialBoard(scripted.port, waveform, buzzers).open()
    assert scripted.verbs() == ["hello"]


def test_a_buzzer_that_is_not_there_and_a_board_that_is_not_open(opened, scripted):
    for buzzer in (0, 7):
        with pytest.raises(DeviceError, match=f"there is no buzzer {buzzer}; this board has 1 to 6"):
            opened.play(buzzer, SHORT)
    with pytest.raises(DeviceError, match="not open; open it first"):
        SerialBoard(scripted.port, SHORT, [1]).play(1, SHORT)
    assert scripted.plays == 0


def test_two_hosts_cannot_share_a_board(opened, scripted):
    with pytest.raises(DeviceError, match=r"another program uses this port: close serial monitors .* ModemManager"):
        SerialBoard(scripted.port, SHORT, [1]).open()
    played(opened, scripted)


def test_a_port_held_by_another_process_is_busy(scripted):
    holder = f"import serial; port = serial.Serial({scripted.port!r}, exclusive=True); print(1, flush=True); input()"
    with subprocess.Popen([sys.executable, "-c", holder], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        with pytest.raises(DeviceError, match="another program uses this port"):
            SerialBoard(scripted.port, SHORT, [1]).open()
        process.stdin.write(b"\n")
        process.stdin.flush()
    board = SerialBoard(scripted.port, SHORT, [1])
    board.open()
    board.close()


def test_a_port_without_permission_names_the_group(scripted):
    Path(scripted.port).chmod(0)
    root = os.geteuid() == 0
    try:
        if root:
            os.seteuid(65534)
        with pytest.raises(DeviceError, match=r"no permission to use this port: run `sudo usermod -a -G dialout"):
            SerialBoard(scripted.port, SHORT, [1]).open()
    finally:
        if root:
            os.seteuid(0)


def test_pings_do_not_stop_the_host_from_seeing_time_pass(opened, scripted):
    for _ in range(5):
        played(opened, scripted)
        time.sleep(0.02)
    residuals_s = abs(opened.clock.residuals_s())
    assert len(residuals_s) == 13
    assert sorted(residuals_s)[6] < 0.002
