"""The sound devices of this computer: which there are, and which one is meant."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from acquire.devices import portaudio_child
from acquire.errors import DeviceError
from rigs.description import AudioDevice

RECORDER = (sys.executable, "-P", portaudio_child.__file__)
_LIST_TIMEOUT_S = 20.0


@dataclass(frozen=True)
class SoundDevice:
    """A sound device that records.

    Parameters
    ----------
    name, host_api : str
        As PortAudio calls them; together they tell devices apart, unlike numbers, which change from boot to boot.
    inputs : int
        The most channels that it records.
    default_rate_hz : float
    """

    name: str
    host_api: str
    inputs: int
    default_rate_hz: float

    def words(self) -> str:
        """Return it as the rig description names it."""
        name, host_api = (json.dumps(text, ensure_ascii=False) for text in (self.name, self.host_api))
        return f"{{name: {name}, host_api: {host_api}}}"

    def describe(self) -> str:
        """Return it in one line."""
        return f"{self.words()} ({self.inputs} inputs)"


def sound_devices() -> list[SoundDevice]:
    """Return the devices that record, as PortAudio finds them at this moment, in its order.

    Raises
    ------
    DeviceError
        PortAudio is not installed, or does not answer.
    """
    try:
        run = subprocess.run(  # noqa: S603 - our own module, no shell
            [*RECORDER, "list"], stdin=subprocess.DEVNULL, capture_output=True, timeout=_LIST_TIMEOUT_S, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise DeviceError(
            "audio: the sound system does not answer: restart it (systemctl --user restart pipewire pulseaudio)"
        ) from error
    found = checked_answer(run.stdout)["devices"]
    return [SoundDevice(**device) for device in found if device["inputs"] > 0]


def checked_answer(line: bytes, explain: Callable[[int, str], str] | None = None) -> dict[str, Any]:
    """Return what the recorder says.

    Parameters
    ----------
    line : bytes
    explain : callable, optional
        Makes a message of PortAudio's error code and text.

    Raises
    ------
    DeviceError
        It says that something is wrong, or nothing.
    """
    if not line.strip():
        raise DeviceError("audio: PortAudio crashed: try another audio.device; rig-capture --list-devices names them")
    answer: dict[str, Any] = json.loads(line)
    if answer.get("error") == "missing":
        raise DeviceError("audio: the PortAudio library is not installed: run `sudo apt-get install libportaudio2`")
    if "error" in answer:
        code, text = answer["error"], answer["text"]
        raise DeviceError(explain(code, text) if explain else f"audio: {text}: restart the sound system")
    return answer


def choose_sound_device(wanted: AudioDevice, devices: Sequence[SoundDevice]) -> SoundDevice:
    """Return the device that is meant.

    A device is meant by its whole name, or by whole words of it; capitals do not matter.

    Parameters
    ----------
    wanted : AudioDevice
    devices : sequence of SoundDevice
        What there is.

    Raises
    ------
    DeviceError
        None fits, or more than one.
    """
    api = [device for device in devices if wanted.host_api is None or _has_words(device.host_api, wanted.host_api)]
    same = [device for device in api if device.name.casefold() == wanted.name.strip().casefold()]
    fitting = same or [device for device in api if _has_words(device.name, wanted.name)]
    if len(fitting) == 1:
        return fitting[0]
    named = f"{wanted.name!r}" + (f" and host API {wanted.host_api!r}" if wanted.host_api else "")
    if fitting:
        listed = "; ".join(device.describe() for device in fitting)
        raise DeviceError(
            f"audio: {len(fitting)} sound devices fit {named}: give more words of the name, or the host_api, in "
            f"audio.device: {listed}"
        )
    listed = "; ".join(device.describe() for device in devices) or "none"
    raise DeviceError(
        f"audio: no sound device fits {named}: plug it in, or put another into audio.device; devices here: {listed}"
    )


def _has_words(text: str, wanted: str) -> bool:
    """Tell whether all words of `wanted` are among those of `text`: "1" is not in "hw:10"."""
    return _words(wanted) <= _words(text)


def _words(text: str) -> set[str]:
    return set(re.findall(r"\w+", text.casefold()))
