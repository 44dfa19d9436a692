"""Exposure, gain and focus: locked, read back, and told where the driver refuses.

Drivers take values that they do not keep, so only what is read back counts. Video4Linux calls manual exposure 1 and
automatic exposure 3; other systems, and OpenCV before 4, call manual 0.25. A control that a camera does not have
reads as -1, or as 0 with some drivers.
"""

from __future__ import annotations

from typing import Protocol

import cv2

from rigs.description import Exposure

_MANUAL_EXPOSURE = (1.0, 0.25)
_AUTOMATIC_ON = {cv2.CAP_PROP_AUTOFOCUS: "focus", cv2.CAP_PROP_AUTO_WB: "white balance"}
_ABSENT = (-1.0, 0.0)


class Controls(Protocol):
    """The properties of a camera, as `cv2.VideoCapture` has them."""

    def get(self, prop: int, /) -> float:
        """Return a property's value."""

    def set(self, prop: int, value: float, /) -> bool:
        """Set a property and return whether the driver says that it took it."""


def lock_controls(controls: Controls, wanted: Exposure) -> list[str]:
    """Switch automatic exposure, focus and white balance off and set what the rig wants.

    Returns
    -------
    list of str
        What the driver refused, each with what to do; empty where all is as wanted.
    """
    refusals = []
    if wanted.locked:
        if not _is_manual_exposure(controls):
            refusals.append(
                "automatic exposure stays on: lock it with the camera's own program, and keep the light even"
            )
        refusals += [
            f"automatic {name} stays on: lock it with the camera's own program"
            for prop, name in _AUTOMATIC_ON.items()
            if not _is_off(controls, prop)
        ]
    values = {
        "exposure": (cv2.CAP_PROP_EXPOSURE, wanted.exposure),
        "gain": (cv2.CAP_PROP_GAIN, wanted.gain),
        "focus": (cv2.CAP_PROP_FOCUS, wanted.focus),
    }
    for name, (prop, value) in values.items():
        if value is not None and (got := _set(controls, prop, value)) != value:
            refusals.append(f"{name} is {got:g} although camera.exposure.{name} wants {value:g}: give what it can do")
    return refusals


def _is_manual_exposure(controls: Controls) -> bool:
    return any(_set(controls, cv2.CAP_PROP_AUTO_EXPOSURE, manual) == manual for manual in _MANUAL_EXPOSURE)


def _is_off(controls: Controls, prop: int) -> bool:
    return controls.get(prop) in _ABSENT or _set(controls, prop, 0.0) in _ABSENT


def _set(controls: Controls, prop: int, value: float) -> float:
    controls.set(prop, value)
    return controls.get(prop)
