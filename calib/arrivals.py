"""A first look at where emissions arrive, before anything is known of how the buzzers sound.

The emitted waveform is known, so each channel is divided by it (with a floor): 100 ms of sweep become a pulse of a few
tenths of a millisecond per path. The direct path is the first strong one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import ifft

from rigs.waveform import Waveform

FloatArray = NDArray[np.float64]

SPECTRUM_FLOOR = 0.02  # of the template's strongest bin
FIRST_PEAK_SHARE = 0.5  # a path this strong, of the strongest, may be the direct one
MIN_PEAK_RATIO = 6.0  # of the peak over the pulse's root mean square elsewhere: chance gives about 4.5
MARGIN_BEFORE_S, MARGIN_AFTER_S = 0.5e-3, 1.0e-3  # from the window's ends
SAMPLES_PER_POINT = 2  # of an envelope: it has no negative frequencies, so half the points hold it


class PulseCompressor:
    """Finds the direct paths of emissions in the spectra of their windows.

    Parameters
    ----------
    waveform : Waveform
    sample_rate_hz : float
    n_samples : int
        Length of a window, even.
    max_tdoa_s : float
        So long before the strongest path the direct one may come.

    Attributes
    ----------
    played : (n_samples // 2 + 1,) array
        Spectrum of the waveform.
    """

    def __init__(self, waveform: Waveform, sample_rate_hz: float, n_samples: int, max_tdoa_s: float) -> None:
        self.played = waveform.spectrum(n_samples, sample_rate_hz)
        self._n_points = n_samples // SAMPLES_PER_POINT
        self._reach = round(max_tdoa_s * sample_rate_hz / SAMPLES_PER_POINT)
        n_played = round(waveform.duration_s * sample_rate_hz)
        self._begin = MARGIN_BEFORE_S * sample_rate_hz
        self._end = n_samples - n_played - MARGIN_AFTER_S * sample_rate_hz
        spectrum = self.played[: self._n_points]
        frequencies_hz = np.asarray(sample_rate_hz / n_samples * np.arange(self._n_points), dtype=float)
        power = np.abs(spectrum) ** 2
        inverse = _soft_band(frequencies_hz, _usable_band_hz(waveform)) * np.conj(spectrum)
        self._inverse = (inverse / (power + SPECTRUM_FLOOR * power.max())).astype(np.complex64)

    def first_look(self, spectra: NDArray[np.complex64]) -> tuple[FloatArray, FloatArray]:
        """Find the direct paths in windows with spectra (n, n_channels, n_bins).

        Returns
        -------
        peak_samples : (n, n_channels) array
            Where each pulse peaks, in samples of the window, to two samples; NaN where nothing was heard.
        peak_ratio : (n, n_channels) array
            Peak over the root mean square of the rest.
        """
        envelopes = np.abs(ifft(spectra[..., : self._n_points] * self._inverse, axis=2))
        points, ratios = self._first_strong_peaks(envelopes)
        peaks = float(SAMPLES_PER_POINT) * points
        # an emission that the window cuts off may have begun earlier
        heard = (ratios > MIN_PEAK_RATIO) & (peaks >= self._begin) & (peaks <= self._end)
        return np.where(heard, peaks, np.nan), ratios

    def _first_strong_peaks(self, envelopes: NDArray[np.float32]) -> tuple[NDArray[np.intp], FloatArray]:
        strongest = np.argmax(envelopes, axis=2)
        heights = np.take_along_axis(envelopes, strongest[..., None], axis=2)
        places = np.clip(strongest[..., None] + np.arange(-self._reach - 1, 2), 0, envelopes.shape[2] - 1)
        near = np.take_along_axis(envelopes, places, axis=2)
        middle = near[..., 1:-1]
        rises = (middle > FIRST_PEAK_SHARE * heights) & (middle >= near[..., :-2]) & (middle > near[..., 2:])
        rises[..., -1] = True  # if nothing else, the strongest
        first = np.take_along_axis(places[..., 1:-1], np.argmax(rises, axis=2)[..., None], axis=2)
        height = np.take_along_axis(envelopes, first, axis=2)[..., 0]
        noise = np.sqrt(np.mean(envelopes**2, axis=2))
        return first[..., 0], height / np.maximum(noise, np.finfo(np.float32).tiny)


def _usable_band_hz(waveform: Waveform) -> tuple[float, float]:
    low_hz, high_hz = waveform.band_hz()
    if waveform.kind == "mls":  # a piezo is deaf at the bottom, and chips carry little near their rate
        return 0.06 * high_hz, 0.9 * high_hz
    if waveform.kind == "tone":
        return 0.8 * low_hz, 1.2 * high_hz
    return low_hz, high_hz


def _soft_band(frequencies_hz: FloatArray, band_hz: tuple[float, float]) -> FloatArray:
    """Weights that rise and fall over a tenth of the band, so that the pulse does not ring."""
    edge_hz = 0.1 * (band_hz[1] - band_hz[0])
    rise = np.clip((frequencies_hz - band_hz[0] + edge_hz / 2) / edge_hz, 0.0, 1.0)
    fall = np.clip((band_hz[1] + edge_hz / 2 - frequencies_hz) / edge_hz, 0.0, 1.0)
    return np.asarray(np.sin(np.pi / 2 * rise) ** 2 * np.sin(np.pi / 2 * fall) ** 2)
