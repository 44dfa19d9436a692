"""What is wrong with an emission or a channel, in words, and whether its arrival can still be used."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

BoolArray = NDArray[np.bool_]


class Flaw(StrEnum):
    """The words for what is wrong."""

    WRONG_WAVEFORM = "wrong waveform"
    CUT_OFF = "cut by end of file"
    NOT_NUMBERS = "samples are not numbers"
    DEAD_CHANNEL = "dead channel"
    COPIED_CHANNEL = "duplicated channel"
    NOT_HEARD = "not heard"
    TWO_SOURCES = "two sources"
    AMBIGUOUS = "ambiguous tone"
    NO_CONSISTENT_PATH = "no consistent path"
    CLIPPED = "clipped"
    INVERTED = "polarity inverted"
    HUM = "hum"
    DISTURBED = "noise over the emission"


# With these the arrival is kept: its standard deviation already says what they cost.
HARMLESS = frozenset({Flaw.CLIPPED, Flaw.INVERTED, Flaw.HUM, Flaw.DISTURBED})
OF_CHANNELS = frozenset({Flaw.DEAD_CHANNEL, Flaw.COPIED_CHANNEL, Flaw.INVERTED, Flaw.HUM})
WHOLE_SHARE = 0.5  # of the channels: then it is the emission that is bad


@dataclass(frozen=True)
class Flaws:
    """Which flaw hit which arrival.

    Parameters
    ----------
    shape : (int, int)
        Emissions, channels.
    table : dict of Flaw to (n_emissions, n_channels) bool array
    """

    shape: tuple[int, int]
    table: dict[Flaw, BoolArray] = field(default_factory=dict)

    def add(self, flaw: Flaw, where: Any) -> None:
        """Add a flaw where a mask that broadcasts to the shape says so, sparing arrivals that are rejected already."""
        mask = np.broadcast_to(np.asarray(where, dtype=bool), self.shape)
        if flaw not in HARMLESS:
            mask = mask & ~self.rejected
        self.table[flaw] = self.table.get(flaw, np.zeros(self.shape, dtype=bool)) | mask

    @property
    def rejected(self) -> BoolArray:
        """Which arrivals (n_emissions, n_channels) cannot be used."""
        masks = [mask for flaw, mask in self.table.items() if flaw not in HARMLESS]
        return np.any(masks, axis=0) if masks else np.zeros(self.shape, dtype=bool)

    def of_channel(self, column: int) -> list[Flaw]:
        """Return what is wrong with a channel all along."""
        return [flaw for flaw, mask in self.table.items() if flaw in OF_CHANNELS and mask[:, column].any()]

    def of_arrival(self, row: int, column: int) -> list[Flaw]:
        """Return what is wrong with one arrival."""
        return [flaw for flaw, mask in self.table.items() if mask[row, column]]

    def of_emission(self, row: int) -> list[Flaw]:
        """Return what rejected most channels of an emission; empty where it is good."""
        passing = {flaw: mask[row] for flaw, mask in self.table.items() if flaw not in OF_CHANNELS | HARMLESS}
        if not passing or np.any(list(passing.values()), axis=0).mean() <= WHOLE_SHARE:
            return []
        counts = Counter({flaw: int(mask.sum()) for flaw, mask in passing.items()})
        return [counts.most_common(1)[0][0]]

    def counts(self) -> dict[str, int]:
        """Return how many arrivals each flaw hit."""
        return {str(flaw): int(mask.sum()) for flaw, mask in self.table.items() if mask.any()}
