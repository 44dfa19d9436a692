"""The flaws of a bench that stay until somebody mends them: of single channels, and of the camera's setting."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.devices.simulated.stage import Stage

Column = NDArray[np.floating[Any]]
Picture = NDArray[np.float32]
_WEAK_GAIN = 0.05
_NOISE, _HUM, _HUM_HZ = 0.01, 0.02, 50.0  # of full scale
_KINDS = (
    "weak_channel",
    "noisy_channel",
    "humming_channel",
    "inverted_channel",
    "duplicate_channel",
    "swapped_channel",
)
_OUT_OF_FOCUS_PX, _OVEREXPOSED = 3.0, 1.8


def flawed_sound(
    samples: NDArray[np.floating[Any]], first_sample: int, stage: Stage, rng: np.random.Generator
) -> NDArray[np.floating[Any]]:
    """Return the samples (n_samples, n_channels) as a device with the channel faults of its stage records them."""
    described = stage.scene.description
    channels, out = described.audio.recorded_channels(), samples.copy()
    time_s = (first_sample + np.arange(len(samples))) / described.audio.sample_rate_hz
    for kind in _KINDS:
        for fault in stage.faults(kind):
            column = channels.index(fault.channel or channels[0])
            following = (column + 1) % len(channels)
            if kind == "swapped_channel":
                out[:, [column, following]] = out[:, [following, column]]
            else:
                out[:, column] = _flawed(kind, out[:, column], out[:, following], time_s, rng)
    return out


def flawed_picture(picture: Picture, stage: Stage) -> Picture:
    """Return a picture (height, width) as a camera out of focus, or exposed for too long, takes it."""
    if stage.faults("blurred"):
        picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), _OUT_OF_FOCUS_PX))
    return picture * np.float32(_OVEREXPOSED) if stage.faults("overexposed") else picture


def _flawed(kind: str, own: Column, following: Column, time_s: Column, rng: np.random.Generator) -> Column:
    if kind == "weak_channel":
        return np.asarray(_WEAK_GAIN * own)
    if kind == "inverted_channel":
        return np.negative(own)
    if kind == "noisy_channel":
        return np.asarray(own + _NOISE * rng.standard_normal(len(own)))
    if kind == "humming_channel":
        return np.asarray(own + _HUM * np.sin(2 * np.pi * _HUM_HZ * time_s))
    return following  # duplicate_channel
