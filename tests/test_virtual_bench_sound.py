"""The virtual bench's sound: edges of a pin become pressure at the microphones, delayed to a fraction of a sample."""

import time

import numpy as np
import pytest
from simboard import Talk, running_board
from simulated import make_description
from virtual_bench.loudspeaker import SoundOrigin
from virtual_bench.mix import Mix
from virtual_bench.pins import PinTrace
from virtual_bench.sound import Air

from acquire.devices.simulated.edges import pin_edges
from acquire.devices.simulated.scene import draw_scene

RATE_HZ = 48000.0
EDGES_S, STEPS = pin_edges(make_description().signal.waveform())


def make_air(rt60_s: float):
    scene = draw_scene(make_description(simulation={"rt60_s": rt60_s}), seed=3)
    return scene, Air(scene, RATE_HZ)


def rendered(response, position_samples, parts=1):
    """Render the sweep in parts and add them up; the first sample is number 0."""
    sound = np.zeros((60000, 8))
    for edges in np.array_split(np.arange(len(STEPS)), parts):
        for first, pressure in response.heard(position_samples[edges], STEPS[edges]):
            sound[first : first + len(pressure)] += pressure
    return sound


def delays_samples(sound):
    """Return the delay of each channel after the first: the slope of the cross spectrum's phase in the sweep's band."""
    spectrum = np.fft.rfft(sound, axis=0)
    frequency = np.arange(len(spectrum)) / len(sound)
    band = (frequency * RATE_HZ > 1000) & (frequency * RATE_HZ < 8000)
    cross = spectrum[band] * np.conj(spectrum[band][:, :1])
    angle = 2 * np.pi * frequency[band, None]
    guess = np.argmax(np.fft.irfft(spectrum * np.conj(spectrum[:, :1]), axis=0), axis=0)
    guess = np.where(guess > len(sound) / 2, guess - len(sound), guess)
    rest = np.angle(cross * np.exp(1j * angle * guess))
    weight = np.abs(cross)
    return guess - (weight * rest * angle).sum(axis=0) / (weight * angle**2).sum(axis=0)


def test_channels_are_delayed_by_their_distances():
    scene, air = make_air(rt60_s=0.0)
    here = scene.planned_pose(2)
    sound = rendered(air.response(1, here, 2), EDGES_S * RATE_HZ + 1000.3)
    distance_m = np.linalg.norm(scene.microphones_m - here.apply(scene.buzzers_m[1]), axis=1)
    expected = (distance_m - distance_m[0]) / scene.speed_of_sound_m_s * RATE_HZ
    assert np.abs(expected).max() > 10
    assert delays_samples(sound) == pytest.approx(expected, abs=0.001)


def test_a_fraction_of_a_sample_later_is_heard_that_much_later():
    scene, air = make_air(rt60_s=0.3)
    response = air.response(0, scene.planned_pose(0), 0)
    early, late = (rendered(response, EDGES_S * RATE_HZ + start)[:, :1] for start in (1000.0, 1000.37))
    assert delays_samples(np.hstack([early, late]))[1] == pytest.approx(0.37, abs=0.001)


def test_sound_falls_with_distance():
    scene, air = make_air(rt60_s=0.0)
    near, far = sorted((scene.planned_pose(k) for k in range(20)), key=lambda pose: pose.translation_m[2])[::19]
    levels = [rendered(air.response(0, pose, 0), EDGES_S * RATE_HZ + 1000).std(axis=0) for pose in (near, far)]
    distances = [np.linalg.norm(scene.microphones_m - pose.apply(scene.buzzers_m[0]), axis=1) for pose in (near, far)]
    np.testing.assert_allclose(levels[0] * distances[0], levels[1] * distances[1], rtol=1e-3)


@pytest.mark.parametrize("parts", [2, 9, 100])
def test_an_emission_that_comes_in_parts_sounds_the_same(parts):
    scene, air = make_air(rt60_s=0.3)
    response = air.response(3, scene.planned_pose(1), 1)
    position = EDGES_S * RATE_HZ + 1000.6
    whole = rendered(response, position)
    np.testing.assert_allclose(rendered(response, position, parts), whole, atol=1e-6 * np.abs(whole).max())


def test_the_mix_adds_and_says_what_came_too_late():
    mix = Mix(1, begin=100)
    assert mix.add(102, np.ones((4, 1), np.float32)) == 0
    assert mix.add(104, np.ones((4, 1), np.float32)) == 0
    assert mix.take(5)[:, 0].tolist() == [0, 0, 1, 1, 2]
    assert mix.add(103, np.array([[40], [30], [20], [10]], np.float32)) == 2
    assert mix.add(90, np.ones((4, 1), np.float32)) == 4
    assert mix.take(4)[:, 0].tolist() == [22, 11, 1, 0]
    assert mix.is_silent()


def test_the_origin_of_the_sound_is_that_of_its_quickest_readings():
    origin, late_s = SoundOrigin(), np.abs(np.random.default_rng(0).normal(scale=0.02, size=60))
    for number, late in enumerate(late_s):
        origin.add(100.0 + number / 20 + late, number / 20)
    assert origin.estimate_s(103.0) == pytest.approx(100.0, abs=0.003)
    origin.restart()
    assert origin.estimate_s(103.0) is None
    for number, late in enumerate(late_s):
        origin.add(104.0 + number / 20 + late, 3 + number / 20)
    assert origin.estimate_s(107.0) == pytest.approx(101.0, abs=0.003)


def test_pins_are_followed_in_host_time(tmp_path):
    path = tmp_path / "trace.txt"
    trace = PinTrace(path)
    assert trace.new_edges() == []
    with path.open("w") as file:
        file.write("# cycle pin level; 16000000 cycles a second\n0 RESET power\n# pace: cycle 0 at 50.500000000 s of\n")
        file.write("16000000 PD2 1\n24000000 P")
        file.flush()
        assert [(edge.pin, edge.time_s, edge.level) for edge in trace.new_edges()] == [("PD2", 51.5, 1)]
        file.write("D3 1\n")
    assert [(edge.pin, edge.time_s, edge.level) for edge in trace.new_edges()] == [("PD3", 52.0, 1)]
    trace.close()


def test_the_real_boards_pins_are_told_in_host_time():
    with running_board() as board, Talk(board.port) as host:
        trace = PinTrace(board.trace_path)
        host.restart(board)
        before_s = time.monotonic()
        host.play("1 play 2 sweep 1000 8000 10000")
        board.settle()
        edges = [edge for edge in trace.new_edges() if edge.pin == "PD3"]
        trace.close()
    assert [edge.level for edge in edges] == [1, 0] * (len(edges) // 2)
    assert before_s < edges[0].time_s < time.monotonic()
    assert edges[-1].time_s - edges[0].time_s == pytest.approx(0.01, abs=0.0005)
