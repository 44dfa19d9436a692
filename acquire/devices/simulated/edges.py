"""The edges of the square wave that the trigger board's pin puts out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rigs.waveform import Waveform, mls_bits

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
    time_s = _chip_edges_s(waveform) if waveform.kind == "mls" else _half_periods_s(waveform)
    if len(time_s) % 2:
        time_s = np.append(time_s, waveform.duration_s)
    step = np.where(np.arange(len(time_s)) % 2 == 0, 1.0, -1.0)
    return np.rint(time_s / TICK_S) * TICK_S, step


def _half_periods_s(waveform: Waveform) -> FloatArray:
    """Return the times at which the phase f0 t + r t^2 / 2 is k/2, k = 0, 1, ..., within the duration."""
    rate = (waveform.stop_hz - waveform.start_hz) / waveform.duration_s
    half_periods = round((waveform.start_hz + waveform.stop_hz) * waveform.duration_s, 9)
    k = np.arange(int(np.ceil(half_periods)))
    return np.asarray(k / (waveform.start_hz + np.sqrt(waveform.start_hz**2 + rate * k)))


def _chip_edges_s(waveform: Waveform) -> FloatArray:
    levels = np.concatenate([[0], mls_bits(waveform.order), [0]])
    return np.asarray(np.flatnonzero(np.diff(levels)) / waveform.chip_rate_hz)
