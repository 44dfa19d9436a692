"""The virtual bench's hands and ears: when the board is moved, and when its buzzers are heard."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from simboard import BUZZER_PINS
from simulated import make_description
from virtual_bench.ears import RENDER_LATENCY_S, Ears
from virtual_bench.hands import Hands, Place
from virtual_bench.pins import Edge
from virtual_bench.sound import Air

from acquire.clock import VirtualClock
from acquire.devices.simulated.edges import pin_edges
from acquire.devices.simulated.scene import draw_scene

RATE_HZ = 48000
QUIET_S, PATIENCE_S = 2.0, 20.0
DESCRIPTION = make_description(simulation={"rt60_s": 0.0, "snr_db": 120})
SCENE = draw_scene(DESCRIPTION, seed=3)  # four buzzers
EDGES_S, STEPS = pin_edges(DESCRIPTION.signal.waveform())


class Silent:
    """A loudspeaker that keeps what it is given; sample 0 sounds at host time 0."""

    rate_hz, channels, written, stood_still = RATE_HZ, 8, 0, False

    def __init__(self) -> None:
        self.now_s, self.corrections = 0.0, 0
        self.played = np.zeros((0, 8), np.float32)

    def due(self) -> int:
        return round((self.now_s + 0.2) * RATE_HZ) - len(self.played)

    def play(self, samples) -> None:
        self.played = np.concatenate([self.played, samples])

    def sample_at(self, host_s):
        return host_s * RATE_HZ

    def keep_time(self) -> None:
        self.corrections += 1


@pytest.fixture
def clock():
    return VirtualClock()


@pytest.fixture
def hands(clock):
    hands = Hands(SCENE, clock, QUIET_S, PATIENCE_S)
    clock.sleep_s(1.5)
    return hands


@pytest.fixture
def speaker():
    return Silent()


@pytest.fixture
def ears(speaker):
    with ThreadPoolExecutor(1) as executor:
        ears = Ears(Air(SCENE, RATE_HZ), speaker, [1, 2, 3, 4], executor)
        ears.move(Place(0, SCENE.planned_pose(0), 0.0))
        yield ears


def hear_all(hands, clock):
    for buzzer in (1, 2, 3, 4):
        hands.hear(buzzer, clock.now_s())
        clock.sleep_s(0.5)


def emission(start_s, buzzer=2):
    """Return the edges of one emission."""
    levels = (STEPS > 0).astype(int)
    return [Edge(BUZZER_PINS[buzzer], start_s + t, level) for t, level in zip(EDGES_S, levels, strict=True)]


def live(ears, speaker, edges, until_s, *, delay_s=0.005, step_s=0.01):
    """Let time pass; each edge is known a little after it was due."""
    begun = []
    for now_s in np.arange(speaker.now_s, until_s, step_s):
        speaker.now_s = now_s
        known = [edge for edge in edges if now_s - step_s <= edge.time_s + delay_s < now_s]
        begun += ears.hear(known)
        ears.play()
    return begun


def test_the_board_is_moved_when_all_buzzers_have_sounded_and_it_is_quiet(hands, clock):
    hear_all(hands, clock)
    clock.sleep_s(QUIET_S - 0.6)
    assert hands.step() is None
    clock.sleep_s(0.2)
    place = hands.step()
    assert place.number == 1
    assert hands.places[0].left_s == clock.now_s()
    np.testing.assert_array_equal(place.board_to_camera.matrix(), SCENE.planned_pose(1).matrix())


def test_a_buzzer_fired_again_keeps_the_board_where_it_is(hands, clock):
    hear_all(hands, clock)
    clock.sleep_s(1.0)
    hands.hear(3, clock.now_s())
    clock.sleep_s(1.0)
    assert hands.step() is None
    clock.sleep_s(1.1)
    assert hands.step() is not None


def test_at_a_new_place_all_buzzers_are_waited_for_again(hands, clock):
    hear_all(hands, clock)
    clock.sleep_s(QUIET_S)
    assert hands.step() is not None
    clock.sleep_s(1.5)
    hands.hear(1, clock.now_s())
    clock.sleep_s(QUIET_S + 0.1)
    assert hands.step() is None


def test_a_silent_buzzer_does_not_hold_the_board_for_ever(hands, clock):
    hands.hear(1, clock.now_s())
    clock.sleep_s(PATIENCE_S - 0.1)
    assert hands.step() is None
    clock.sleep_s(0.2)
    assert hands.step() is not None


def test_the_board_is_seen_to_move(hands, clock):
    hear_all(hands, clock)
    clock.sleep_s(QUIET_S)
    start_s, origin = clock.now_s(), hands.board_to_camera(clock.now_s())
    target = hands.step().board_to_camera
    middle = hands.board_to_camera(start_s + 0.5).translation_m
    assert hands.is_moving(start_s + 0.5)
    np.testing.assert_allclose(middle, (origin.translation_m + target.translation_m) / 2, atol=1e-9)
    assert not hands.is_moving(start_s + 1.5)
    assert hands.board_to_camera(start_s + 1.5) is target


def test_each_edge_is_heard_a_steady_time_after_it_was_due(ears, speaker):
    begun = live(ears, speaker, [*emission(0.5003), *emission(1.2007, buzzer=4), *emission(1.7, buzzer=2)], 2.2)
    assert [(each.buzzer, each.on_s, each.late_s, each.lost_samples) for each in begun] == [
        (2, 0.5003, 0.0, 0),
        (4, 1.2007, 0.0, 0),
        (2, 1.7, 0.0, 0),
    ]
    expected = np.zeros((3 * RATE_HZ, 8))
    for each in begun:
        response = Air(SCENE, RATE_HZ).response(each.buzzer - 1, SCENE.planned_pose(0), 0)
        for first, pressure in response.heard((each.on_s + RENDER_LATENCY_S + EDGES_S) * RATE_HZ, STEPS):
            expected[first : first + len(pressure)] += pressure
    np.testing.assert_allclose(speaker.played, expected[: len(speaker.played)], atol=1e-4 * np.abs(expected).max())


def test_an_emission_known_too_late_is_heard_later_as_a_whole(ears, speaker):
    (begun,) = live(ears, speaker, emission(0.5), 2.0, delay_s=0.25)
    assert 0.1 < begun.late_s < 0.2
    assert begun.lost_samples == 0
    loud = np.flatnonzero(np.abs(speaker.played[:, 0]) > 0.005)
    assert loud[0] / RATE_HZ == pytest.approx(0.5 + RENDER_LATENCY_S + begun.late_s, abs=0.005)


def test_what_is_lost_of_an_emission_is_said(ears, speaker):
    edges = emission(0.5)
    live(ears, speaker, edges[: len(edges) // 2], 0.7)
    begun = ears.emissions[-1]
    speaker.now_s = 0.9
    ears.play()
    ears.hear(edges[len(edges) // 2 :])
    assert begun.lost_samples > 0


def test_the_clock_is_corrected_only_while_nothing_sounds(ears, speaker):
    live(ears, speaker, [], 0.5)
    assert speaker.corrections > 0
    corrections = speaker.corrections
    live(ears, speaker, emission(0.5), 0.65)
    ringing = speaker.corrections
    assert ringing - corrections <= 2  # until the first edge is known
    live(ears, speaker, [], 1.5)
    assert speaker.corrections > ringing
