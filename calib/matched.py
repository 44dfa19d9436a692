"""Arrival times at the physical limit: a filter matched to what each buzzer really sounds like.

With S the spectrum of a reception as learnt, N the power of the noise and rho the share of echo over direct sound, the
channel is filtered by

    F = S* / (N / A^2 + rho |S|^2)

where A is the channel's usual amplitude. Echo has the spectrum of the sound itself, so rho says where resolution is
worth more than noise: without echo F is the matched filter, whose peak is the maximum-likelihood estimate; with much of
it F divides by S and leaves short pulses that echoes cannot pull at. The direct sound comes out as a pulse symmetrical
in time (S F is real), so its peak is where it arrived, whatever the buzzer's response.

The variance of that peak's place is the noise's slope over the pulse's curvature,

    var = sum(|F|^2 N w^2) / (2 (A sum(S F w^2))^2)

which is the Cramer-Rao bound where rho = 0 (C. Knapp and G. Carter, doi:10.1109/TASSP.1976.1162830).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from warnings import catch_warnings, simplefilter

import numpy as np
from numpy.typing import NDArray
from scipy.fft import ifft, irfft, rfft

from calib.background import Background
from calib.delay import delay_factors
from calib.peaks import first_strong_peaks, refine_peaks
from calib.windows import EmissionWindows, Sound

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

MAX_ECHO_SHARE = 0.5
PRE_S, PRE_END_S = 0.025, 0.001  # before the direct sound: noise alone, and the pulse's own foothills
CORE_S = 0.25e-3
UPSAMPLING = 16
SMOOTHING_BINS = 31
FINE_HALF_SAMPLES = 256
TEMPLATE_ERROR = 0.02  # of the pulse's height: the same in all channels, so it moves none against another
USUAL_MISFIT = 1.5
CONVERTER_FLAT, CONVERTER_END = 0.42, 0.45  # of the sample rate
CLEAR_HEIGHT = 8.0
MARGIN_S = 0.5e-3  # from the window's ends


@dataclass(frozen=True)
class Peaks:
    """Direct sounds of some emissions, a value per emission and channel: all arrays are (n, n_channels).

    Parameters
    ----------
    place_samples : array
        Since the beginning of the window.
    std_samples : array
        Of the place, from noise as it was just before the sound, and from how well the pulse fits.
    amplitude : array
        Against the buzzer's usual reception; negative where the polarity is inverted.
    height : array
        Of the peak over the noise's standard deviation.
    disturbance : array
        Noise before the sound over the session's usual noise, as a ratio of standard deviations.
    misfit : array
        Root mean square of what the pulse leaves around its peak, over what noise and an imperfect template leave.
    second : array
        The highest envelope elsewhere over the direct sound's.
    second_samples : array
        How much later it is.
    echo : array
        Energy of all that was heard, noise apart, over that of the direct sound.
    """

    place_samples: FloatArray
    std_samples: FloatArray
    amplitude: FloatArray
    height: FloatArray
    disturbance: FloatArray
    misfit: FloatArray
    second: FloatArray
    second_samples: FloatArray
    echo: FloatArray


class MatchedFilter:
    """Finds the direct sound of one buzzer in every channel.

    Parameters
    ----------
    spectrum : (n_bins,) array
        Of a reception at sample 0 of a window.
    amplitudes : (n_channels,) array
        Usual ones of the channels.
    background : Background
    echo_share : float
        Power of echo over that of the direct sound.
    windows : EmissionWindows
    max_tdoa_samples : float
    """

    def __init__(
        self,
        spectrum: ComplexArray,
        amplitudes: FloatArray,
        background: Background,
        echo_share: float,
        windows: EmissionWindows,
        max_tdoa_samples: float,
    ) -> None:
        self._spectrum, self._noise = spectrum, background.power
        self._n = windows.n_samples
        self._rate_hz = windows.sample_rate_hz
        self._max_tdoa_samples = round(max_tdoa_samples)
        self._last_sample = windows.n_samples - windows.n_played - round(MARGIN_S * self._rate_hz)
        share = min(echo_share, MAX_ECHO_SHARE)
        power = np.abs(spectrum) ** 2
        self._filter = np.conj(spectrum) / (self._noise / amplitudes[:, None] ** 2 + share * power + 1e-300)
        self._filter *= _converter_band(len(spectrum))
        self._filter *= 1 / np.sqrt(np.mean(np.abs(self._filter) ** 2 * self._noise, axis=1, keepdims=True))
        self._pulse_spectrum = np.real(spectrum * self._filter)
        self._angular = 2 * np.pi * np.arange(len(spectrum)) / self._n

    @cached_property
    def pulses(self) -> FloatArray:
        """What one direct sound of amplitude 1 becomes (n_channels, n_samples), its peak at sample 0."""
        return np.asarray(irfft(self._pulse_spectrum, self._n, axis=1))

    @cached_property
    def noise_rms(self) -> FloatArray:
        """Standard deviation (n_channels,) of the filtered noise."""
        return np.asarray(np.sqrt(2 * np.sum(np.abs(self._filter) ** 2 * self._noise, axis=1)) / self._n)

    @cached_property
    def std_at_amplitude_1(self) -> FloatArray:
        """Standard deviation (n_channels,) in samples of an arrival of amplitude 1 in the session's usual noise."""
        slope = np.sum(np.abs(self._filter) ** 2 * self._noise * self._angular**2, axis=1)
        curvature = np.sum(self._pulse_spectrum * self._angular**2, axis=1)
        return np.asarray(np.sqrt(slope / 2) / curvature)

    @cached_property
    def lobe(self) -> FloatArray:
        """How high (n_channels,) the pulse's next swing is, of either sign, over its peak: 1 is a tone."""
        heights = np.abs(self.pulses[:, : self._n // 2]) / np.maximum(self.pulses[:, :1], 1e-300)
        falls = np.diff(heights, axis=1) < 0
        valley = np.argmin(falls, axis=1)  # the first sample from which it rises again
        later = np.arange(heights.shape[1]) >= valley[:, None]
        return np.asarray(np.max(np.where(later, heights, 0.0), axis=1))

    def filtered(self, spectra: NDArray[np.complex64]) -> NDArray[np.complex64]:
        """Filter spectra (n, n_channels, n_bins) and return the analytic signals (n, n_channels, n_samples)."""
        return np.asarray(ifft(spectra * self._analytic_filter, self._n, axis=2, overwrite_x=True))

    def peaks(self, sound: Sound) -> Peaks:
        """Find the direct sounds."""
        return self._peaks(rfft(sound.samples, axis=2))

    def echo_share(self, sound: Sound) -> FloatArray:
        """Measure the power (n, n_channels) that comes with the direct sound, over its own; NaN where unheard."""
        spectra = rfft(sound.samples, axis=2)
        peaks = self._peaks(spectra)
        direct = self._spectrum.astype(np.complex64) * delay_factors(peaks.place_samples, self._n)
        likeness = np.einsum("ncb,ncb->nc", spectra, np.conj(direct)).real
        direct *= (likeness / np.einsum("ncb,ncb->nc", direct, np.conj(direct)).real)[..., None]
        noise, power = _band_means(self._noise), _band_means(np.abs(direct) ** 2)
        rest = _band_means(np.abs(spectra - direct) ** 2) - noise
        clear = (power > 0.3 * noise) & (peaks.height > CLEAR_HEIGHT)[..., None]
        share = np.where(clear, rest / np.where(clear, power, 1.0), np.nan)
        with catch_warnings():
            simplefilter("ignore", RuntimeWarning)  # of channels that heard nothing
            return np.asarray(np.nanmedian(share, axis=2))

    def _peaks(self, spectra: NDArray[np.complex64]) -> Peaks:
        signal = self.filtered(spectra)
        envelope = np.abs(signal)
        first, second, second_lag = first_strong_peaks(
            envelope[:, :, : self._last_sample], self._foothills, self._max_tdoa_samples, self.noise_rms
        )
        place, value = refine_peaks(signal.real, first)
        amplitude = value / np.maximum(self.pulses[:, 0], 1e-300)
        disturbance = self._disturbance(signal.real, first, amplitude)
        misfit = self._misfit(signal.real, place, amplitude, disturbance)
        std = self.std_at_amplitude_1 / np.maximum(np.abs(amplitude), 1e-12) * disturbance
        std *= np.maximum(misfit / USUAL_MISFIT, 1.0)
        height = np.abs(value) / np.maximum(self.noise_rms * disturbance, 1e-300)
        echo = self._echo(envelope, amplitude)
        return Peaks(place, std, amplitude, height, disturbance, misfit, second, second_lag, echo)

    @cached_property
    def _analytic_filter(self) -> NDArray[np.complex64]:
        return (2 * self._filter).astype(np.complex64)

    @cached_property
    def _fine_pulses(self) -> FloatArray:
        """The middle of the pulses, upsampled (n_channels, n), the peak at sample 0."""
        half = np.arange(-FINE_HALF_SAMPLES, FINE_HALF_SAMPLES)
        middle = np.fft.ifftshift(self.pulses[:, half], axes=1)
        return np.asarray(irfft(rfft(middle, axis=1), UPSAMPLING * len(half), axis=1) * UPSAMPLING)

    @cached_property
    def _foothills(self) -> FloatArray:
        """How high (n_channels, max_tdoa + 1) the pulse's own envelope is so many samples before its peak."""
        spectrum = np.zeros((len(self._pulse_spectrum), self._n), dtype=complex)
        spectrum[:, : self._n // 2 + 1] = 2 * self._pulse_spectrum
        envelope = np.abs(ifft(spectrum, axis=1))
        return np.asarray(envelope[:, : self._max_tdoa_samples + 1] / np.maximum(envelope[:, :1], 1e-300))

    @cached_property
    def _power(self) -> FloatArray:
        """Mean square (n_channels,) of the pulses."""
        return np.asarray(np.mean(self.pulses**2, axis=1))

    @cached_property
    def _power_before(self) -> FloatArray:
        """Mean square (n_channels,) of the pulses just before their peaks."""
        return np.asarray(np.mean(self.pulses[:, self._before] ** 2, axis=1))

    @cached_property
    def _before(self) -> NDArray[np.intp]:
        return np.arange(-round(PRE_S * self._rate_hz), -round(PRE_END_S * self._rate_hz))

    def _disturbance(self, real: NDArray[np.float32], first: NDArray[np.intp], amplitude: FloatArray) -> FloatArray:
        before = np.take_along_axis(real, np.maximum(first[..., None] + self._before, 0), axis=2)
        usual = self._power_before * amplitude**2 + self.noise_rms**2
        return np.asarray(np.sqrt(_mean_squares(before) / np.maximum(usual, 1e-300)))

    def _echo(self, envelope: NDArray[np.float32], amplitude: FloatArray) -> FloatArray:
        heard = _mean_squares(envelope) / 2 - self.noise_rms**2
        return np.asarray(np.maximum(heard, 0.0) / np.maximum(self._power * amplitude**2, 1e-300))

    def _misfit(
        self, real: NDArray[np.float32], place: FloatArray, amplitude: FloatArray, disturbance: FloatArray
    ) -> FloatArray:
        """Compare the surroundings of each peak with the pulse."""
        half = round(CORE_S * self._rate_hz)
        whole = np.rint(place).astype(int)
        lags = np.arange(-half, half + 1)
        around = np.take_along_axis(real, np.clip(whole[..., None] + lags, 0, self._n - 1), axis=2)
        exact = (whole - place)[..., None] * UPSAMPLING
        below = np.floor(exact).astype(int)
        columns, at = np.arange(len(self._fine_pulses))[None, :, None], lags * UPSAMPLING + below
        lower, upper = self._fine_pulses[columns, at], self._fine_pulses[columns, at + 1]
        pulse = lower + (exact - below) * (upper - lower)
        rest = np.mean((around - amplitude[..., None] * pulse) ** 2, axis=2)
        allowed = (self.noise_rms * disturbance) ** 2 + (TEMPLATE_ERROR * amplitude * self.pulses[:, 0]) ** 2
        return np.asarray(np.sqrt(rest / np.maximum(allowed, 1e-300)))


def _mean_squares(values: NDArray[np.float32]) -> FloatArray:
    return np.asarray(np.einsum("ncs,ncs->nc", values, values) / values.shape[2], dtype=float)


def _band_means(power: NDArray[np.floating]) -> FloatArray:
    """Average (..., n_bins) over neighbouring bins, to (..., n_bands)."""
    n_bands = power.shape[-1] // SMOOTHING_BINS
    bands = power[..., : n_bands * SMOOTHING_BINS].reshape(*power.shape[:-1], n_bands, SMOOTHING_BINS)
    return np.asarray(bands.mean(axis=-1), dtype=float)


def _converter_band(n_bins: int) -> FloatArray:
    """Return weights (n_bins,) without the top of the band, where a converter's filter lets mirror images through."""
    share = 0.5 * np.arange(n_bins) / (n_bins - 1)
    return np.asarray(np.clip((CONVERTER_END - share) / (CONVERTER_END - CONVERTER_FLAT), 0.0, 1.0))
