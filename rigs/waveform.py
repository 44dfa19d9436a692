"""What a buzzer plays: square waves whose phase law, or whose bits, are known to firmware and host alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

# Feedback taps of maximal-length shift registers, by order (Golomb, Shift Register Sequences).
_MLS_TAPS = {7: (7, 6), 8: (8, 6, 5, 4), 9: (9, 5), 10: (10, 7), 11: (11, 9), 12: (12, 11, 10, 4), 13: (13, 12, 11, 8)}


@dataclass(frozen=True)
class Waveform:
    """One emission of a buzzer, a wave of two levels.

    Parameters
    ----------
    kind : {"sweep", "mls", "tone"}
        Linear sweep, maximum-length sequence, or steady tone.
    duration_s : float
        Length of the emission.
    start_hz, stop_hz : float
        Frequency at the first and at the last moment (equal for a tone); for an MLS the band 0 to half the chip rate.
    order : int
        Order of the shift register (MLS only, else 0).
    chip_rate_hz : float
        Bits a second (MLS only, else 0).
    """

    kind: Literal["sweep", "mls", "tone"]
    duration_s: float
    start_hz: float
    stop_hz: float
    order: int = 0
    chip_rate_hz: float = 0.0

    def label(self) -> str:
        """Return a short name that tells waveforms apart, as stored with each emission."""
        if self.kind == "mls":
            return f"mls order {self.order} {self.chip_rate_hz:g} Hz"
        return f"{self.kind} {self.start_hz:g}-{self.stop_hz:g} Hz {self.duration_s:g} s"

    def phase_cycles(self, time_s: FloatArray) -> FloatArray:
        """Return the phase in cycles at times since the start (sweep and tone), same shape as `time_s`."""
        rate = (self.stop_hz - self.start_hz) / self.duration_s
        return self.start_hz * time_s + 0.5 * rate * time_s**2

    def sampled(self, sample_rate_hz: float) -> FloatArray:
        """Return the wave (n_samples,) as a template for a matched filter, without aliases for sweeps and tones.

        A square wave is the sum of its odd harmonics; those above 0.45 of the sample rate are left out.
        """
        time_s = np.arange(round(self.duration_s * sample_rate_hz)) / sample_rate_hz
        if self.kind == "mls":
            chips = np.minimum((time_s * self.chip_rate_hz).astype(int), 2**self.order - 2)
            return np.asarray(2.0 * mls_bits(self.order)[chips] - 1.0)
        frequency_hz = self.start_hz + (self.stop_hz - self.start_hz) * time_s / self.duration_s
        phase = 2 * np.pi * self.phase_cycles(time_s)
        wave = np.zeros_like(time_s)
        for harmonic in range(1, int(0.45 * sample_rate_hz / min(self.start_hz, self.stop_hz)) + 1, 2):
            wave += np.where(harmonic * frequency_hz < 0.45 * sample_rate_hz, np.sin(harmonic * phase) / harmonic, 0.0)
        return np.asarray(4 / np.pi * wave)

    def edges(self) -> tuple[FloatArray, FloatArray]:
        """Return when the wave changes level and by how much; it rests low before and after.

        Returns
        -------
        time_s : (n_edges,) array
            Since the start.
        step : (n_edges,) array
            +1 where the level rises, -1 where it falls.
        """
        time_s = self._chip_edges_s() if self.kind == "mls" else self._half_periods_s()
        if len(time_s) % 2:
            time_s = np.append(time_s, self.duration_s)
        return time_s, np.where(np.arange(len(time_s)) % 2 == 0, 1.0, -1.0)

    def spectrum(self, n_samples: int, sample_rate_hz: float) -> NDArray[np.complex128]:
        """Return the discrete spectrum (n_samples // 2 + 1,) of the wave, made of its edges: free of aliases.

        An edge of height h at time t adds h exp(-2 pi i f t) / (2 pi i f); there is nothing at zero frequency.
        """
        time_s, step = self.edges()
        turn = -2j * np.pi * sample_rate_hz / n_samples * time_s
        n_bins, n_fine = n_samples // 2 + 1, 64  # bins in two digits: few exponentials
        coarse = np.exp(np.arange(0, n_bins, n_fine)[:, None] * turn) * step
        fine = np.exp(np.arange(n_fine)[:, None] * turn)
        total = np.einsum("ct,ft->cf", coarse, fine).ravel()[:n_bins]  # `@` would wake threads for longer than it takes
        spectrum = np.zeros(n_bins, dtype=complex)
        spectrum[1:] = total[1:] * n_samples / (2j * np.pi * np.arange(1, n_bins))
        return spectrum

    def band_hz(self) -> tuple[float, float]:
        """Return the band (low, high) in hertz that holds the wave's fundamental."""
        return min(self.start_hz, self.stop_hz), max(self.start_hz, self.stop_hz)

    def _half_periods_s(self) -> FloatArray:
        """Return the times at which the phase f0 t + r t^2 / 2 is k/2, k = 0, 1, ..., within the duration."""
        rate = (self.stop_hz - self.start_hz) / self.duration_s
        half_periods = round((self.start_hz + self.stop_hz) * self.duration_s, 9)
        k = np.arange(int(np.ceil(half_periods)))
        return np.asarray(k / (self.start_hz + np.sqrt(self.start_hz**2 + rate * k)))

    def _chip_edges_s(self) -> FloatArray:
        levels = np.concatenate([[0], mls_bits(self.order), [0]])
        return np.asarray(np.flatnonzero(np.diff(levels)) / self.chip_rate_hz)


def mls_bits(order: int) -> NDArray[np.int8]:
    """Return the maximum-length sequence (2**order - 1,) of zeros and ones, the register starting with all ones.

    Raises
    ------
    ValueError
        No feedback taps are known for this order (7 to 13).
    """
    if order not in _MLS_TAPS:
        raise ValueError(f"no maximum-length sequence of order {order}: use an order of 7 to 13")
    register = [1] * order
    bits = np.empty(2**order - 1, dtype=np.int8)
    for index in range(len(bits)):
        bits[index] = register[-1]
        feedback = 0
        for tap in _MLS_TAPS[order]:
            feedback ^= register[tap - 1]
        register = [feedback, *register[:-1]]
    return bits
