"""Whether the channels are in the order that the rig description says."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

FloatArray = NDArray[np.float64]

CLEARLY = 0.5  # of the distance from where they are expected: then another order is better


def order_doubts(places_m: FloatArray, expected_m: FloatArray, channels: tuple[int, ...]) -> list[str]:
    """Name channels whose microphones are found in each other's places.

    Parameters
    ----------
    places_m, expected_m : (n_mics, 3) arrays
        Where they were found, and about where they are by the rig description; camera frame.
    channels : tuple of int

    Returns
    -------
    list of str
        Nothing where the order is right. One channel order cannot be told from another by the sound alone.
    """
    distances_m = np.linalg.norm(places_m[:, None] - expected_m, axis=2)
    _, order = linear_sum_assignment(distances_m**2)
    own, other = np.diag(distances_m), distances_m[np.arange(len(order)), order]
    wrong = [row for row in range(len(order)) if order[row] != row and other[row] < CLEARLY * own[row]]
    pairs = [(row, int(order[row])) for row in wrong if order[order[row]] == row and row < order[row]]
    doubts = [
        f"channels {channels[first]} and {channels[second]} look swapped, by audio.expected_positions_m: swap their "
        "cables or their numbers"
        for first, second in pairs
    ]
    rest = [str(channels[row]) for row in wrong if order[order[row]] != row]
    if rest:
        doubts.append(f"channels {', '.join(rest)} are mixed up, by audio.expected_positions_m: check their cables")
    return doubts
