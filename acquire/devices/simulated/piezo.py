"""The buzzer's piezo disc: what it makes of an edge of its voltage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquire.devices.simulated.draws import draws

_RESONANCE_HZ = np.array([2700.0, 4000.0, 6800.0])
_QUALITY = np.array([6.0, 5.0, 1.5])
_STRENGTH = np.array([1.0, 0.8, 0.9])
RING_S = 0.02  # by then every resonance has died away


@dataclass(frozen=True)
class Piezo:
    """A sum of resonances; each edge of the voltage rings them, exp(-pi f t / Q) sin(2 pi f t).

    Parameters
    ----------
    resonance_hz, quality, strength : (n_resonances,) arrays
    """

    resonance_hz: NDArray[np.float64]
    quality: NDArray[np.float64]
    strength: NDArray[np.float64]

    def response(self, frequency_hz: NDArray[np.float64]) -> NDArray[np.complex128]:
        """Return the sound pressure (n,) per unit edge, at frequencies (n,)."""
        angular = 2 * np.pi * self.resonance_hz[:, None]
        damped = angular / (2 * self.quality[:, None]) + 2j * np.pi * frequency_hz
        return np.asarray((self.strength[:, None] * angular / (damped**2 + angular**2)).sum(axis=0))


def nominal_piezo() -> Piezo:
    """Return the piezo of the data sheet."""
    return Piezo(_RESONANCE_HZ, _QUALITY, _STRENGTH)


def draw_piezo(seed: int, buzzer: int) -> Piezo:
    """Return the piezo of one buzzer: no two are alike."""
    rng = draws(seed, "piezo", buzzer)
    spread = 1 + np.array([[0.03], [0.15], [0.1]]) * rng.standard_normal((3, len(_RESONANCE_HZ))).clip(-2, 2)
    return Piezo(_RESONANCE_HZ * spread[0], _QUALITY * spread[1], _STRENGTH * spread[2])
