"""The protocol, spoken with the real firmware on the simulated board: golden frames, and whatever may go wrong."""

# ruff: noqa: T201 - figures for whoever runs `pytest -s`
import re

import numpy as np
import pytest
from simboard import BUZZER_PINS, FIRMWARE, LED_PIN, Talk, running_board, values, with_checksum

LIMIT_S = 0.5


def golden_blocks() -> list[list[str]]:
    text = (FIRMWARE / "frames.txt").read_text()
    blocks = [[line for line in block.splitlines() if line[0] in "<>"] for block in text.split("\n\n")]
    return [block for block in blocks if block]


def pattern(frame: str) -> str:
    """Return a regular expression for what the board says: `#` is a number, `??` a checksum."""
    return re.escape(frame).replace(r"\#", r"\d+").replace(r"\?\?", "[0-9A-F]{2}")


def sent(frame: str) -> bytes:
    return frame.encode().decode("unicode_escape").encode("latin-1") + b"\n"


@pytest.fixture
def board():
    with running_board(fast=True) as board:
        yield board


@pytest.fixture
def host(board):
    with Talk(board.port) as host:
        host.restart(board)
        yield host


def test_the_golden_frames_are_answered_as_written():
    with running_board() as board, Talk(board.port) as host:
        host.restart(board)
        for block in golden_blocks():
            for frame in block:
                if frame[0] == ">":
                    host.serial.write(sent(frame[2:]))
                else:
                    line = with_checksum(host.line())
                    assert re.fullmatch(pattern(frame[2:]), line), f"{line} is not {frame[2:]}"
    assert sum(len(block) for block in golden_blocks()) > 100


def is_well(host: Talk) -> bool:
    host.serial.reset_input_buffer()
    host.serial.write(b"*\n")  # ends whatever half a line is left, and is answered
    while not (line := host.serial.readline()).startswith(b"0 err "):
        assert line, "the board does not answer"
    return host.ask("7 hello")["name"] == "buzzer-board" and host.ask("8 test").get("pass") == "1"


def wait_until_it_keeps_up(host: Talk) -> None:
    """Repeat a ping until it is answered: lines are lost while replies take longer than what they reply to."""
    host.serial.timeout = 1
    for _ in range(30):
        host.serial.write(b"*\n")
        host.send("9 ping")
        if any(line.startswith(b"9 ok us=") for line in iter(host.serial.readline, b"")):
            break
    host.serial.timeout = 20


def longest_sound_s(board) -> float:
    """Return how long the LED was on at most, after a check that it was on whenever a buzzer sounded."""
    trace = board.trace()
    on_s, levels = trace.pin(LED_PIN)
    assert list(levels) == [1, 0] * (len(levels) // 2), "the LED is still on"
    for pin in BUZZER_PINS.values():
        times_s, _ = trace.pin(pin)
        inside = (
            np.searchsorted(on_s, times_s + 2e-6) % 2 == 1
        )  # the LED follows the first edge by a microsecond or two
        assert inside.all(), f"{pin} sounded while the LED was off"
    return float(np.diff(on_s)[::2].max(initial=0))


def test_nothing_sounds_before_a_command(board, host):
    assert is_well(host)
    assert board.trace().pin(LED_PIN)[0].size == 0
    assert all(board.trace().pin(pin)[0].size == 0 for pin in BUZZER_PINS.values())


def test_a_thousand_emissions_in_a_row_lose_no_reply(board, host):
    lengths_us = []
    for number in range(1000):
        buzzer = number % 6 + 1
        assert "on_us" in host.ask(f"{number} play {buzzer} sweep 2000 6000 5000")
        on, off = host.event("on"), host.event("off")
        assert (on["buzzer"], on["seq"]) == (off["buzzer"], off["seq"]) == (str(buzzer), str(number))
        assert off["why"] == "done"
        lengths_us.append((int(off["us"]) - int(on["us"])) % 2**32)
    assert set(lengths_us) == {5000}
    status = host.ask("1000 status")
    assert (status["plays"], status["errors"], status["state"]) == ("1000", "0", "idle")
    board.settle()
    assert longest_sound_s(board) < 0.0051
    assert len(board.trace().pin(LED_PIN)[0]) == 2000


def test_a_play_during_an_emission_is_refused_and_does_not_disturb_it(host):
    quiet_us = np.diff(host.play("1 play 2 tone 3000 100000"))
    host.ask("2 play 2 tone 3000 100000")
    host.event("on")
    for verb in ("play 3 tone 1000 5000", "play 2 mls 7 16000", "hello", "ping", "status", "test", "nonsense"):
        reply = host.ask(f"3 {verb}")
        assert ("play" in verb) == (reply.get("err") == "busy")
    assert host.event("off")["why"] == "done"
    assert quiet_us == 100000


@pytest.mark.parametrize("wave", ["tone 1000 5000", "sweep 1000 8000 100000", "mls 10 16000"])
def test_the_first_edge_follows_within_a_few_milliseconds(host, wave):
    play = with_checksum(f"2 play 1 {wave}") + "\n"  # right behind a ping that tells when it begins
    host.serial.write(f"{with_checksum('1 ping')}\n{play}".encode())
    line_feed_us = int(values(host.line())["us"]) + 10e6 / 115200 * len(play)
    lead_us = int(values(host.line())["on_us"]) - line_feed_us
    print(f"{wave}: first edge {lead_us:.0f} us after the line feed")
    assert 2000 < lead_us < 5000


def test_a_ping_is_timed_by_its_own_end_whether_lf_or_cr(host):
    times_us = []
    for end in (b"\n", b"\r", b"\r", b"\r\n", b"\n"):
        host.serial.write(b"1 ping" + end)
        times_us.append(int(values(host.line())["us"]))
    assert all(np.diff(times_us) > 500), times_us  # six bytes take that long to come in


def test_stop_ends_the_sound_at_once(board, host):
    host.ask("1 play 4 tone 1000 500000")
    on_us = int(host.event("on")["us"])
    assert host.ask("2 stop")["was"] == "4"
    off = host.event("off")
    assert off["why"] == "stop"
    assert int(off["us"]) - on_us < 400_000
    assert host.ask("3 status")["state"] == "idle"
    board.settle()
    assert longest_sound_s(board) == pytest.approx((int(off["us"]) - on_us) * 1e-6, abs=1e-4)


def test_a_stop_right_behind_a_play_ends_it_within_milliseconds(board, host):
    host.serial.write(b"1 play 1 tone 1000 500000\n2 stop\n")
    assert host.line().startswith("1 ok on_us=")
    on_us = int(host.event("on")["us"])
    assert host.line() == "2 ok was=1"
    off = host.event("off")
    assert off["why"] == "stop"
    board.settle()
    assert int(off["us"]) - on_us < 5000
    assert longest_sound_s(board) == pytest.approx((int(off["us"]) - on_us) * 1e-6, abs=1e-4)


def test_a_host_that_dies_in_mid_emission_leaves_no_sound_behind(board, host):
    host.send("1 play 6 sweep 1000 8000 500000")
    host.serial.close()
    board.settle(1.0)
    assert longest_sound_s(board) == pytest.approx(LIMIT_S, abs=1e-4)
    with Talk(board.port) as next_host:
        assert is_well(next_host)
        assert next_host.ask("1 status")["plays"] == "1"


def test_half_a_line_of_a_dead_host_is_not_played(board, host):
    host.serial.write(b"1 play 1 tone 1000 500000*")
    host.serial.close()
    with Talk(board.port) as next_host:
        assert is_well(next_host)
        assert next_host.ask("1 status")["plays"] == "0"


def test_two_hosts_may_talk_at_once_and_nothing_breaks(board, host):
    with Talk(board.port) as other:
        for number in range(50):
            host.send(f"{number} ping")
            other.send(f"{number + 100} status")
        host.serial.timeout = 0.3
        assert host.serial.read(1_000_000), "nobody was answered"
        host.serial.timeout = 20
    assert is_well(host)
    assert host.ask("9 status")["plays"] == "0"


@pytest.mark.parametrize("seed", [1, 2])
def test_a_hundred_thousand_bytes_of_noise_play_nothing_they_did_not_ask_for(board, host, seed):
    generator = np.random.default_rng(seed)
    golden = [sent(frame[2:]) for block in golden_blocks() for frame in block if frame[0] == ">"]
    n_sent = 0
    while n_sent < 100_000:
        noise = bytearray(golden[generator.integers(len(golden))] * int(generator.integers(1, 4)))
        for place in generator.integers(len(noise), size=generator.integers(1, 5)):
            noise[place] = generator.integers(256)
        if generator.random() < 0.2:
            noise = bytearray(generator.integers(256, size=200, dtype=np.uint8).tobytes())
        host.serial.write(noise)
        n_sent += len(noise)
        host.serial.read(host.serial.in_waiting)
    wait_until_it_keeps_up(host)
    board.settle(1.0)
    assert is_well(host)
    plays = int(host.ask("9 status")["plays"])
    board.settle()
    longest_s = longest_sound_s(board)
    n_sounds = len(board.trace().pin(LED_PIN)[0]) // 2
    print(f"{n_sent} bytes, {plays} emissions, the longest {longest_s:.4f} s")
    assert n_sounds <= plays
    assert longest_s <= LIMIT_S + 1e-4
