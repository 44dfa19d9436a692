"""The room: echoes of a sound at each microphone."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from acquire.devices.simulated.impulses import HALF_WIDTH_SAMPLES, band_limited_impulses

FloatArray = NDArray[np.float64]
_MIXING_S = 0.03  # until then every echo is a mirror image, later the echoes are too dense to tell apart
_NEPER_60_DB = 6 * np.log(10)  # a fall of energy by 60 dB


@dataclass(frozen=True)
class Room:
    """A box with walls that all reflect alike.

    Parameters
    ----------
    size_m : (3,) array
        One corner is the origin.
    rt60_s : float
        Time in which the echo falls by 60 dB; 0: no echo.
    speed_of_sound_m_s : float
    """

    size_m: FloatArray
    rt60_s: float
    speed_of_sound_m_s: float

    def impulse_responses(
        self, source_m: FloatArray, receivers_m: FloatArray, sample_rate_hz: float, rng: np.random.Generator
    ) -> FloatArray:
        """Return the sound of an impulse of height 1 (at 1 m) at each receiver.

        Mirror images until the echoes mix (J. Allen and D. Berkley, JASA 65 (1979) 943, doi:10.1121/1.382599), then
        Gaussian noise whose energy goes on as theirs: 4 pi c / V, falling by 60 dB in `rt60_s`.

        Parameters
        ----------
        source_m : (3,) array
            In the room's frame.
        receivers_m : (n_receivers, 3) array
        sample_rate_hz : float
        rng : numpy.random.Generator
            Draws the diffuse echo.

        Returns
        -------
        (n_receivers, n_samples) array; time zero is sample HALF_WIDTH_SAMPLES.
        """
        images_m, strength = self._images(source_m)
        distance_m = np.linalg.norm(receivers_m[:, None] - images_m, axis=2)
        distance_m = np.maximum(distance_m, 0.02)
        rate_per_m = sample_rate_hz / self.speed_of_sound_m_s
        mixing_samples = max(_MIXING_S * sample_rate_hz, distance_m[:, 0].max() * rate_per_m)
        arrival_samples = distance_m * rate_per_m
        position = np.where(arrival_samples <= mixing_samples, arrival_samples + HALF_WIDTH_SAMPLES, -1.0)
        n_samples = int(mixing_samples + self.rt60_s * sample_rate_hz) + 2 * HALF_WIDTH_SAMPLES + 2
        response = band_limited_impulses(position, strength / distance_m, n_samples)
        if self.rt60_s > 0:
            first = int(mixing_samples) + HALF_WIDTH_SAMPLES
            response[:, first:] += self._diffuse(n_samples, sample_rate_hz, len(receivers_m), rng)[:, first:]
        return response

    def _images(self, source_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the mirror images (n, 3) of a source and their strengths (n,); the source itself is the first."""
        if self.rt60_s == 0:
            return source_m[None], np.ones(1)
        reach = np.ceil(_MIXING_S * self.speed_of_sound_m_s / (2 * self.size_m)).astype(int) + 1
        mirrored = np.array(list(product((0, 1), repeat=3)))
        shifts = np.array(list(product(*(range(-n, n + 1) for n in reach))))
        images_m = (1 - 2 * mirrored[None]) * source_m + 2 * shifts[:, None] * self.size_m
        reflections = np.abs(2 * shifts[:, None] - mirrored[None]).sum(axis=2).ravel()
        order = np.argsort(reflections, kind="stable")
        return images_m.reshape(-1, 3)[order], self._reflection() ** reflections[order]

    def _reflection(self) -> float:
        """Return how much of the pressure a wall gives back (Eyring's formula, solved for it)."""
        x, y, z = self.size_m
        mean_free_path_m = 4 * x * y * z / (2 * (x * y + y * z + z * x))
        return float(np.exp(-_NEPER_60_DB / 2 * mean_free_path_m / (self.speed_of_sound_m_s * self.rt60_s)))

    def _diffuse(self, n_samples: int, sample_rate_hz: float, n_receivers: int, rng: np.random.Generator) -> FloatArray:
        time_s = (np.arange(n_samples) - HALF_WIDTH_SAMPLES) / sample_rate_hz
        energy_per_s = 4 * np.pi * self.speed_of_sound_m_s / np.prod(self.size_m)
        energy = energy_per_s / sample_rate_hz * np.exp(-_NEPER_60_DB * time_s / self.rt60_s)
        return np.asarray(np.sqrt(energy) * rng.standard_normal((n_receivers, n_samples), dtype=np.float32))
