"""What the microphones hear while no buzzer sounds: noise and hum, channel by channel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft
from scipy.ndimage import uniform_filter1d

from calib.windows import EmissionWindows, RowArray

FloatArray = NDArray[np.float64]

MAX_WINDOWS = 64
SMOOTHING_BINS = 5
TWIN_CORRELATION = 0.9999
MAINS_HZ, N_HARMONICS = (50.0, 60.0), 6
HUM_WINDOWS, HUM_SHARE, HUM_CONTRAST = 16, 0.5, 10.0
LEAST_POWER = 1e-18  # of full scale; keeps divisions finite on digital silence


@dataclass(frozen=True)
class Background:
    """Noise of each channel before the emissions.

    Parameters
    ----------
    power : (n_channels, n_bins) array
        Mean square of a window's spectrum, at the bins of a whole window.
    rms : (n_channels,) array
        Of the samples, full scale = 1.
    correlation : (n_channels, n_channels) array
        Between the channels' noise.
    humming : (n_channels,) bool array
        Where the mains makes most of the noise.
    """

    power: FloatArray
    rms: FloatArray
    correlation: FloatArray
    humming: NDArray[np.bool_]

    def twins(self) -> list[tuple[int, int]]:
        """Return pairs of columns that carry the same noise: one is a copy of the other."""
        found = np.argwhere(np.triu(np.abs(self.correlation) > TWIN_CORRELATION, k=1))
        return [(int(first), int(second)) for first, second in found]


def listen(windows: EmissionWindows, rows: RowArray) -> Background:
    """Measure the noise in the quiet beginning of the windows of some emissions (n,), blind to a few loud ones."""
    chosen = rows[np.linspace(0, len(rows) - 1, min(len(rows), MAX_WINDOWS)).astype(int)]
    quiet = windows.read(chosen, windows.n_quiet).samples
    taper = np.hanning(windows.n_quiet).astype(np.float32)
    periodograms = np.abs(rfft(quiet * taper, axis=2)) ** 2 / float(np.sum(taper**2))
    power = np.median(periodograms, axis=0) / _median_of_mean(len(chosen))
    power = uniform_filter1d(power, SMOOTHING_BINS, axis=1)
    bins = np.linspace(0, 1, windows.n_samples // 2 + 1)
    power = np.array([np.interp(bins, np.linspace(0, 1, power.shape[1]), row) for row in power]) * windows.n_samples
    centred = quiet - quiet.mean(axis=2, keepdims=True)
    covariance = np.median(centred @ centred.transpose(0, 2, 1), axis=0) / windows.n_quiet
    rms = np.sqrt(np.diag(covariance))
    scale = np.maximum(np.outer(rms, rms), np.finfo(float).tiny)
    humming = _mains_power(windows, chosen[:: len(chosen) // HUM_WINDOWS + 1]) > HUM_SHARE * rms**2
    return Background(np.maximum(power, LEAST_POWER * windows.n_samples), rms, covariance / scale, humming)


def _mains_power(windows: EmissionWindows, rows: RowArray) -> FloatArray:
    """Return the mean square (n_channels,) of what stands out at the harmonics of 50 or of 60 Hz."""
    samples = windows.read(rows).samples
    taper = np.hanning(windows.n_samples).astype(np.float32)
    power = np.median(np.abs(rfft(samples * taper, axis=2)) ** 2, axis=0)
    power *= 2 / (windows.n_samples * float(np.sum(taper**2)))
    bin_hz = windows.sample_rate_hz / windows.n_samples
    totals = []
    for mains_hz in MAINS_HZ:
        lines = np.rint(mains_hz * np.arange(1, N_HARMONICS + 1) / bin_hz).astype(int)
        beside = np.rint(mains_hz * (np.arange(1, N_HARMONICS + 1) + 0.5) / bin_hz).astype(int)
        near = np.arange(-2, 3)
        line, rest = (power[:, (places[:, None] + near)].sum(axis=2) for places in (lines, beside))
        totals.append(np.sum(np.where(line > HUM_CONTRAST * rest, line, 0.0), axis=1))
    return np.asarray(np.max(totals, axis=0))


def _median_of_mean(n: int) -> float:
    """Return the expected median of n exponential values of mean one: ln 2 and a little for few of them."""
    order = np.arange((n + 1) // 2, n + 1) if n % 2 else np.arange(n // 2 + 1, n + 1)
    expected = float(np.sum(1 / order))
    return expected if n % 2 else expected + 1 / n
