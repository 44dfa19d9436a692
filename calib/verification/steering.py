"""A steered-response map: how loud an emission is from each direction of the picture, by the calibrated array.

All pairs of channels are correlated with levelled spectra (SRP-PHAT; J. DiBiase, H. Silverman and M. Brandstein in
"Microphone Arrays", Springer 2001, doi:10.1007/978-3-662-04619-7_8), within the band that was played. Each point of the
picture is looked at along its ray, at one distance from the camera.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from calib.gcc import MAGNITUDE_FLOOR
from rigs.board import camera_matrix
from rigs.description import Intrinsics

FloatArray = NDArray[np.float64]

UPSAMPLING = 4  # between these the correlation is interpolated linearly
CONVERTER_END = 0.45  # of the sample rate
GRID_STEP = 1 / 160  # of the picture's width
REFINEMENTS, SHRINK, HALF = 5, 4.0, 4  # finer and finer grids of 9 x 9 points around the highest


@dataclass(frozen=True)
class ResponseMap:
    """Power over the picture.

    Parameters
    ----------
    power : (n_rows, n_columns) array of bytes
        255 at the highest, on a grid that covers the picture; where it is below 0, 0.
    peak_px : (2,) array
        Where it is highest, to a fraction of a pixel.
    """

    power: NDArray[np.uint8]
    peak_px: FloatArray


class SteeredResponse:
    """Steers an array over a picture.

    Parameters
    ----------
    microphones_m : (n_mics, 3) array
        Camera frame, in the order of the channels of the samples.
    intrinsics : Intrinsics
    size_px : (int, int)
    band_hz : (float, float)
        Which frequencies were played.
    sample_rate_hz : float
    speed_m_s : float
    """

    def __init__(
        self,
        microphones_m: FloatArray,
        intrinsics: Intrinsics,
        size_px: tuple[int, int],
        band_hz: tuple[float, float],
        sample_rate_hz: float,
        speed_m_s: float,
    ) -> None:
        self._microphones_m, self._intrinsics = microphones_m, intrinsics
        self._size_px, self._band_hz = size_px, band_hz
        self._rate_hz, self._speed_m_s = sample_rate_hz, speed_m_s
        self._pairs = np.array(list(combinations(range(len(microphones_m)), 2)))
        self._step_px = max(1.0, GRID_STEP * size_px[0])
        columns, rows = (np.arange(self._step_px / 2, size, self._step_px) for size in size_px)
        self._shape = (len(rows), len(columns))
        self._grid_px = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
        self._rays = self._rays_of(self._grid_px)

    def map(self, samples: NDArray[np.float32], distance_m: float) -> ResponseMap:
        """Map an emission.

        Parameters
        ----------
        samples : (n_mics, n_samples) array
            The sound around it.
        distance_m : float
            From the camera.
        """
        correlations = self._correlations(samples)
        power = self._power(correlations, distance_m * self._rays)
        peak_px = self._grid_px[int(np.argmax(power))]
        step_px = self._step_px
        for _ in range(REFINEMENTS):
            step_px /= SHRINK
            offsets_px = np.stack(np.meshgrid(*[np.arange(-HALF, HALF + 1)] * 2), axis=-1).reshape(-1, 2) * step_px
            around_px = peak_px + offsets_px
            peak_px = around_px[int(np.argmax(self._power(correlations, distance_m * self._rays_of(around_px))))]
        highest = max(float(power.max()), 1e-30)
        shares = np.clip(power / highest, 0.0, 1.0).reshape(self._shape)
        return ResponseMap((255 * shares).round().astype(np.uint8), peak_px)

    def _correlations(self, samples: NDArray[np.float32]) -> FloatArray:
        """Return the correlation of each pair (n_pairs, n_lags), lag zero first; positive where the second is later."""
        n_fft = next_fast_len(samples.shape[1], real=True)
        spectra = rfft(samples.astype(float), n=n_fft, axis=1)
        frequencies_hz = np.fft.rfftfreq(n_fft, 1 / self._rate_hz)
        low_hz, high_hz = self._band_hz
        inside = (frequencies_hz >= low_hz) & (frequencies_hz <= min(high_hz, CONVERTER_END * self._rate_hz))
        magnitude = np.abs(spectra) * inside
        floor = np.maximum(MAGNITUDE_FLOOR * magnitude.max(axis=1, keepdims=True), 1e-30)
        levelled = np.where(inside, spectra / np.maximum(np.abs(spectra), floor), 0.0)
        crosses = levelled[self._pairs[:, 1]] * np.conj(levelled[self._pairs[:, 0]])
        return np.asarray(irfft(crosses, n=n_fft * UPSAMPLING, axis=1))

    def _power(self, correlations: FloatArray, places_m: FloatArray) -> FloatArray:
        """Sum the correlations at the lags that sound from places (n, 3) has."""
        flights_s = np.linalg.norm(self._microphones_m - places_m[:, None], axis=2) / self._speed_m_s
        lags = (flights_s[:, self._pairs[:, 1]] - flights_s[:, self._pairs[:, 0]]) * self._rate_hz * UPSAMPLING
        whole = np.floor(lags).astype(int)
        part, n_lags = lags - whole, correlations.shape[1]
        rows = np.arange(len(self._pairs))
        here, next_one = correlations[rows, whole % n_lags], correlations[rows, (whole + 1) % n_lags]
        return np.asarray(((1 - part) * here + part * next_one).sum(axis=1))

    def _rays_of(self, pixels: FloatArray) -> FloatArray:
        """Return unit vectors (n, 3) along the rays of pixels (n, 2)."""
        matrix, distortion = camera_matrix(self._intrinsics), np.array(self._intrinsics.distortion)
        slopes = cv2.undistortPoints(pixels.reshape(-1, 1, 2), matrix, distortion).reshape(-1, 2)
        rays = np.column_stack([slopes, np.ones(len(slopes))])
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True), dtype=float)
