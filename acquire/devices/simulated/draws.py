"""Random draws that one part of the simulation cannot disturb in another."""

from __future__ import annotations

import zlib

import numpy as np


def draws(seed: int, subject: str, *index: int) -> np.random.Generator:
    """Return the generator of one subject (and of its parts, by index) under a seed."""
    return np.random.default_rng([seed, zlib.crc32(subject.encode()), *index])
