"""The recorder's process, seen from the program that starts it: `portaudio_child` runs at its other end."""

from __future__ import annotations

import json
import subprocess
import time
from collections import deque
from contextlib import suppress
from threading import Event, Thread
from typing import BinaryIO, cast

import numpy as np

from acquire.devices.audio_stamps import Buffer
from acquire.devices.portaudio_child import BLOCK
from acquire.errors import DeviceError
from acquire.sound_devices import RECORDER, SoundDevice, checked_answer
from rigs.session.layout import FLAG_OVERFLOW

_START_S = 10.0  # PulseAudio takes two seconds to begin
_SETTLE_S = 1.5  # in which buffers still fill, so that sound comes later and later
_SILENCE_S = 1.0
_GRACE_S = 0.1  # for this program's own thread, when all of it was held up
_END_S = 1.0
_HELD_S = 5.0  # beyond it the blocks wait at the other end, where they are counted
_POLL_S = 0.02
_SAMPLE_BYTES = 4
_UNPLUGGED = "check its cable and plug, and give it a USB port of its own"
# PortAudio's error codes, and what helps.
_REMEDIES = {
    -9997: "set audio.sample_rate_hz to a rate that it has (its default is {default:g})",
    -9998: "correct audio.channels, or name another audio.device",
    -9985: "another program uses it: close that, or name another audio.device",
}


class Recorder:
    """Records a device in a process of its own, from `start` to `stop`.

    Parameters
    ----------
    device : SoundDevice
    n_inputs : int
        It records inputs 1 to this.
    rate_hz : int
    """

    def __init__(self, device: SoundDevice, n_inputs: int, rate_hz: int) -> None:
        self._device, self._n_inputs, self._rate_hz = device, n_inputs, rate_hz
        self._buffers: deque[Buffer] = deque()
        self._n_read, self._n_taken = 0, 0  # frames; each written by one thread only
        self._heard_s = time.monotonic()
        self._answer, self._has_answered, self._has_ended = b"", Event(), Event()
        self._process = self._spawn()
        self._pump = Thread(target=self._read_all, daemon=True)

    def start(self) -> str:
        """Wait until sound has come for a while, and return PortAudio's name and version. Raises DeviceError."""
        self._pump.start()
        end_s = time.monotonic() + _START_S
        if not self._has_answered.wait(_START_S):
            raise DeviceError(f"{self._called()} does not answer: {_UNPLUGGED}, or restart the sound system")
        driver = str(checked_answer(self._answer, self._why)["driver"])
        while self._n_read < _SETTLE_S * self._rate_hz:
            if self._has_ended.wait(_POLL_S) or time.monotonic() > end_s:
                raise DeviceError(f"{self._called()} delivers no sound: {_UNPLUGGED}; is it muted, or in use?")
        return driver

    def take(self) -> list[Buffer]:
        """Return what came in since the last call. Raises DeviceError once nothing does any more."""
        if not self._buffers:
            self._check_alive()
        buffers = [self._buffers.popleft() for _ in range(len(self._buffers))]
        self._n_taken += sum(len(buffer.samples) for buffer in buffers)
        return buffers

    def stop(self) -> None:
        """End the process, whatever its driver does."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with suppress(OSError):
            self._process.stdin.close()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._has_ended.set()
        if self._pump.is_alive():
            self._pump.join()
        self._process.stdout.close()

    def _spawn(self) -> subprocess.Popen[bytes]:
        settings = {
            "name": self._device.name,
            "host_api": self._device.host_api,
            "channels": self._n_inputs,
            "sample_rate_hz": self._rate_hz,
        }
        return subprocess.Popen(  # noqa: S603 - our own module, no shell
            [*RECORDER, "record", json.dumps(settings)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C at the terminal is for the capture alone
        )

    def _read_all(self) -> None:
        pipe = cast(BinaryIO, self._process.stdout)
        self._answer = pipe.readline()
        self._has_answered.set()
        while (buffer := self._next_buffer(pipe)) is not None:
            self._n_read += len(buffer.samples)
            self._heard_s = time.monotonic()
            self._buffers.append(buffer)
            while self._n_read - self._n_taken > _HELD_S * self._rate_hz and not self._has_ended.is_set():
                time.sleep(_POLL_S)
        self._has_ended.set()

    def _next_buffer(self, pipe: BinaryIO) -> Buffer | None:
        head = pipe.read(BLOCK.size)
        if len(head) < BLOCK.size:
            return None
        n_frames, has_lost, came_s, adc_s, current_s = BLOCK.unpack(head)
        content = pipe.read(n_frames * self._n_inputs * _SAMPLE_BYTES)
        if len(content) < n_frames * self._n_inputs * _SAMPLE_BYTES:
            return None
        samples = np.frombuffer(content, dtype="<f4").reshape(n_frames, self._n_inputs)
        return Buffer(samples, came_s, adc_s, current_s, FLAG_OVERFLOW if has_lost else 0)

    def _check_alive(self) -> None:
        if self._has_ended.is_set() and not self._buffers:
            raise DeviceError(f"{self._called()} is gone: {_UNPLUGGED}")
        if time.monotonic() - self._heard_s > _SILENCE_S:
            time.sleep(_GRACE_S)
            if time.monotonic() - self._heard_s > _SILENCE_S:
                raise DeviceError(f"{self._called()} has delivered nothing for a second: {_UNPLUGGED}")

    def _why(self, code: int, text: str) -> str:
        remedy = _REMEDIES.get(code, _UNPLUGGED).format(default=self._device.default_rate_hz)
        asked = f"{self._n_inputs} channels at {self._rate_hz} Hz"
        return f"{self._called()} does not record {asked} ({text}): {remedy}"

    def _called(self) -> str:
        return f"audio: the sound device {self._device.name!r} ({self._device.host_api})"
