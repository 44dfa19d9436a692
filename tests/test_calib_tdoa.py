"""Pulses, gates and GCC-PHAT, on sound with delays known to the nanosecond."""

from itertools import combinations

import numpy as np
import pytest

from calib.arrivals import PulseCompressor
from calib.tdoa import Whitening, gcc_phat
from rigs.waveform import Waveform, mls_bits

RATE_HZ = 48000
PAIRS = np.array(list(combinations(range(8), 2)), dtype=np.int32)
SWEEP = Waveform("sweep", 0.1, 1000.0, 8000.0)
MLS = Waveform("mls", 1023 / 16000, 0.0, 8000.0, 10, 16000.0)


def square_wave(waveform: Waveform, rate_hz: float) -> np.ndarray:
    """Return the wave at a high rate: edges where they fall, no harmonics left out."""
    time_s = np.arange(round(waveform.duration_s * rate_hz)) / rate_hz
    if waveform.kind == "mls":
        chips = np.minimum((time_s * waveform.chip_rate_hz).astype(int), 2**waveform.order - 2)
        return 2.0 * mls_bits(waveform.order)[chips] - 1.0
    return np.sign(np.sin(2 * np.pi * waveform.phase_cycles(time_s)))


def rendered(waveform: Waveform, paths_s: list[list[tuple[float, float]]], n_samples: int) -> np.ndarray:
    """Return sound (n_samples, n_channels): each channel the sum of its (delay, gain) paths."""
    upsampling = 8
    wave = square_wave(waveform, upsampling * RATE_HZ)
    n_fft = 2 ** int(np.ceil(np.log2(upsampling * n_samples + len(wave))))
    frequencies_hz = np.fft.rfftfreq(n_fft, 1 / (upsampling * RATE_HZ))
    spectrum = np.where(frequencies_hz < 20000, np.fft.rfft(wave, n_fft), 0)
    channels = []
    for paths in paths_s:
        response = sum(gain * np.exp(-2j * np.pi * frequencies_hz * delay) for delay, gain in paths)
        channels.append(np.fft.irfft(spectrum * response, n_fft)[: upsampling * n_samples : upsampling])
    return np.array(channels).T


def measured_s(waveform: Waveform, sound: np.ndarray) -> np.ndarray:
    compressor = PulseCompressor(waveform, RATE_HZ, len(sound), max_tdoa_s=0.005)
    arrivals = compressor.arrivals(sound.astype(np.float32))
    assert np.isfinite(arrivals.peak_samples).all()
    lags = gcc_phat(arrivals.cut_out(), PAIRS, compressor.whitening, compressor.max_tdoa_samples)
    return lags / RATE_HZ


@pytest.mark.parametrize("waveform", [SWEEP, MLS], ids=["sweep", "mls"])
@pytest.mark.parametrize("echo", [False, True], ids=["direct alone", "strong echo"])
def test_tdoas_are_right_to_a_fraction_of_a_microsecond(waveform, echo):
    generator = np.random.default_rng(0)
    delays_s = 0.05 + generator.uniform(0.3, 1.2, 8) / 343
    echoes_s = generator.uniform(0.002, 0.006, 8)  # each channel's own, or they would cancel in the TDOAs
    paths = [
        [(delay, 1.0), *([(delay + extra, -0.8)] if echo else [])]
        for delay, extra in zip(delays_s, echoes_s, strict=True)
    ]
    sound = rendered(waveform, paths, n_samples=9600)
    sound += 0.01 * generator.standard_normal(sound.shape)
    errors_s = measured_s(waveform, sound) - (delays_s[PAIRS[:, 1]] - delays_s[PAIRS[:, 0]])
    assert np.abs(errors_s).max() < 0.5e-6


def test_the_first_path_wins_over_a_stronger_later_one():
    delays_s = 0.05 + np.linspace(0.001, 0.0028, 8)
    paths = [[(delay, 1.0), (delay + 0.003, 1.6)] for delay in delays_s]
    errors_s = measured_s(SWEEP, rendered(SWEEP, paths, 9600)) - (delays_s[PAIRS[:, 1]] - delays_s[PAIRS[:, 0]])
    assert np.abs(errors_s).max() < 2e-6


def test_noise_alone_is_not_heard():
    sound = np.random.default_rng(0).standard_normal((9600, 8)).astype(np.float32)
    arrivals = PulseCompressor(SWEEP, RATE_HZ, 9600, max_tdoa_s=0.005).arrivals(sound)
    assert np.isnan(arrivals.peak_samples).all()
    assert not arrivals.gated.any()


def test_a_silent_channel_is_not_heard():
    sound = rendered(SWEEP, [[(0.05, 1.0)], [(0.051, 0.0)]], 9600).astype(np.float32)
    arrivals = PulseCompressor(SWEEP, RATE_HZ, 9600, max_tdoa_s=0.005).arrivals(sound)
    assert np.isfinite(arrivals.peak_samples[0])
    assert np.isnan(arrivals.peak_samples[1])


@pytest.mark.parametrize("lag", [-37.25, -0.5, 0.0, 0.125, 11.9])
def test_gcc_phat_sign_and_fraction(lag):
    n_samples = 1024
    frequencies = np.fft.rfftfreq(n_samples)
    spectrum = np.fft.rfft(np.random.default_rng(2).standard_normal(n_samples) * np.hanning(n_samples) ** 2)
    spectrum[frequencies > 0.4] = 0  # a delay by a fraction needs a band limit
    later = np.fft.irfft(spectrum * np.exp(-2j * np.pi * frequencies * lag), n_samples)
    whitening = Whitening((0.02, 0.35), 1.0)
    pair = np.array([[0, 1]], dtype=np.int32)
    found = gcc_phat(np.array([np.fft.irfft(spectrum, n_samples), later]), pair, whitening, max_lag_samples=64)
    assert found[0] == pytest.approx(lag, abs=0.01)
