"""Every edge that the real firmware makes on the simulated board, against the law it was asked to follow."""

# ruff: noqa: T201 - figures for whoever runs `pytest -s`
from dataclasses import dataclass

import numpy as np
import pytest
from simboard import BUZZER_PINS, LED_PIN, SYNC_PIN, Talk, Trace, firmware, running_board

from rigs.waveform import Waveform, mls_bits

SWEEPS = [
    (1000, 8000, 0.1),
    (8000, 1000, 0.1),
    (1000, 8000, 0.5),
    (500, 12000, 0.05),
    (1000, 8000, 0.005),
    (10000, 20000, 0.2),
]
TONES = [(50, 0.5), (4000, 0.1), (4001, 0.5), (20000, 0.5), (1234, 0.005)]
MLS = [(order, 16000) for order in range(7, 13)] + [(13, 20000), (10, 19999), (7, 1000)]
# Extremes that nobody sweeps with; they must end well, and only that.
WILD = [(50, 20000, 0.005), (20000, 50, 0.005), (50, 20000, 0.5), (20000, 50, 0.5)]


@dataclass(frozen=True)
class Played:
    """One emission: its waveform, its buzzer, the board's stamps, and its edges in seconds since the first one."""

    wave: Waveform
    buzzer: int
    on_us: int
    first_edge_s: float
    rises_s: np.ndarray
    edges_s: np.ndarray
    levels: np.ndarray
    led_s: np.ndarray


def commands() -> list[tuple[str, Waveform]]:
    sweeps = [(f"sweep {a} {b} {round(1e6 * s)}", Waveform("sweep", s, a, b)) for a, b, s in SWEEPS + WILD]
    tones = [(f"tone {hz} {round(1e6 * s)}", Waveform("tone", s, hz, hz)) for hz, s in TONES]
    mls = [(f"mls {n} {hz}", Waveform("mls", (2**n - 1) / hz, 0, hz / 2, n, hz)) for n, hz in MLS]
    return sweeps + tones + mls


@pytest.fixture(scope="module")
def session() -> tuple[Trace, list[Played]]:
    """Play everything once, buzzer after buzzer, and return the trace and what is in it."""
    stamps = []
    with running_board(fast=True) as board, Talk(board.port) as host:
        host.restart(board)
        for number, (command, _) in enumerate(commands()):
            stamps.append(host.play(f"{number} play {number % 6 + 1} {command}"))
        used_bytes = 2048 - int(host.ask("0 test")["ram"])  # after the deepest interrupts within interrupts
        print(f"{used_bytes} bytes of memory used, the stack included")
        assert used_bytes <= 1024
        board.settle()
        trace = board.trace()
    led_s = trace.pin(LED_PIN)[0].reshape(-1, 2)
    assert len(led_s) == len(stamps), "the LED was not on once for each emission"
    played = []
    for number, (on_us, _) in enumerate(stamps):
        times_s, levels = trace.pin(BUZZER_PINS[number % 6 + 1])
        inside = (times_s > led_s[number, 0] - 1e-4) & (times_s < led_s[number, 1] + 1e-4)
        edges_s, edge_levels = times_s[inside], levels[inside]
        wave = commands()[number][1]
        since_s = edges_s - edges_s[0]
        rises_s = since_s[edge_levels == 1]
        played.append(Played(wave, number % 6 + 1, on_us, edges_s[0], rises_s, since_s, edge_levels, led_s[number]))
    return trace, played


def of_kind(session, kind: str) -> list[Played]:
    return [played for played in session[1] if played.wave.kind == kind]


def tame(session) -> list[Played]:
    return [
        one for one in of_kind(session, "sweep") if (one.wave.start_hz, one.wave.stop_hz) not in [w[:2] for w in WILD]
    ]


def edges_of_law_s(wave: Waveform) -> np.ndarray:
    """Return when the phase of a sweep or tone is a multiple of one half, from 0 on."""
    half_cycles = np.arange(int(np.ceil(round(2 * float(wave.phase_cycles(np.array(wave.duration_s))), 6))))
    curve = (wave.stop_hz - wave.start_hz) / wave.duration_s
    return half_cycles / (wave.start_hz + np.sqrt(wave.start_hz**2 + curve * half_cycles))


def test_one_pin_at_a_time(session):
    trace, _ = session
    edges = [(time, pin, level) for pin in BUZZER_PINS.values() for time, level in zip(*trace.pin(pin), strict=True)]
    high = set()
    for _, pin, level in sorted(edges):
        (high.add if level else high.discard)(pin)
        assert len(high) <= 1
    assert not high
    assert len(edges) > 50_000


def test_the_phase_follows_the_law_of_sweeps_and_tones(session):
    worst_us = 0.0
    for one in tame(session) + of_kind(session, "tone"):
        law_s = edges_of_law_s(one.wave)
        error_us = 1e6 * (one.edges_s[: len(law_s)] - law_s)
        assert len(one.edges_s) in (len(law_s), len(law_s) + 1)  # one more where it has to end low
        worst_us = max(worst_us, float(np.abs(error_us).max()))
        print(f"{one.wave.label()}: phase error {error_us.std():.2f} us, at most {np.abs(error_us).max():.2f} us")
        assert np.abs(np.median(error_us)) < 1
        assert np.abs(error_us).max() < 10  # another interrupt came first
    print(f"largest phase error {worst_us:.2f} us")


def test_the_frequency_is_that_of_the_law_within_half_a_percent(session):
    worst = 0.0
    for one in tame(session) + of_kind(session, "tone"):
        cycles = max(1, round(2e-3 * (one.wave.start_hz + one.wave.stop_hz) / 2))  # over about two milliseconds
        if len(one.rises_s) <= cycles:
            continue
        measured_hz = cycles / (one.rises_s[cycles:] - one.rises_s[:-cycles])
        middle_s = (one.rises_s[cycles:] + one.rises_s[:-cycles]) / 2
        law_hz = one.wave.start_hz + (one.wave.stop_hz - one.wave.start_hz) * middle_s / one.wave.duration_s
        worst = max(worst, float(np.abs(measured_hz / law_hz - 1).max()))
    print(f"largest frequency error {100 * worst:.3f} %")
    assert worst < 0.005


def test_emissions_last_as_long_as_asked_and_end_low(session):
    errors_us = []
    for one in session[1]:
        length_s = one.led_s[1] - one.first_edge_s
        errors_us.append(1e6 * (length_s - one.wave.duration_s))
        assert one.levels[0] == 1
        assert one.levels[-1] == 0
        assert one.edges_s[-1] <= length_s
    print(f"length errors {min(errors_us):.1f} to {max(errors_us):.1f} us")
    assert np.abs(errors_us).max() < 100


def test_the_led_covers_exactly_the_sound(session):
    for one in session[1]:
        assert 0 <= one.led_s[0] - one.first_edge_s < 5e-6
        assert one.led_s[1] - (one.first_edge_s + one.edges_s[-1]) > 0


def test_the_stamp_of_on_is_the_first_edge(session):
    delays_us = np.array([1e6 * one.first_edge_s - one.on_us for one in session[1]])
    print(f"first edge after the ON stamp: constant within {np.ptp(delays_us):.2f} us over {len(delays_us)} emissions")
    assert np.ptp(delays_us) < 8


def test_the_bits_of_a_maximum_length_sequence_are_right(session):
    for one in of_kind(session, "mls"):
        bits = mls_bits(one.wave.order)
        chip_s = 1 / one.wave.chip_rate_hz
        middles_s = (np.arange(len(bits)) + 0.5) * chip_s
        heard = one.levels[np.searchsorted(one.edges_s, middles_s) - 1]
        assert np.array_equal(heard, bits), one.wave.label()
        changes_s = (np.flatnonzero(np.diff(bits)) + 1) * chip_s
        assert np.abs(one.edges_s[1 : 1 + len(changes_s)] - changes_s).max() < 1e-5


def test_the_sync_output_follows_the_wave(session):
    trace, _ = session
    buzzers_s = np.sort(np.concatenate([trace.pin(pin)[0] for pin in BUZZER_PINS.values()]))
    sync_s, _ = trace.pin(SYNC_PIN)
    assert len(sync_s) == len(buzzers_s)
    assert np.abs(sync_s - buzzers_s).max() < 1e-5


def test_wild_sweeps_end_well(session):
    wild = [one for one in of_kind(session, "sweep") if one not in tame(session)]
    assert len(wild) == len(WILD)
    for one in wild:
        assert len(one.edges_s) == pytest.approx(len(edges_of_law_s(one.wave)), abs=2)


def test_a_mega_plays_too():
    with running_board(firmware("mega"), fast=True, mcu="atmega2560") as board, Talk(board.port) as host:
        host.restart(board)
        assert host.ask("1 hello")["board"] == "mega"
        on_us, off_us = host.play("2 play 1 sweep 1000 8000 100000")
        board.settle()
        times_s, _ = board.trace().pin("PE4")  # digital pin 2
        led_s, _ = board.trace().pin("PB7")  # digital pin 13
    assert off_us - on_us == 100_000
    assert np.abs(times_s - times_s[0] - edges_of_law_s(Waveform("sweep", 0.1, 1000, 8000))).max() < 1e-5
    assert np.diff(led_s) == pytest.approx([0.1], abs=1e-4)
