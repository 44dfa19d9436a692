"""The stretches of a session's sound in which emissions lie, read a few at a time: memory does not grow with length."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from rigs.session.reader import Session

FloatArray = NDArray[np.float64]
RowArray = NDArray[np.intp]

FLIGHT_S = 0.03  # sound takes that long over 10 m
MOST_SAMPLES_AT_ONCE = 400_000  # of all channels together: what a processor's cache holds


@dataclass(frozen=True)
class Sound:
    """The windows of some emissions.

    Parameters
    ----------
    rows : (n,) integer array
        Which emissions.
    samples : (n, n_channels, n_samples) float32 array
        Full scale = 1; silent where the session holds none, or no numbers.
    not_numbers : (n, n_channels) bool array
        Channels that held samples that are no numbers.
    """

    rows: RowArray
    samples: NDArray[np.float32]
    not_numbers: NDArray[np.bool_]

    def peak(self) -> NDArray[np.float32]:
        """Return the largest magnitude (n, n_channels)."""
        return np.asarray(np.maximum(self.samples.max(axis=2), -self.samples.min(axis=2)))

    def rms(self) -> FloatArray:
        """Return the root mean square (n, n_channels)."""
        energy = np.einsum("ncs,ncs->nc", self.samples, self.samples)
        return np.asarray(np.sqrt(energy / self.samples.shape[2]), dtype=float)


class EmissionWindows:
    """Windows of equal length around where emissions are expected; the beginning of each is before the sound.

    Parameters
    ----------
    session : Session
    expected_samples : (n_emissions,) integer array
        Row of the session's audio where each should begin.
    duration_s : float
        Of what was played.
    tolerance_s : float
        How far from there it may begin.
    columns : tuple of int or None
        Of the session's audio; None: the microphones.

    Attributes
    ----------
    sample_rate_hz : float
    first_samples : (n_emissions,) integer array
        Row of the session's audio where each window begins.
    n_samples : int
        Length of a window, one that is quickly transformed.
    n_quiet : int
        So many samples at the beginning hold no sound of the emission.
    n_played : int
        Samples that the emission itself lasts.
    """

    def __init__(
        self,
        session: Session,
        expected_samples: NDArray[np.integer],
        duration_s: float,
        tolerance_s: float,
        columns: tuple[int, ...] | None = None,
    ) -> None:
        self._session = session
        self._columns = list(session.microphone_columns if columns is None else columns)
        self.sample_rate_hz = session.sample_rate_hz
        n_before = round((FLIGHT_S + tolerance_s) * self.sample_rate_hz)
        self.n_quiet = round(FLIGHT_S * self.sample_rate_hz)
        self.n_played = round(duration_s * self.sample_rate_hz)
        n_samples = 2 * n_before + self.n_played
        self.n_samples: int = 2 * next_fast_len(-(-n_samples // 2), real=True)
        self.first_samples = expected_samples.astype(np.int64) - n_before

    @property
    def n_channels(self) -> int:
        """How many microphones there are."""
        return len(self._columns)

    @property
    def channels(self) -> tuple[int, ...]:
        """Input channel of each microphone."""
        return tuple(self._session.channels[column] for column in self._columns)

    def held_samples(self) -> NDArray[np.int64]:
        """Return how many samples (n_emissions,) of each window come before the end of the session."""
        return np.clip(self._session.n_samples - self.first_samples, 0, self.n_samples)

    def batches(self, rows: RowArray) -> Iterator[Sound]:
        """Read the windows of some emissions (n,), a few at a time."""
        n_at_once = max(1, MOST_SAMPLES_AT_ONCE // (self.n_samples * self.n_channels))
        for begin in range(0, len(rows), n_at_once):
            yield self.read(rows[begin : begin + n_at_once])

    def read(self, rows: RowArray, n_samples: int | None = None) -> Sound:
        """Read the windows of some emissions (n,), or only their first `n_samples`."""
        n_wanted = self.n_samples if n_samples is None else n_samples
        samples = np.zeros((len(rows), self.n_channels, n_wanted), dtype=np.float32)
        for window, first in zip(samples, self.first_samples[rows], strict=True):
            begin, end = max(int(first), 0), min(int(first) + n_wanted, self._session.n_samples)
            if begin < end:
                window[:, begin - first : end - first] = self._session.audio(begin, end - begin).T[self._columns]
        with np.errstate(invalid="ignore", over="ignore"):
            not_numbers = ~np.isfinite(samples.sum(axis=2))  # one such sample spoils the sum
        if not_numbers.any():
            samples[~np.isfinite(samples)] = 0.0
        return Sound(rows, samples, not_numbers)
