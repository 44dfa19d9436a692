"""The guards of the firmware: what they do about faults that were built into it, on the simulated board."""

# ruff: noqa: T201 - figures for whoever runs `pytest -s`
import numpy as np
import pytest
from simboard import BUILD, BUZZER_PINS, LED_PIN, Talk, make, running_board

COMMAND = "1 play 1 tone 1000 400000"


@pytest.fixture(scope="module", autouse=True)
def _broken_firmware():
    make("broken")


def broken(fault: str):
    return running_board(BUILD / f"broken-{fault}.elf", fast=True)


def lit_s(board) -> list[float]:
    """Return how long the LED was on, each time; buzzers must be low afterwards."""
    trace = board.trace()
    for pin in BUZZER_PINS.values():
        assert trace.pin(pin)[1][-1:].sum() == 0, f"{pin} is still high"
    return np.diff(trace.pin(LED_PIN)[0])[::2].tolist()


def test_a_main_loop_that_hangs_is_reset_by_the_watchdog():
    with broken("hang") as board, Talk(board.port) as host:
        host.restart(board)
        host.send(COMMAND)
        boot = host.next_boot()
        assert boot["reset"] == "watchdog"
        assert host.ask("2 status")["state"] == "idle"
        board.settle()
        (sound_s,) = lit_s(board)
        assert board.trace().resets[-1][1] == "watchdog"
    print(f"silent {sound_s:.3f} s after the main loop hung")
    assert sound_s < 0.2


def test_a_firmware_that_hangs_with_interrupts_off_is_reset_by_the_watchdogs_hardware():
    with broken("freeze") as board, Talk(board.port) as host:
        host.restart(board)
        host.send(COMMAND)
        assert host.next_boot()["reset"] == "watchdog"
        assert host.ask("2 status")["state"] == "idle"
        assert host.ask("3 hello")["name"] == "buzzer-board"
        board.settle()
        (sound_s,) = lit_s(board)
        assert board.trace().resets[-1][1] == "watchdog"
    print(f"silent {sound_s:.3f} s after everything hung")
    assert 0.12 < sound_s < 0.3  # twice the watchdog's time


@pytest.mark.parametrize(
    ("fault", "name"),
    [("short_circuit", "pin"), ("lose_edges", "timer"), ("lose_end", "timer"), ("overflow_stack", "memory")],
)
def test_an_impossible_state_stops_the_sound_says_why_and_refuses_to_play(fault, name):
    with broken(fault) as board, Talk(board.port) as host:
        host.restart(board)
        host.ask(COMMAND)
        assert host.event("on")["seq"] == "1"
        assert host.event("off")["why"] == "fault"
        assert host.event("fault")["name"] == name
        assert host.ask("2 play 1 tone 1000 5000")["err"] == "fault"
        assert host.ask("3 test")["err"] == "test"
        assert host.ask("4 status")["state"] == "fault"
        assert host.ask("5 hello")["name"] == "buzzer-board"
        board.settle()
        (sound_s,) = lit_s(board)
    print(f"{fault}: silent after {sound_s:.4f} s")
    assert sound_s < 0.402


def test_a_reset_ends_a_fault():
    with broken("short_circuit") as board, Talk(board.port) as host:
        host.restart(board)
        host.ask(COMMAND)
        assert host.event("on")
        assert host.event("off")
        assert host.event("fault")
        assert host.restart(board)["reset"] == "external"
        assert host.ask("2 status")["state"] == "idle"


def test_no_sound_outlasts_the_limit_whatever_asked_for_it():
    with broken("overrun") as board, Talk(board.port) as host:  # its own code asks for two seconds
        host.restart(board)
        on, off = host.event("on"), host.event("off")
        assert off["why"] == "limit"
        assert int(off["us"]) - int(on["us"]) == 500_000
        board.settle()
        assert lit_s(board)[-1] == pytest.approx(0.5, abs=1e-4)


def test_what_is_stopped_before_its_first_edge_is_silent_and_not_told():
    with broken("cancel") as board, Talk(board.port) as host:  # its own code plays and stops at once
        host.restart(board)
        status = host.ask("1 status")
        assert (status["plays"], status["state"]) == ("1", "idle")
        board.settle(0.2)
        assert board.trace().pin(LED_PIN)[0].size == 0
        assert all(board.trace().pin(pin)[0].size == 0 for pin in BUZZER_PINS.values())
        host.play("2 play 1 tone 1000 5000")  # its events are the first ones
        assert host.ask("3 status")["plays"] == "2"


def test_a_reset_in_mid_emission_is_silent_at_once():
    with running_board(fast=True) as board, Talk(board.port) as host:
        host.restart(board)
        host.ask(COMMAND)
        host.event("on")
        assert host.restart(board)["reset"] == "external"
        board.settle()
        (sound_s,) = lit_s(board)
        assert sound_s < 0.4
        assert host.ask("2 status")["plays"] == "0"


def test_a_lap_of_the_timer_that_ends_while_other_flags_are_cleared_is_counted():
    with broken("clear_matches_at_lap") as board, Talk(board.port) as host:
        host.restart(board)
        on_us, _ = host.play(COMMAND)
        board.settle()
        trace = board.trace()
    first_edge_s = trace.pin(LED_PIN)[0][0] - trace.resets[-1][0]
    assert 0 < first_edge_s - 1e-6 * on_us < 0.005  # the clock begins when the firmware does; a lap is 0.033 s
