"""What each buzzer really sounds like, learnt from the session itself.

A resonant piezo reshapes what its pin puts out, so the wave that a matched filter needs is the one that was heard.
Every reception of a buzzer is divided by the spectrum of what was played; that leaves the buzzer's response, late by
the time of flight, and the room. The receptions are put on top of one another and averaged, again and again: the
response adds up, echoes do not. A common delay remains in it, the same for all microphones, and does no harm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.ndimage import uniform_filter1d

from calib.arrivals import PulseCompressor
from calib.background import Background
from calib.delay import delay_factors
from calib.windows import EmissionWindows, RowArray
from rigs.waveform import Waveform

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

MAX_EMISSIONS = 12  # per buzzer: each adds a reception per channel
N_ROUNDS = 5
SEARCH_S = 0.8e-3  # how far a first look may have been off
BEFORE_S, RING_S, AFTER_S = 1.5e-3, 6e-3, 4e-3  # a response is kept that long around its peak, then fades
STRETCH_S = 0.025
DIVISION_FLOOR = 0.001  # of the neighbouring bins' power: a sequence has bins that carry next to nothing
WEAKEST_POWER = 1e-7  # of the strongest bins: below, nothing was played
SMOOTHING_BINS = 31
LEAST_POWER = 1e-30  # keeps divisions finite
# Of a bin's power: with less signal it says nothing, with more it counts whole.
LEAST_SIGNAL_SHARE, CLEAR_SIGNAL_SHARE = 0.02, 0.1


@dataclass(frozen=True)
class Response:
    """What is heard of one emission of a buzzer.

    Parameters
    ----------
    spectrum : (n_bins,) array
        Of a reception at sample 0 of a window.
    amplitudes : (n_receptions, n_channels) array
        Of the receptions it was learnt from, NaN where nothing was heard.
    """

    spectrum: ComplexArray
    amplitudes: FloatArray


class ResponseLearner:
    """Learns the responses of buzzers that all play one waveform."""

    def __init__(self, windows: EmissionWindows, waveform: Waveform, background: Background, max_tdoa_s: float) -> None:
        self._windows, self._background = windows, background
        self._compressor = PulseCompressor(waveform, windows.sample_rate_hz, windows.n_samples, max_tdoa_s)
        played = self._played = self._compressor.played
        power = np.abs(played) ** 2
        smooth = uniform_filter1d(power, SMOOTHING_BINS)
        self._division = np.conj(played) / (power + DIVISION_FLOOR * smooth + WEAKEST_POWER * smooth.max())
        self._n_stretch = next_fast_len(round(STRETCH_S * windows.sample_rate_hz), real=True) // 2 * 2
        self._n_before = self._n_stretch // 4

    def learn(self, rows: RowArray) -> Response | None:
        """Learn from the emissions (n,) of one buzzer; None where too little was heard."""
        chosen = rows[np.linspace(0, len(rows) - 1, min(len(rows), MAX_EMISSIONS)).astype(int)]
        spectra = rfft(self._windows.read(chosen).samples, axis=2)
        peaks, ratios = self._compressor.first_look(spectra)
        heard = np.isfinite(peaks)
        if heard.sum() < 2:
            return None
        share = self._signal_share(spectra)
        division = np.minimum(share / CLEAR_SIGNAL_SHARE, 1.0) * self._division
        stretches = self._stretches(irfft(spectra * division.astype(np.complex64), axis=2), peaks)
        weights = self._at_stretch_bins(share)[np.nonzero(heard)[1]] ** 2
        response, amplitudes = self._stack(stretches[heard], ratios[heard], weights.astype(np.float32))
        every = np.full(heard.shape, np.nan)
        every[heard] = amplitudes
        return Response(self._played * self._at_window_bins(response), every)

    def _signal_share(self, spectra: NDArray[np.complex64]) -> FloatArray:
        """Return how much (n_channels, n_bins) of the power is signal, not noise."""
        power = uniform_filter1d(np.mean(np.abs(spectra) ** 2, axis=0, dtype=float), SMOOTHING_BINS, axis=1)
        share = np.clip(1 - self._background.power / np.maximum(power, np.finfo(float).tiny), 0.0, 1.0)
        return np.where(share > LEAST_SIGNAL_SHARE, share, 0.0)

    def _stretches(self, pulses: NDArray[np.float32], peaks: FloatArray) -> NDArray[np.float32]:
        """Cut out (n, n_channels, n_stretch) around the peaks, `n_before` samples after the beginning of each."""
        begin = np.nan_to_num(peaks, nan=self._n_before).astype(int) - self._n_before
        places = (begin[..., None] + np.arange(self._n_stretch)) % pulses.shape[2]
        return np.take_along_axis(pulses, places, axis=2)

    def _stack(
        self, stretches: NDArray[np.float32], ratios: FloatArray, weights: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Align receptions (n, n_stretch), average them, and align them with the average, again and again."""
        spectra = np.asarray(rfft(stretches * self._gate(SEARCH_S), axis=1))
        mean, amplitudes = spectra[np.argmax(ratios)], np.ones(len(spectra), np.float32)
        response = np.zeros(self._n_stretch, np.float32)
        for _ in range(N_ROUNDS):
            delays = self._delays(spectra * np.conj(mean) * weights / _levelled(mean))
            aligned = spectra * delay_factors(-delays, self._n_stretch)
            power = np.sum(np.abs(mean) ** 2 * weights, axis=1)
            amplitudes = np.real(np.sum(aligned * np.conj(mean) * weights, axis=1)) / np.maximum(power, LEAST_POWER)
            response = irfft(
                np.einsum("n,nb", amplitudes, aligned) / np.sum(amplitudes**2), self._n_stretch
            ) * self._gate(0.0)
            mean = np.asarray(rfft(response))
        return response, amplitudes

    def _delays(self, crosses: NDArray[np.complex64]) -> FloatArray:
        """Return the delays (n,) in samples at which cross-spectra (n, n_bins) correlate best, of either sign."""
        upsampling, reach = 4, round(SEARCH_S * self._windows.sample_rate_hz)
        lags = np.arange(-reach * upsampling, reach * upsampling + 1)
        correlation = np.abs(irfft(crosses, self._n_stretch * upsampling, axis=1)[:, lags])
        peak = np.clip(np.argmax(correlation, axis=1), 1, len(lags) - 2)
        before, at, after = (correlation[np.arange(len(peak)), peak + offset] for offset in (-1, 0, 1))
        curvature = np.minimum(before - 2 * at + after, -LEAST_POWER)
        return np.asarray((lags[peak] + 0.5 * (before - after) / curvature) / upsampling)

    def _gate(self, margin_s: float) -> NDArray[np.float32]:
        """Return a window (n_stretch,) around the response."""
        time_s = (np.arange(self._n_stretch) - self._n_before) / self._windows.sample_rate_hz
        rise = np.clip((time_s + BEFORE_S + margin_s) / (BEFORE_S / 3), 0.0, 1.0)
        fall = np.clip((RING_S + AFTER_S + margin_s - time_s) / AFTER_S, 0.0, 1.0)
        return np.asarray(np.sin(np.pi / 2 * rise) ** 2 * np.sin(np.pi / 2 * fall) ** 2, dtype=np.float32)

    def _at_stretch_bins(self, values: FloatArray) -> FloatArray:
        bins = np.linspace(0, 1, self._n_stretch // 2 + 1)
        return np.array([np.interp(bins, np.linspace(0, 1, len(row)), row) for row in values])

    def _at_window_bins(self, response: NDArray[np.float32]) -> ComplexArray:
        """Return the spectrum of a response (n_stretch,) at the bins of a window, its peak at sample 0."""
        window = np.zeros(self._windows.n_samples)
        window[: self._n_stretch] = response
        return np.asarray(rfft(np.roll(window, -self._n_before)))


def _levelled(spectrum: NDArray[np.complex64]) -> NDArray[np.float32]:
    power = np.abs(spectrum) ** 2
    return np.asarray(power + 0.05 * power.max())
