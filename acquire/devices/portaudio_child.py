"""The recorder: PortAudio in a process of its own, that writes what it hears to a pipe.

The only module that records with sounddevice. It runs as a program, started by `recorder` and `sound_devices`. So a
host that is busy, or waits for its disk, starves no callback; a driver that hangs or crashes is ended and started anew,
which is also the only sure way to see a device that was plugged in later; and what the libraries below print reaches
nobody. A recording ends as soon as standard input does, that is with the program that started it, however that ended.

    list                 one line of JSON: {"devices": [...]} or {"error": code, "text": text}
    record SETTINGS      one line of JSON: {"driver": name} or {"error": ...}; then `BLOCK` after `BLOCK`, each followed
                         by its samples, frame after frame of little-endian float32; the pipe's end is the stream's
"""

from __future__ import annotations

import json
import os
import struct
import sys
import time
from collections.abc import Callable
from queue import SimpleQueue
from threading import Thread
from types import ModuleType
from typing import Any, BinaryIO

# frames, and 1 if some were lost before them; host monotonic time of the callback; PortAudio's ADC and current time.
BLOCK = struct.Struct("<IIddd")
QUEUE_S = 20.0  # how long the reader may be away
_ROOM_SHARE = 0.1
LATENCY_S = 0.2  # callbacks come every 50 ms, and may be as late as this


class Intake:
    """What lies between PortAudio's callback and the pipe: a bounded queue.

    Parameters
    ----------
    max_frames : int
        Beyond so many waiting frames new ones are dropped until there is room for a good part of them again, so that
        it is one loss; the next block says so.
    """

    def __init__(self, max_frames: int) -> None:
        self._max_frames = max_frames
        self._queue: SimpleQueue[tuple[bytes, bytes] | None] = SimpleQueue()
        self._n_put, self._n_taken = 0, 0  # each written by one thread only
        self._has_lost = self._is_full = False

    def callback(self, samples: Any, frames: int, times: Any, status: Any) -> None:
        """Copy a buffer into the queue; PortAudio calls this, in a thread of its own."""
        came_s = time.monotonic()
        self._has_lost |= bool(status.input_overflow or status.input_underflow)
        room = self._max_frames - (self._n_put - self._n_taken)
        self._is_full = frames > room or (self._is_full and room < _ROOM_SHARE * self._max_frames)
        if self._is_full:
            self._has_lost = True
            return
        head = BLOCK.pack(frames, self._has_lost, came_s, times.inputBufferAdcTime, times.currentTime)
        self._has_lost = False
        self._n_put += frames
        self._queue.put((head, bytes(samples)))

    def end(self) -> None:
        """Say that no more comes; PortAudio calls this when the stream ends by itself."""
        self._queue.put(None)

    def take(self) -> tuple[bytes, bytes] | None:
        """Wait for the next block: its head and its samples; None after the last."""
        block = self._queue.get()
        if block is not None:
            self._n_taken += BLOCK.unpack(block[0])[0]
        return block


def main(words: list[str]) -> None:
    """Run the command; never returns while the stream runs."""
    out = os.fdopen(os.dup(1), "wb", buffering=0)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what a library prints must not get into the blocks
    if words[0] == "record":
        Thread(target=_end_with_parent, daemon=True).start()
    try:
        import sounddevice  # noqa: PLC0415 - fails where PortAudio is not installed
    except (ImportError, OSError) as error:
        _say(out, {"error": "missing", "text": str(error)})
        return
    try:
        if words[0] == "list":
            _say(out, {"devices": _devices(sounddevice)})
        else:
            _record(sounddevice, json.loads(words[1]), out)
    except sounddevice.PortAudioError as error:
        _say(out, {"error": error.args[1] if len(error.args) > 1 else 0, "text": str(error.args[0])})


def _end_with_parent() -> None:
    sys.stdin.buffer.read()
    os._exit(0)  # not by way of PortAudio, which may hang


def _say(out: BinaryIO, message: dict[str, Any]) -> None:
    out.write(json.dumps(message).encode() + b"\n")


def _devices(sounddevice: ModuleType) -> list[dict[str, Any]]:
    apis = [api["name"] for api in sounddevice.query_hostapis()]
    return [
        {
            "name": device["name"],
            "host_api": apis[device["hostapi"]],
            "inputs": device["max_input_channels"],
            "default_rate_hz": device["default_samplerate"],
        }
        for device in sounddevice.query_devices()
    ]


def _record(sounddevice: ModuleType, settings: dict[str, Any], out: BinaryIO) -> None:
    wanted = (settings["name"], settings["host_api"])
    found = [(device["name"], device["host_api"]) for device in _devices(sounddevice)]
    if wanted not in found:
        _say(out, {"error": 0, "text": "it was unplugged just now"})
        return
    rate_hz = settings["sample_rate_hz"]
    intake = Intake(round(QUEUE_S * rate_hz))
    stream = sounddevice.RawInputStream(
        device=found.index(wanted),
        channels=settings["channels"],
        samplerate=rate_hz,
        dtype="float32",
        latency=LATENCY_S,
        callback=intake.callback,
        finished_callback=intake.end,
    )
    stream.start()
    _say(out, {"driver": sounddevice.get_portaudio_version()[1].partition(",")[0]})
    _copy(intake.take, out)


def _copy(take: Callable[[], tuple[bytes, bytes] | None], out: BinaryIO) -> None:
    while (block := take()) is not None:
        for part in block:
            left = memoryview(part)
            while left:
                left = left[out.write(left) :]
    os._exit(0)  # the device is gone: closing its stream may hang


if __name__ == "__main__":
    main(sys.argv[1:])
