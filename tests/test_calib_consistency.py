"""Triples that must close: they tell which of several peaks is right, and which pair to leave out."""

from itertools import combinations

import numpy as np
import pytest

from calib.consistency import agree
from calib.gcc import N_CANDIDATES, Candidates, PairCorrelator

PAIRS = np.array(list(combinations(range(8), 2)), dtype=np.int32)


def make_candidates(n: int, seed: int = 0, noise: float = 0.01) -> tuple[np.ndarray, Candidates]:
    """Return arrivals (n, 8), and candidates whose first is the right one."""
    rng = np.random.default_rng(seed)
    arrivals = rng.uniform(-60, 60, (n, 8))
    lags = rng.uniform(-200, 200, (n, len(PAIRS), N_CANDIDATES))
    lags[..., 0] = arrivals[:, PAIRS[:, 1]] - arrivals[:, PAIRS[:, 0]] + noise * rng.standard_normal((n, len(PAIRS)))
    scores = np.sort(rng.uniform(0.2, 1.0, lags.shape), axis=2)[..., ::-1]
    return arrivals - arrivals.mean(axis=1, keepdims=True), Candidates(
        lags, scores.copy(), np.full(lags.shape[:2], noise)
    )


def test_what_agrees_is_averaged():
    arrivals, candidates = make_candidates(50)
    found = agree(candidates, PAIRS, 8)
    assert (found.chosen == 0).mean() > 0.99  # now and then another peak is as near, by chance
    assert (found.quality == 1).all()
    errors = (found.arrivals - arrivals)[(found.chosen == 0).all(axis=1)]
    # of n arrivals from all pairs, each with variance s^2: s^2 (n - 1) / n^2
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(0.01 * np.sqrt(7) / 8, rel=0.1)


@pytest.mark.parametrize("share", [0.1, 0.25])
def test_a_lower_peak_that_closes_beats_a_higher_one_that_does_not(share):
    arrivals, candidates = make_candidates(200, seed=1)
    swapped = np.random.default_rng(2).random(candidates.lags.shape[:2]) < share
    candidates.lags[swapped, 0], candidates.lags[swapped, 1] = candidates.lags[swapped, 1], candidates.lags[swapped, 0]
    found = agree(candidates, PAIRS, 8)
    assert (found.chosen == swapped).mean() > 0.98
    assert np.mean(np.abs(found.arrivals - arrivals) > 1) < 0.002


def test_a_channel_that_nobody_agrees_with_is_left_out():
    arrivals, candidates = make_candidates(20, seed=3)
    touched = (PAIRS == 5).any(axis=1)
    candidates.lags[:, touched] = np.random.default_rng(4).uniform(-200, 200, (20, touched.sum(), N_CANDIDATES))
    found = agree(candidates, PAIRS, 8)
    assert np.isnan(found.arrivals[:, 5]).mean() > 0.8
    others = np.delete(found.arrivals, 5, axis=1) - np.delete(arrivals, 5, axis=1)
    assert np.abs(others - others.mean(axis=1, keepdims=True)).max() < 0.1


def test_noise_alone_does_not_agree():
    lags = np.random.default_rng(5).uniform(-200, 200, (50, len(PAIRS), N_CANDIDATES))
    found = agree(Candidates(lags, np.ones(lags.shape), np.ones(lags.shape[:2])), PAIRS, 8)
    assert found.quality.max() < 0.5


@pytest.mark.parametrize("lag", [-137.25, -0.5, 0.0, 0.125, 111.9])
def test_sign_and_fraction_of_a_lag(lag):
    """Positive where the second channel is later."""
    n_samples = 8192
    frequencies = np.fft.rfftfreq(n_samples)
    spectrum = np.fft.rfft(np.random.default_rng(2).standard_normal(n_samples) * np.hanning(n_samples) ** 2)
    spectrum[frequencies > 0.4] = 0
    later = np.fft.irfft(spectrum * np.exp(-2j * np.pi * frequencies * lag), n_samples)
    window = np.array([[np.fft.irfft(spectrum, n_samples), later]], dtype=np.float32)
    found = PairCorrelator(n_samples, None, 160).candidates(window)
    assert found.lags[0, 0, 0] == pytest.approx(lag, abs=0.005)
    assert found.scores[0, 0, 0] > 0.9
