"""A first look at where emissions arrive, and delays by parts of a sample."""

import numpy as np
import pytest
from scipy.fft import irfft, rfft

from calib.arrivals import PulseCompressor
from calib.delay import delay_factors
from rigs.waveform import Waveform, mls_bits

RATE_HZ = 48000
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


def first_look_samples(waveform: Waveform, sound: np.ndarray) -> np.ndarray:
    """Return the peaks (n_channels,) of sound (n_samples, n_channels), a window of one emission."""
    compressor = PulseCompressor(waveform, RATE_HZ, len(sound), max_tdoa_s=0.005)
    peaks, _ = compressor.first_look(rfft(sound.T.astype(np.float32)[None], axis=2))
    return peaks[0]


@pytest.mark.parametrize("waveform", [SWEEP, MLS], ids=["sweep", "mls"])
@pytest.mark.parametrize("echo", [False, True], ids=["direct alone", "strong echo"])
def test_the_direct_path_is_found_to_two_samples(waveform, echo):
    generator = np.random.default_rng(0)
    delays_s = 0.05 + generator.uniform(0.3, 1.2, 8) / 343
    echoes_s = generator.uniform(0.002, 0.006, 8)
    paths = [
        [(delay, 1.0), *([(delay + extra, -0.8)] if echo else [])]
        for delay, extra in zip(delays_s, echoes_s, strict=True)
    ]
    sound = rendered(waveform, paths, n_samples=9600)
    sound += 0.01 * generator.standard_normal(sound.shape)
    assert np.abs(first_look_samples(waveform, sound) - delays_s * RATE_HZ).max() <= 2


def test_the_first_path_wins_over_a_stronger_later_one():
    delays_s = 0.05 + np.linspace(0.001, 0.0028, 8)
    sound = rendered(SWEEP, [[(delay, 1.0), (delay + 0.003, 1.6)] for delay in delays_s], 9600)
    assert np.abs(first_look_samples(SWEEP, sound) - delays_s * RATE_HZ).max() <= 2


def test_noise_alone_is_not_heard():
    sound = np.random.default_rng(0).standard_normal((9600, 8))
    assert np.isnan(first_look_samples(SWEEP, sound)).all()


def test_a_silent_channel_is_not_heard():
    peaks = first_look_samples(SWEEP, rendered(SWEEP, [[(0.05, 1.0)], [(0.051, 0.0)]], 9600))
    assert np.isfinite(peaks[0])
    assert np.isnan(peaks[1])


@pytest.mark.parametrize("begin", [8500, 0], ids=["at its beginning", "at its end"])
def test_an_emission_that_the_window_cuts_is_not_heard(begin):
    """Transforms are circular: what is cut off would come in at the other end."""
    sound = rendered(SWEEP, [[(0.15, 1.0)]], 19200)
    assert np.isnan(first_look_samples(SWEEP, sound[begin:][:9600])).all()


@pytest.mark.parametrize("delay", [-37.25, 0.0, 0.125, 5000.9])
def test_delays_by_parts_of_a_sample(delay):
    n_samples = 1024
    frequencies = np.fft.rfftfreq(n_samples)
    spectrum = np.where(frequencies < 0.4, rfft(np.random.default_rng(2).standard_normal(n_samples)), 0)
    found = irfft(spectrum * delay_factors(np.array([delay]), n_samples)[0], n_samples)
    expected = irfft(spectrum * np.exp(-2j * np.pi * frequencies * delay), n_samples)
    np.testing.assert_allclose(found, expected, atol=1e-5)
