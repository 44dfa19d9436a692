"""Measurements of many repetitions at once: what the methods of the paper are tried on in studies.

Repetitions stand in the first axis of every array, so that a round of 1 ms is not spent on calling numpy.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class PairBatch:
    """TDOAs of pairs of microphones, in several repetitions.

    Parameters
    ----------
    sources_m : (n or 1, n_emissions, 3) array
        Where each emission is taken to come from, camera frame.
    tdoa_s : (n, n_emissions, n_pairs) array
        Arrival at j minus arrival at i.
    incidence : (n_pairs, n_mics + n_known) array
        Rows of -1 at i and +1 at j.
    known_m : (n or 1, n_known, 3) array
        Places of known microphones; they stand behind the others in `incidence`.
    speed_m_s : float
    """

    sources_m: FloatArray
    tdoa_s: FloatArray
    incidence: FloatArray
    known_m: FloatArray
    speed_m_s: float

    @property
    def n_mics(self) -> int:
        """Number of microphones to be found."""
        return int(self.incidence.shape[1] - self.known_m.shape[1])

    def only(self, chosen: NDArray[np.bool_]) -> PairBatch:
        """Return some of the repetitions (n,)."""
        each = [array if len(array) == 1 else array[chosen] for array in (self.sources_m, self.known_m)]
        return replace(self, sources_m=each[0], known_m=each[1], tdoa_s=self.tdoa_s[chosen])


def distances(places_m: FloatArray, sources_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return distances (n, n_emissions, n_mics) and unit vectors (..., 3) from sources to places (n, n_mics, 3)."""
    rays_m = places_m[:, None] - sources_m[:, :, None]
    lengths_m = np.sqrt(np.einsum("kemi,kemi->kem", rays_m, rays_m))
    return lengths_m, rays_m / np.maximum(lengths_m, 1e-12)[..., None]


def star(n_mics: int) -> FloatArray:
    """Return the incidence (n_mics - 1, n_mics) of all microphones against the first."""
    return np.hstack([-np.ones((n_mics - 1, 1)), np.eye(n_mics - 1)])


def all_pairs(n_mics: int) -> FloatArray:
    """Return the incidence (n_mics (n_mics - 1) / 2, n_mics) of all pairs."""
    first, second = np.triu_indices(n_mics, k=1)
    return np.asarray(np.eye(n_mics)[second] - np.eye(n_mics)[first])


def against_known(n_mics: int) -> FloatArray:
    """Return the incidence (n_mics, n_mics + 1) of all microphones against a known one."""
    return np.hstack([np.eye(n_mics), -np.ones((n_mics, 1))])
