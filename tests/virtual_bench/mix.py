"""The mix: sounds that overlap, added up until they are played."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class Mix:
    """Samples from the next one to be played on.

    Parameters
    ----------
    channels : int
    begin : int
        The next sample to be played.
    """

    def __init__(self, channels: int, begin: int = 0) -> None:
        self.begin = begin
        self._ahead = np.zeros((0, channels), np.float32)

    def add(self, first_sample: int, sound: NDArray[np.float32]) -> int:
        """Add a sound (n_samples, channels) and return how many of its samples came too late and are left out."""
        late = min(max(0, self.begin - first_sample), len(sound))
        start = first_sample + late - self.begin
        self._reach(start + len(sound) - late)
        self._ahead[start : start + len(sound) - late] += sound[late:]
        return late

    def take(self, n_samples: int) -> NDArray[np.float32]:
        """Return the next samples (n_samples, channels); they are played now."""
        self._reach(n_samples)
        taken, self._ahead = self._ahead[:n_samples], self._ahead[n_samples:]
        self.begin += n_samples
        return taken

    def is_silent(self) -> bool:
        """Tell whether nothing is left to be played."""
        return not len(self._ahead)

    def _reach(self, n_samples: int) -> None:
        if len(self._ahead) < n_samples:
            more = np.zeros((n_samples - len(self._ahead), self._ahead.shape[1]), np.float32)
            self._ahead = np.concatenate([self._ahead, more])
