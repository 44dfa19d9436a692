"""Images of a disk after a power loss, made from a log of everything a session's writer did to it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
SESSION, JOURNAL, MARKER = range(3)
WRITE, TRUNCATE, SYNC_BEGINS, SYNC_DONE = range(1, 5)
_ENTRY = np.dtype([("operation", "u1"), ("file", "u1"), ("unused", "<u2"), ("length", "<u4"), ("offset", "<i8")])

WRITER = """
import json, sys, time
from pathlib import Path
sys.path.insert(0, {tests!r})
from rigs.session import durability
durability.SYNC_INTERVAL_S = 0.01  # many syncs in little time
from example_sessions import BUZZER, TRUTH, new_session, picture, samples
with open({folder!r} + "/crash.marker", "wb", buffering=0) as marker:
    writer = new_session(Path({folder!r}) / "crash.h5", truth=TRUTH)
    for pose in range({n_poses}):
        for block in range(5):
            first = writer.append_audio(samples(5 * pose + block, 1024), host_time_s=pose + 0.1, adc_time_s=0.0)
        writer.append_frame(picture(pose), host_time_s=pose + 0.2, pose=pose)
        writer.append_emission(pose=pose, buzzer=BUZZER, repeat=0, waveform="sweep", board_time_s=pose + 0.3,
            host_time_s=pose + 0.3, expected_sample=5120 * pose, accepted=True)
        writer.append_pose(pose=pose, start_host_time_s=pose + 0.2, end_host_time_s=pose + 0.9, accepted=True)
        if pose % 3 == 0:
            writer.append_log(float(pose), "info", f"line {{pose}}")
            writer.flush()
            marker.write(json.dumps([writer.n_samples, writer.n_frames, pose + 1]).encode())
            time.sleep(0.004)
    writer.close()
"""


def build_shim(folder: Path) -> Path:
    """Compile the library that is preloaded."""
    shim = folder / "crash_shim.so"
    command = ["gcc", "-shared", "-fPIC", "-O1", "-o", str(shim), str(HERE / "crash_shim.c"), "-ldl", "-lpthread"]
    subprocess.run(command, check=True)
    return shim


def logged_session(folder: Path, n_poses: int) -> list[Event]:
    """Record a session with the real writer and return all it did to the disk."""
    code = WRITER.format(tests=str(HERE), folder=str(folder), n_poses=n_poses)
    environment = os.environ | {"LD_PRELOAD": str(build_shim(folder)), "RIG_SHIM_LOG": str(folder / "log")}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)
    return list(_events((folder / "log").read_bytes()))


@dataclass(frozen=True)
class Event:
    operation: int
    file: int
    offset: int
    content: bytes


def _events(log: bytes) -> Iterator[Event]:
    place = 0
    while place < len(log):
        entry = np.frombuffer(log, _ENTRY, 1, place)[0]
        place += _ENTRY.itemsize
        length = int(entry["length"])
        yield Event(int(entry["operation"]), int(entry["file"]), int(entry["offset"]), log[place : place + length])
        place += length


@dataclass
class Disk:
    """What of one file is on the disk for certain, and what may be."""

    content: bytearray = field(default_factory=bytearray)
    pending: list[Event] = field(default_factory=list)
    n_before_sync: int = 0

    def take(self, event: Event) -> None:
        if event.operation in (WRITE, TRUNCATE):
            self.pending.append(event)
        elif event.operation == SYNC_BEGINS:
            self.n_before_sync = len(self.pending)
        else:
            for each in self.pending[: self.n_before_sync]:
                apply(self.content, each)
            del self.pending[: self.n_before_sync]

    def after_power_loss(self, rng: np.random.Generator, unit: int) -> bytes:
        """Return the durable content with, unit by unit, none, some or all of the later writes to it."""
        image = bytearray(self.content)
        pieces: dict[int, list[Event]] = defaultdict(list)
        for event in self.pending:
            for begin in range(event.offset // unit * unit, event.offset + len(event.content), unit):
                low, high = max(begin, event.offset), min(begin + unit, event.offset + len(event.content))
                pieces[begin].append(
                    Event(WRITE, event.file, low, event.content[low - event.offset : high - event.offset])
                )
        share = rng.uniform()
        for writes in pieces.values():
            n_done = int(rng.integers(0, len(writes) + 1)) if rng.uniform() < share else 0
            for piece in writes[:n_done]:
                apply(image, piece)
        return bytes(image)


def apply(content: bytearray, event: Event) -> None:
    if event.operation == TRUNCATE:
        del content[event.offset :]
        content.extend(bytes(event.offset - len(content)))
        return
    end = event.offset + len(event.content)
    content.extend(bytes(max(0, end - len(content))))
    content[event.offset : end] = event.content


@dataclass(frozen=True)
class Image:
    """A power loss: both files, and what the writer had flushed before the last sync that was done."""

    session: bytes
    journal: bytes
    n_samples: int
    n_frames: int
    n_poses: int

    def write(self, folder: Path) -> Path:
        (folder / "lost.h5").write_bytes(self.session)
        (folder / "lost.h5.journal").write_bytes(self.journal)
        return folder / "lost.h5"


def power_losses(events: list[Event], n: int, seed: int) -> Iterator[Image]:
    """Yield images of power losses at random events after the first flush that is promised to be safe."""
    rng = np.random.default_rng(seed)
    disks = {SESSION: Disk(), JOURNAL: Disk()}
    flushed, candidate, at_sync, safe = None, None, None, None
    moments = set(rng.choice(np.arange(len(events) // 20, len(events)), n, replace=False).tolist())
    for place, event in enumerate(events):
        if event.file == MARKER:
            flushed = json.loads(event.content)
            continue
        if (event.file, event.operation) == (SESSION, SYNC_BEGINS):
            at_sync = flushed
        elif (event.file, event.operation) == (SESSION, SYNC_DONE):
            candidate = at_sync
        elif (event.file, event.operation) == (JOURNAL, SYNC_DONE):
            safe = candidate
        disks[event.file].take(event)
        if place in moments:
            unit = int(rng.choice([512, 4096]))
            images = [disks[file].after_power_loss(rng, unit) for file in (SESSION, JOURNAL)]
            yield Image(*images, *(safe or (0, 0, 0)))
