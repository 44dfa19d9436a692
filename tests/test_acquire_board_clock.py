"""The board's clock on the host's: offset, drift, late replies, and the wrap after 71.6 minutes."""

import numpy as np
import pytest

from acquire.devices.board_clock import WRAP_US, BoardClock

START_S = 5000.0


def pinged(clock, times_s, *, rate=1.0, zero_s=START_S, late_s=0.0, jitter_s=0.0, seed=0):
    """Ping a board whose clock read zero at `zero_s`; some replies are `late_s` late."""
    rng = np.random.default_rng(seed)
    for number, host_s in enumerate(times_s):
        held_up_s = late_s if number % 3 == 1 else 0.0
        before_s, after_s = 0.001 + jitter_s * rng.random(2)
        board_us = round(1e6 * rate * (host_s - zero_s)) % WRAP_US
        clock.add(host_s - before_s, host_s + after_s + held_up_s, board_us)
    return clock


def test_one_ping_gives_the_offset():
    clock = pinged(BoardClock(), [START_S + 2.0])
    assert clock.host_s(2.5) == pytest.approx(START_S + 2.5, abs=1e-5)
    assert clock.rate == 1


@pytest.mark.parametrize("rate", [0.996, 1.0, 1.00005, 1.004])
def test_drift_is_found(rate):
    clock = pinged(BoardClock(), START_S + np.linspace(1, 60, 40), rate=rate, jitter_s=0.0002)
    assert clock.rate == pytest.approx(rate, abs=5e-6)
    assert clock.host_s(rate * 61.0) == pytest.approx(START_S + 61.0, abs=2e-4)


def test_a_burst_of_pings_says_nothing_of_drift():
    clock = pinged(BoardClock(), START_S + 1 + 0.004 * np.arange(8), jitter_s=0.0005)
    assert clock.rate == pytest.approx(1, abs=0.005)
    assert clock.host_s(1.1) == pytest.approx(START_S + 1.1, abs=5e-4)


def test_late_replies_do_not_count():
    clock = pinged(BoardClock(), START_S + np.linspace(1, 30, 30), rate=1.00004, late_s=0.08)
    assert clock.host_s(1.00004 * 31) == pytest.approx(START_S + 31, abs=1e-4)
    assert np.median(np.abs(clock.residuals_s())) < 1e-4
    assert clock.residuals_s().max() > 0.03


def test_one_reply_that_seems_too_quick_does_not_silence_the_others():
    clock = pinged(BoardClock(), START_S + np.linspace(1, 30, 30), rate=1.0003)
    clock.add(START_S + 30.4999, START_S + 30.5, round(1.0003e6 * 30.5 + 300))
    assert clock.rate == pytest.approx(1.0003, abs=1e-5)


@pytest.mark.parametrize("jump_s", [-0.4, 0.02, 60.0])
def test_after_a_jump_only_the_new_pings_count(jump_s):
    clock = pinged(BoardClock(), START_S + np.linspace(1, 30, 30))
    pinged(clock, [START_S + 31.0], zero_s=START_S + jump_s)
    assert clock.host_s(31.01 - jump_s) == pytest.approx(START_S + 31.01, abs=1e-3)
    assert len(clock.residuals_s()) == 1


def test_a_late_reply_is_no_jump():
    clock = pinged(BoardClock(), START_S + np.linspace(1, 30, 30))
    clock.add(START_S + 30.999, START_S + 31.8, 31_000_000)
    assert len(clock.residuals_s()) == 31
    assert clock.host_s(31.0) == pytest.approx(START_S + 31.0, abs=2e-4)


def test_the_wrap_is_unrolled():
    clock = BoardClock()
    for minute in range(0, 200, 10):
        pinged(clock, [START_S + 60 * minute], rate=1.001)
    board_s = clock.board_s(round(1.001e6 * 12060) % WRAP_US, START_S + 12060)
    assert board_s == pytest.approx(1.001 * 12060, abs=1e-5)
    assert clock.host_s(board_s) == pytest.approx(START_S + 12060, abs=1e-3)


def test_pauses_longer_than_a_wrap_are_bridged():
    clock = pinged(BoardClock(), [START_S + 1, START_S + 2 + 3 * 4294.967296])
    board_s = clock.board_s(5_000_000, START_S + 3 * 4294.967296 + 5.001)
    assert board_s == pytest.approx(3 * 4294.967296 + 5)


def test_times_just_before_the_wrap_stay_before_it():
    clock = pinged(BoardClock(), START_S + 4294.0 + np.arange(3) / 2)
    assert clock.board_s(WRAP_US - 1, START_S + 4294.9) == pytest.approx(4294.967295)
    assert clock.board_s(1, START_S + 4295.0) == pytest.approx(4294.967297)


@pytest.mark.parametrize("rate", [1.0, 1.003])
def test_the_stated_uncertainty_holds_the_true_time(rate):
    """Replies are held up more than commands, always; no number of pings shows it, so the statement allows for it."""
    clock = BoardClock()
    for host_s in START_S + np.linspace(1, 60, 60):
        clock.add(host_s - 0.0005, host_s + 0.003, round(1e6 * rate * (host_s - START_S)))
    fit = clock.fit()
    error_s = clock.host_s(rate * 30) - (START_S + 30)
    assert 0.0003 < abs(error_s) < 3 * fit.std_s < 0.005
    assert abs(fit.rate - rate) < 4 * fit.rate_std < 1e-4
    assert (fit.since_s, fit.n_readings) == (pytest.approx(START_S + 1, abs=0.01), 60)


def test_an_unknown_clock_is_not_guessed():
    with pytest.raises(RuntimeError, match="before the first ping"):
        BoardClock().host_s(1.0)
