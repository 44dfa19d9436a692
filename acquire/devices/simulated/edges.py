"""The edges of the square wave that the trigger board's pin puts out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rigs.waveform import Waveform

FloatArray = NDArray[np.float64]
TICK_S = 0.5e-6  # of the timer: 16 MHz / 8


def pin_edges(waveform: Waveform) -> tuple[FloatArray, FloatArray]:
    """Return when the pin changes level and by how much; it rests low before and after.

    Returns
    -------
    time_s : (n_edges,) array
        On the board's clock since the start, rounded to whole timer ticks.
    step : (n_edges,) array
        +1 where the level rises, -1 where it falls.
    """
    time_s, step = waveform.edges()
    return np.rint(time_s / TICK_S) * TICK_S, step
