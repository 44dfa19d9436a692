"""The simulated sound: edges, delays, echoes."""

import numpy as np
import pytest
from simulated import make_description

from acquire.devices.simulated.edges import pin_edges
from acquire.devices.simulated.impulses import HALF_WIDTH_SAMPLES, band_limited_impulses
from acquire.devices.simulated.piezo import draw_piezo
from acquire.devices.simulated.room import Room
from acquire.devices.simulated.scene import draw_scene
from acquire.devices.simulated.sound import SoundField
from acquire.devices.simulated.stage import Emission
from rigs.waveform import Waveform, mls_bits

RATE_HZ = 48000.0
SWEEP = Waveform("sweep", 0.1, 1000.0, 8000.0)
FALLING = Waveform("sweep", 0.05, 6000.0, 2000.0)
TONE = Waveform("tone", 0.1, 4000.0, 4000.0)
ODD_TONE = Waveform("tone", 0.1, 4005.0, 4005.0)
MLS = Waveform("mls", 1023 / 16000, 0.0, 8000.0, 10, 16000.0)


def rendered(rt60_s=0.0, seed=0, buzzer=0, start_sample=1000.3):
    scene = draw_scene(make_description(simulation={"rt60_s": rt60_s}), seed)
    emission = Emission(buzzer, SWEEP, 0.0, 1.0, 0, scene.planned_pose(0))
    return scene, emission, SoundField(scene, RATE_HZ).heard(emission, start_sample)


def delay_s(later, earlier):
    """Return the delay between two channels by the slope of their cross-spectrum's phase from 1 to 8 kHz."""
    n_fft = 2 ** int(np.ceil(np.log2(2 * len(later))))
    frequency_hz = np.fft.rfftfreq(n_fft, 1 / RATE_HZ)
    band = (frequency_hz > 1000) & (frequency_hz < 8000)
    cross = (np.fft.rfft(later, n_fft) * np.conj(np.fft.rfft(earlier, n_fft)))[band]
    coarse_s = np.argmax(np.correlate(later, earlier, "full")) - (len(earlier) - 1)
    coarse_s /= RATE_HZ
    phase = np.angle(cross * np.exp(2j * np.pi * frequency_hz[band] * coarse_s))
    weight = np.abs(cross)
    slope = np.sum(weight * phase * frequency_hz[band]) / np.sum(weight * frequency_hz[band] ** 2)
    return coarse_s - slope / (2 * np.pi)


@pytest.mark.parametrize("waveform", [SWEEP, FALLING, TONE, ODD_TONE], ids=lambda waveform: waveform.label())
def test_edges_lie_at_half_periods_of_the_phase_law(waveform):
    time_s, step = pin_edges(waveform)
    half_periods = 2 * waveform.phase_cycles(time_s)
    tick_half_periods = 2 * waveform.band_hz()[1] * 0.25e-6
    inner = slice(0, len(time_s) - 1)
    assert np.abs(half_periods - np.arange(len(time_s)))[inner].max() <= tick_half_periods * 1.01
    assert np.allclose(time_s / 0.5e-6, np.rint(time_s / 0.5e-6))
    assert time_s[0] == 0
    assert time_s[-1] <= waveform.duration_s
    assert (np.diff(time_s) > 0).all()
    assert (np.diff(step) != 0).all()
    assert step.sum() == 0


def test_mls_edges_give_back_the_bits():
    time_s, step = pin_edges(MLS)
    chips = (np.arange(1023) + 0.5) / MLS.chip_rate_hz
    level = (step[:, None] * (time_s[:, None] <= chips)).sum(axis=0)
    assert (level == mls_bits(10)).all()
    assert step.sum() == 0


def test_impulses_between_samples_have_the_phase_of_their_place():
    places = HALF_WIDTH_SAMPLES + np.array([[0.0], [0.25], [0.5], [10.9]])
    impulses = band_limited_impulses(places, np.ones_like(places), 128)
    frequency_hz = np.fft.rfftfreq(128, 1 / RATE_HZ)
    band = (frequency_hz >= 1000) & (frequency_hz <= 8000)
    turned = np.fft.rfft(impulses)[:, band] * np.exp(2j * np.pi * frequency_hz[band] / RATE_HZ * places)
    assert np.abs(np.angle(turned) / (2 * np.pi * frequency_hz[band])).max() < 0.02e-6
    assert np.abs(np.abs(turned) - 1).max() < 1e-3


def test_impulses_out_of_range_are_left_out():
    places = np.array([[-1.0, 0.0, 1e6]])
    assert not band_limited_impulses(places, np.ones_like(places), 100).any()


def test_direct_sound_arrives_when_geometry_says():
    scene, emission, (_, pressure) = rendered()
    source_m = emission.board_to_camera.apply(scene.buzzers_m[0])
    flight_s = np.linalg.norm(scene.microphones_m - source_m, axis=1) / scene.speed_of_sound_m_s
    for channel in range(1, 8):
        measured_s = delay_s(pressure[:, channel].astype(float), pressure[:, 0].astype(float))
        assert measured_s == pytest.approx(flight_s[channel] - flight_s[0], abs=0.05e-6)


def test_a_later_start_delays_all_channels_by_as_much():
    _, _, (first, early) = rendered(start_sample=1000.0)
    _, _, (first_late, late) = rendered(start_sample=1000.37)
    n_samples = min(len(early), len(late))
    measured_s = delay_s(late[:n_samples, 2].astype(float), early[:n_samples, 2].astype(float))
    assert measured_s + (first_late - first) / RATE_HZ == pytest.approx(0.37 / RATE_HZ, abs=0.05e-6)


def test_absolute_arrival_is_the_start_plus_the_flight():
    scene, emission, (first, pressure) = rendered()
    source_m = emission.board_to_camera.apply(scene.buzzers_m[0])
    flight_s = np.linalg.norm(scene.microphones_m[0] - source_m) / scene.speed_of_sound_m_s
    envelope = np.abs(pressure[:, 0])
    onset = first + np.flatnonzero(envelope > 0.05 * envelope.max())[0]
    assert onset == pytest.approx(1000.3 + flight_s * RATE_HZ, abs=8)


def test_direct_sound_falls_with_distance():
    scene, emission, (_, pressure) = rendered()
    source_m = emission.board_to_camera.apply(scene.buzzers_m[0])
    distance_m = np.linalg.norm(scene.microphones_m - source_m, axis=1)
    rms = np.sqrt((pressure.astype(float) ** 2).mean(axis=0))
    assert np.allclose(rms * distance_m, (rms * distance_m).mean(), rtol=0.01)


@pytest.mark.parametrize("rt60_s", [0.2, 0.5])
def test_echo_falls_by_60_db_in_rt60(rt60_s):
    room = Room(np.array([5.2, 4.3, 2.9]), rt60_s, 343.0)
    receivers_m = np.array([[2.1, 1.7, 1.2], [2.4, 2.2, 1.6], [3.0, 1.5, 1.4]])
    responses = room.impulse_responses(np.array([2.9, 2.5, 1.3]), receivers_m, RATE_HZ, np.random.default_rng(0))
    for response in responses:
        left_db = 10 * np.log10(np.cumsum(response[::-1] ** 2)[::-1] / np.sum(response**2))
        fit = (left_db < -5) & (left_db > -25)
        time_s = np.arange(len(response)) / RATE_HZ
        slope_db_s = np.polyfit(time_s[fit], left_db[fit], 1)[0]
        assert -60 / slope_db_s == pytest.approx(rt60_s, rel=0.2)


def test_diffuse_echo_goes_on_where_the_images_end():
    room = Room(np.array([5.2, 4.3, 2.9]), 0.5, 343.0)
    receivers_m = np.array([2.5, 2.0, 1.4]) + 0.3 * np.random.default_rng(0).standard_normal((20, 3))
    responses = room.impulse_responses(np.array([2.9, 2.5, 1.3]), receivers_m, RATE_HZ, np.random.default_rng(1))
    middle = HALF_WIDTH_SAMPLES + int(0.03 * RATE_HZ)
    before, after = (np.mean(responses[:, middle + low : middle + low + 480] ** 2) for low in (-480, 0))
    fall_db = 10 * np.log10(before / after)
    assert fall_db == pytest.approx(60 * 0.01 / 0.5, abs=2.0)


def test_an_anechoic_room_has_no_echo():
    room = Room(np.array([5.2, 4.3, 2.9]), 0.0, 343.0)
    responses = room.impulse_responses(
        np.array([2.9, 2.5, 1.3]), np.array([[2.1, 1.7, 1.2]]), RATE_HZ, np.random.default_rng(0)
    )
    direct = HALF_WIDTH_SAMPLES + np.linalg.norm([0.8, 0.8, 0.1]) / 343.0 * RATE_HZ
    far = np.abs(np.arange(responses.shape[1]) - direct) > HALF_WIDTH_SAMPLES
    assert not responses[0, far].any()
    assert responses.sum() == pytest.approx(1 / np.linalg.norm([0.8, 0.8, 0.1]), rel=1e-3)


def test_piezo_resonates_and_no_two_are_alike():
    frequency_hz = np.linspace(500, 20000, 400)
    first, second = (np.abs(draw_piezo(0, buzzer).response(frequency_hz)) for buzzer in (0, 1))
    assert 2300 < frequency_hz[first.argmax()] < 4500
    assert np.abs(first / second - 1).max() > 0.01
    assert first[frequency_hz > 15000].max() < 0.2 * first.max()
