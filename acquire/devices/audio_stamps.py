"""The stamps of audio blocks: when the first sample of each was taken, from what a sound driver tells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquire.devices.portaudio_child import LATENCY_S

_AT_ONCE_S = 0.002  # buffers that come closer together were one in the driver
_STEADY_S = 0.001


@dataclass(frozen=True)
class Buffer:
    """What one callback of the driver brought.

    Parameters
    ----------
    samples : (n_samples, n_channels) float32 array
    came_s : float
        Host monotonic time of the callback.
    adc_s, current_s : float
        By the driver's own clock: when the first sample was taken, and the callback.
    flags : int
        `rigs.session.layout.FLAG_*`.
    """

    samples: NDArray[np.float32]
    came_s: float
    adc_s: float
    current_s: float
    flags: int = 0


def deliveries(buffers: Sequence[Buffer]) -> list[Buffer]:
    """Join buffers that came at once: a driver that splits what the hardware brought makes blocks of two samples.

    A buffer with flags begins a block of its own, as they speak of what was before it.
    """
    groups: list[list[Buffer]] = []
    for buffer in buffers:
        if groups and not buffer.flags and buffer.came_s - groups[-1][-1].came_s < _AT_ONCE_S:
            groups[-1].append(buffer)
        else:
            groups.append([buffer])
    return [_joined(group) for group in groups]


def arrival_stamps_s(blocks: Sequence[Buffer], sample_rate_hz: float) -> list[float]:
    """Return when the first sample of each block was taken at the latest, as it and later ones arrived."""
    stamps_s, next_s = [], float("inf")
    for block in reversed(blocks):
        next_s = min(block.came_s, next_s) - len(block.samples) / sample_rate_hz
        stamps_s.append(next_s)
    return stamps_s[::-1]


def driver_stamp_s(block: Buffer) -> float:
    """Return when the block's first sample was taken in host time, by the driver's own clock."""
    return block.came_s - (block.current_s - block.adc_s)


def driver_times_are_sane(blocks: Sequence[Buffer], sample_rate_hz: float) -> bool:
    """Tell whether the driver's times are worth using: on several host APIs they are 0, constant, or jump about.

    They must lie before the callback by at least the block's length, not by more than the driver's buffer on top of it,
    and keep step with the samples at least as well as the callbacks do.

    Parameters
    ----------
    blocks : sequence of Buffer
        In order; of none, nothing bad is known.
    sample_rate_hz : float
    """
    if not blocks:
        return True
    n_samples = np.array([len(block.samples) for block in blocks])
    sampled_s = (np.cumsum(n_samples) - n_samples) / sample_rate_hz
    age_s = np.array([block.current_s - block.adc_s for block in blocks]) - n_samples / sample_rate_hz
    stamps_s = np.array([driver_stamp_s(block) for block in blocks])
    arrivals_s = np.array(arrival_stamps_s(blocks, sample_rate_hz))
    spread_s, arrival_spread_s = np.ptp(stamps_s - sampled_s), np.ptp(arrivals_s - sampled_s)
    steady = spread_s <= max(_STEADY_S, arrival_spread_s)
    told = min(block.adc_s for block in blocks) > 0
    return bool(told and steady and age_s.min() >= -_STEADY_S and age_s.max() <= LATENCY_S)


def _joined(group: Sequence[Buffer]) -> Buffer:
    if len(group) == 1:
        return group[0]
    samples = np.concatenate([buffer.samples for buffer in group])
    first, last = group[0], group[-1]
    # The driver's two times are of the first callback; moved on to the last, they still tell the same age.
    return Buffer(samples, last.came_s, first.adc_s, first.current_s + last.came_s - first.came_s, first.flags)
