"""The sample clock under stamps that come late: its rate, its uncertainty, and what it makes of lost samples."""

import numpy as np
import pytest

from acquire.sample_clock import SampleClock

RATE_HZ, BLOCK = 48000, 1024
START_S = 500.0


def late_stamps(n_blocks, *, ppm=0.0, mean_late_s=0.002, seed=0, start_s=START_S, first=0):
    """Return samples and stamps of blocks, late by an exponential time, now and then by a tenth of a second."""
    rng = np.random.default_rng(seed)
    samples = first + BLOCK * np.arange(n_blocks)
    late_s = rng.exponential(mean_late_s, n_blocks) + 0.1 * (rng.random(n_blocks) < 0.02)
    return samples, start_s + (samples - first) / (RATE_HZ * (1 + 1e-6 * ppm)) + late_s


def some_early(hosts_s, *, seed, share=0.01, n_together=1):
    """Return the stamps with a share of the blocks up to 12 ms early, some after one another, as sound servers do."""
    rng = np.random.default_rng(seed)
    early = np.flatnonzero(rng.random(len(hosts_s)) < share / n_together)
    early = np.unique(np.add.outer(early, np.arange(n_together)).clip(0, len(hosts_s) - 1))
    hosts_s = hosts_s.copy()
    hosts_s[early] -= rng.uniform(0.003, 0.012, len(early))
    return hosts_s


def fed(clock, samples, hosts_s):
    return [step_s for each in zip(samples.tolist(), hosts_s.tolist(), strict=True) if (step_s := clock.add(*each))]


@pytest.mark.parametrize("ppm", [-60.0, 0.0, 25.0, 90.0])
@pytest.mark.parametrize("seed", range(3))
def test_the_rate_is_found_to_a_few_ppm_within_its_stated_uncertainty(ppm, seed):
    clock = SampleClock(RATE_HZ)
    assert not fed(clock, *late_stamps(3000, ppm=ppm, seed=seed))
    fit = clock.fit()
    error = fit.rate / RATE_HZ - 1 - 1e-6 * ppm
    assert abs(error) < 4e-6
    assert abs(error) < 4 * fit.rate_std < 3e-5


@pytest.mark.parametrize("n_blocks", [40, 300, 3000])
def test_the_stated_uncertainty_covers_the_error_which_a_median_leaves_in_full(n_blocks):
    errors_s, stated_s = [], []
    for seed in range(20):
        clock = SampleClock(RATE_HZ)
        fed(clock, *late_stamps(n_blocks, ppm=30.0, seed=seed))
        true_s = START_S + 0.9 * n_blocks * BLOCK / (RATE_HZ * (1 + 30e-6))
        errors_s.append(clock.sample_at(true_s) / RATE_HZ - 0.9 * n_blocks * BLOCK / RATE_HZ)
        stated_s.append(clock.fit().std_s)
    assert np.sqrt(np.mean(np.square(errors_s))) < 2 * np.mean(stated_s) < 0.0006
    assert np.abs(errors_s).max() < 0.0005  # a median would be off by the typical lateness, 1.4 ms


@pytest.mark.parametrize("early_s", [0.008, 0.02, 0.04])
def test_a_second_of_early_blocks_does_not_move_the_line_of_a_recording_that_has_just_begun(early_s):
    clock = SampleClock(RATE_HZ)
    samples, hosts_s = late_stamps(300)
    began, ended = np.searchsorted(samples, [4 * RATE_HZ, 5.2 * RATE_HZ])
    hosts_s[began:ended] -= early_s
    assert not fed(clock, samples[:ended], hosts_s[:ended])
    assert clock.sample_at(START_S + 5.0) / RATE_HZ == pytest.approx(5.0, abs=0.001)


def test_one_block_gives_the_offset():
    clock = SampleClock(RATE_HZ)
    assert clock.sample_at(1.0) is None
    assert clock.fit() is None
    clock.add(4800, START_S)
    assert clock.sample_at(START_S + 1) == pytest.approx(4800 + RATE_HZ)


@pytest.mark.parametrize("lost_s", [0.01, 0.1, 0.3])
def test_lost_samples_are_told_once_and_the_mapping_starts_anew(lost_s):
    clock = SampleClock(RATE_HZ)
    fed(clock, *late_stamps(500))
    samples, hosts_s = late_stamps(300, first=500 * BLOCK, start_s=START_S + 500 * BLOCK / RATE_HZ + lost_s, seed=1)
    steps_s = fed(clock, samples, hosts_s)
    assert steps_s == [pytest.approx(lost_s, abs=0.12)]
    assert clock.sample_at(float(samples[250]) / RATE_HZ + START_S + lost_s) == pytest.approx(samples[250], abs=30)


def test_while_blocks_are_late_the_clock_is_in_doubt():
    clock = SampleClock(RATE_HZ)
    samples, hosts_s = late_stamps(100, mean_late_s=0.0001)
    fed(clock, samples[:60], hosts_s[:60])
    assert not clock.is_in_doubt
    fed(clock, samples[60:70], hosts_s[60:70] + 0.2)
    assert clock.is_in_doubt
    assert not fed(clock, samples[70:], hosts_s[70:])
    assert not clock.is_in_doubt


def test_a_backlog_that_is_worked_off_is_no_loss():
    clock = SampleClock(RATE_HZ)
    samples, hosts_s = late_stamps(500)
    hosts_s[200:240] = np.maximum(hosts_s[200:240], hosts_s[240])  # 0.85 s of blocks come all at once
    assert not fed(clock, samples, hosts_s)


def test_first_stamps_that_are_all_late_are_forgotten():
    clock = SampleClock(RATE_HZ)
    samples, hosts_s = late_stamps(500)
    hosts_s[:80] += 0.25
    assert not fed(clock, samples, hosts_s)
    assert clock.sample_at(START_S + 8.0) == pytest.approx(8.0 * RATE_HZ, abs=30)


def test_a_clock_that_jumps_back_later_on_is_told():
    clock = SampleClock(RATE_HZ)
    samples, hosts_s = late_stamps(500)
    hosts_s[300:] -= 0.4
    assert fed(clock, samples, hosts_s) == [pytest.approx(-0.4, abs=0.01)]


@pytest.mark.parametrize(("share", "n_together"), [(0.01, 1), (0.03, 1), (0.03, 5), (0.03, 15)])
@pytest.mark.parametrize("seed", range(4))
def test_blocks_that_come_early_are_no_loss_and_move_the_line_little(share, n_together, seed):
    clock = SampleClock(RATE_HZ)
    samples, hosts_s = late_stamps(3000, ppm=30.0, seed=seed)
    hosts_s[100:] = some_early(hosts_s[100:], seed=seed, share=share, n_together=n_together)
    assert not fed(clock, samples, hosts_s)
    assert clock.fit().rate / RATE_HZ - 1 == pytest.approx(30e-6, abs=4e-6)
    true_s = START_S + samples[2900] / (RATE_HZ * (1 + 30e-6))
    assert clock.sample_at(true_s) == pytest.approx(samples[2900], abs=0.0005 * RATE_HZ)


@pytest.mark.parametrize("at", [0, 1, 7, 30, 80])
def test_a_single_early_block_at_the_start_is_no_loss(at):
    clock = SampleClock(RATE_HZ)
    samples, hosts_s = late_stamps(300, mean_late_s=0.0005)
    hosts_s[at] = START_S + samples[at] / RATE_HZ - 0.012
    assert not fed(clock, samples, hosts_s)
    assert clock.sample_at(START_S + 5.0) == pytest.approx(5.0 * RATE_HZ, abs=30)


def test_where_stamps_scatter_anyway_a_second_of_late_ones_is_no_loss():
    clock = SampleClock(RATE_HZ)
    samples, hosts_s = late_stamps(3000, mean_late_s=0.0005)
    time_s = samples / RATE_HZ
    hosts_s += 0.008 * np.where(time_s < 20, time_s % 1.3 > 0.35, time_s % 2.6 > 1.3)  # at first too short for a loss
    assert not fed(clock, samples, hosts_s)


@pytest.mark.parametrize("lost_s", [0.006, 0.1])
@pytest.mark.parametrize("seed", range(4))
def test_lost_samples_are_told_within_a_second_although_blocks_come_early_now_and_then(lost_s, seed):
    clock = SampleClock(RATE_HZ)
    samples, hosts_s = late_stamps(1500, seed=seed, mean_late_s=0.001)
    hosts_s[700:] += lost_s
    hosts_s = some_early(hosts_s, seed=seed)
    steps = {k: step_s for k in range(1500) if (step_s := clock.add(int(samples[k]), float(hosts_s[k])))}
    (at,) = steps
    assert 0.9 < (samples[at] - samples[700]) / RATE_HZ < 1.5
    assert steps[at] == pytest.approx(lost_s, abs=0.003)
    assert clock.sample_at(START_S + 25.0) == pytest.approx((25.0 - lost_s) * RATE_HZ, abs=30)


@pytest.mark.parametrize(("back_s", "within_s"), [(0.02, 3.1), (0.4, 1.1), (3600.0, 1.1)])
def test_a_clock_that_jumps_back_is_told_from_early_blocks(back_s, within_s):
    clock = SampleClock(RATE_HZ)
    samples, hosts_s = late_stamps(1500)
    hosts_s = some_early(hosts_s, seed=0)
    hosts_s[700:] -= back_s
    steps = {k: step_s for k in range(1500) if (step_s := clock.add(int(samples[k]), float(hosts_s[k])))}
    (at,) = steps
    assert 0 < (samples[at] - samples[700]) / RATE_HZ < within_s
    assert steps[at] == pytest.approx(-back_s, abs=0.012)
    assert clock.sample_at(START_S + 25.0 - back_s) == pytest.approx(25.0 * RATE_HZ, abs=30)


def test_the_longest_stretch_gives_the_rate_of_the_session():
    clock = SampleClock(RATE_HZ)
    fed(clock, *late_stamps(3000, ppm=40.0))
    clock.restart()
    fed(clock, *late_stamps(30, start_s=START_S + 80))
    fit = clock.longest_fit()
    assert 1e6 * (fit.rate / RATE_HZ - 1) == pytest.approx(40.0, abs=3)
    assert fit.since_s == pytest.approx(START_S, abs=0.5)


def test_steady_stamps_have_settled_after_the_start_up_although_some_come_late():
    clock = SampleClock(RATE_HZ)
    samples, hosts_s = late_stamps(500)
    settled = [clock.add(*each) is None and clock.is_settled for each in zip(samples.tolist(), hosts_s, strict=True)]
    first = settled.index(True)
    assert 3.0 <= samples[first] / RATE_HZ < 3.6
    assert np.mean(settled[first:]) > 0.95


@pytest.mark.parametrize("drift_s", [0.2, -0.2])
def test_a_stream_whose_buffers_still_fill_or_empty_has_not_settled(drift_s):
    clock = SampleClock(RATE_HZ)
    samples, hosts_s = late_stamps(900, mean_late_s=0.0002)
    left_s = drift_s * np.exp(-samples / RATE_HZ / 1.5)
    settled_s = []
    for sample, host_s in zip(samples.tolist(), (hosts_s - left_s).tolist(), strict=True):
        clock.add(sample, host_s)
        if clock.is_settled:
            settled_s.append(sample / RATE_HZ)
    assert abs(drift_s) * np.exp(-settled_s[0] / 1.5) < 0.005  # what is left to come
    assert settled_s[-1] > 18.0
    assert clock.sample_at(START_S + 19.0) == pytest.approx(19.0 * RATE_HZ, abs=0.001 * RATE_HZ)


def test_stamps_have_not_settled_while_the_line_still_follows_the_first_ones():
    clock = SampleClock(RATE_HZ)
    samples, hosts_s = late_stamps(500, mean_late_s=0.0002)
    hosts_s[samples > 1.0 * RATE_HZ] += 0.004  # too little for lost samples
    for sample, host_s in zip(samples.tolist(), hosts_s.tolist(), strict=True):
        clock.add(sample, host_s)
        if clock.is_settled:
            break
    true_s = START_S + 0.004 + sample / RATE_HZ
    assert clock.sample_at(true_s) == pytest.approx(sample, abs=0.0015 * RATE_HZ)
