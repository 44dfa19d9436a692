"""Checks of an emission, and the clock and stillness beneath them."""

import re

import numpy as np
import pytest

from acquire.checks import check_emission
from acquire.devices.base import Frame
from acquire.film import SpreadFrames
from acquire.stillness import Sight, StillBoard
from rigs.board import movement_px
from rigs.description import Capture
from rigs.waveform import Waveform

RATE_HZ = 48000
LIMITS = Capture()
SWEEP = Waveform("sweep", 0.1, 1000.0, 8000.0)
MLS = Waveform("mls", 1023 / 16000, 0.0, 8000.0, 10, 16000.0)
TONE = Waveform("tone", 0.1, 4000.0, 4000.0)
EXPECTED = 15000


def heard(waveform, *, late_s=0.0, amplitude=0.1, noise=0.001, n_channels=4):
    rng = np.random.default_rng(1)
    samples = rng.normal(0, noise, (35000, n_channels))
    wave = amplitude * waveform.sampled(RATE_HZ)
    for channel in range(n_channels):
        start = EXPECTED + round(late_s * RATE_HZ) + 40 * channel
        samples[start : start + len(wave), channel] += wave
        samples[start + 300 : start + 300 + len(wave), channel] += 0.8 * wave  # an echo
    return samples.astype(np.float32)


def check(samples, waveform=SWEEP):
    return check_emission(samples, EXPECTED, waveform, LIMITS, RATE_HZ)


@pytest.mark.parametrize(("waveform", "within_s"), [(SWEEP, 0.001), (MLS, 0.001), (TONE, 0.01)])
def test_a_good_emission_has_its_onset_where_it_is_and_no_fault(waveform, within_s):
    result = check(heard(waveform, late_s=0.004), waveform)
    assert result.problem() is None
    assert not result.channel_faults()
    np.testing.assert_allclose(result.onset_s, 0.004 + np.arange(4) * 40 / RATE_HZ, atol=within_s)


def test_the_level_is_the_rms_in_db_of_full_scale():
    samples = np.zeros((35000, 2), dtype=np.float32)
    samples[:, 0] = 0.1
    np.testing.assert_allclose(check(samples).level_dbfs, [-20.0, -200.0], atol=0.01)


@pytest.mark.parametrize("waveform", [SWEEP, MLS, TONE])
@pytest.mark.parametrize("noise", [0.0, 0.0001, 0.05])
def test_silence_and_noise_are_not_heard(waveform, noise):
    assert check(heard(waveform, amplitude=0.0, noise=noise), waveform).problem() == "not heard"


def test_a_faint_emission_is_heard_in_noise_of_the_same_level():
    assert check(heard(SWEEP, amplitude=0.02, noise=0.02)).problem() is None


@pytest.mark.parametrize(("late_s", "word"), [(0.08, "(79|80|81) ms too late"), (-0.1, "(98|99|100) ms too early")])
def test_an_onset_at_the_wrong_time_is_a_problem(late_s, word):
    problem = check(heard(SWEEP, late_s=late_s)).problem()
    assert problem is not None
    assert re.fullmatch(f"heard {word}", problem)


def test_below_the_least_level_nothing_counts_as_heard():
    assert check(heard(SWEEP, amplitude=0.0005, noise=0.00001)).problem() == "not heard"


def test_faults_of_single_channels_are_named_and_leave_the_emission_good():
    samples = heard(SWEEP)
    samples[:, 1] = 0.0
    samples[:, 2] = np.clip(samples[:, 2] * 100, -1, 1)
    result = check(samples)
    assert result.problem() is None
    assert result.channel_faults() == {(1, "silent"), (2, "clipped")}


def test_a_channel_of_nan_is_silent():
    samples = heard(SWEEP)
    samples[:, 3] = np.nan
    assert check(samples).channel_faults() == {(3, "silent")}


@pytest.mark.parametrize("n_samples", [0, 10, 4000])
def test_a_recording_that_is_too_short_is_not_heard(n_samples):
    assert check(heard(SWEEP)[:n_samples]).problem() == "not heard"


CORNERS = np.stack(np.meshgrid(np.arange(9.0) * 20, np.arange(6.0) * 20), axis=-1).reshape(-1, 2)


def test_a_board_is_still_after_the_time_set():
    watch = StillBoard(Capture(still_s=0.5, still_px=0.3), [])
    seen = [watch.see(CORNERS + 0.01 * k, 0.1 * k) for k in range(7)]
    assert seen == [Sight.SETTLING] * 5 + [Sight.STILL] * 2


def test_a_slow_drift_is_movement():
    watch = StillBoard(Capture(still_s=0.5, still_px=0.3), [])
    assert Sight.STILL not in [watch.see(CORNERS + 0.1 * k, 0.1 * k) for k in range(30)]


def test_a_board_lost_from_sight_must_come_to_rest_anew():
    watch = StillBoard(Capture(still_s=0.15), [])
    seen = [watch.see(None if k == 2 else CORNERS, 0.1 * k) for k in range(6)]
    assert seen == [Sight.SETTLING] * 2 + [Sight.MISSING] + [Sight.SETTLING] * 2 + [Sight.STILL]


def test_a_new_pose_is_one_that_differs_from_every_earlier_one():
    watch = StillBoard(Capture(still_s=0, new_pose_px=10), [CORNERS, CORNERS + 100])
    assert watch.see(CORNERS + 5, 0.0) is Sight.SAME_PLACE
    assert watch.see(CORNERS + 95, 0.1) is Sight.SAME_PLACE
    assert watch.see(CORNERS + 8, 0.2) is Sight.STILL


@pytest.mark.parametrize("n_frames", [0, 1, 3, 4, 18, 100])
def test_a_few_frames_are_held_spread_over_all(n_frames):
    spread = SpreadFrames(3)
    for number in range(n_frames):
        spread.add(Frame(np.zeros((1, 1), np.uint8), float(number)))
    times_s = [frame.host_time_s for frame in spread.frames]
    assert min(n_frames, 2) <= len(times_s) <= 3
    assert times_s == sorted(times_s)
    assert not n_frames or times_s[-1] >= (n_frames - 1) / 2


def test_movement_is_told_from_corners_in_both_pictures():
    first, second = CORNERS.copy(), CORNERS + np.array([3.0, 4.0])
    first[0], second[1] = np.nan, np.nan
    assert movement_px(first, second) == pytest.approx(5.0)
    assert movement_px(np.full_like(first, np.nan), second) == np.inf
