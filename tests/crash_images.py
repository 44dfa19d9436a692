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

from rigs.errors import SessionError
from rigs.session.journal import journal_path
from rigs.session.reader import Session

HERE = Path(__file__).parent
SESSION, JOURNAL, MARKER = range(3)
WRITE, TRUNCATE, SYNC_BEGINS, SYNC_DONE = range(1, 5)
_ENTRY = np.dtype([("operation", "u1"), ("file", "u1"), ("unused", "<u2"), ("length", "<u4"), ("offset", "<i8")])


def build_shim(folder: Path) -> Path:
    """Compile the library that is preloaded."""
    shim = folder / "crash_shim.so"
    command = ["gcc", "-shared", "-fPIC", "-O1", "-o", str(shim), str(HERE / "crash_shim.c"), "-ldl", "-lpthread"]
    subprocess.run(command, check=True)
    return shim


def logged_session(folder: Path, n_poses: int) -> list[Event]:
    """Record a session with the real writer and return all it did to the disk."""
    environment = os.environ | {"LD_PRELOAD": str(build_shim(folder)), "RIG_SHIM_LOG": str(folder / "log")}
    subprocess.run(
        [sys.executable, str(HERE / "logged_writer.py"), str(folder), str(n_poses)], check=True, env=environment
    )
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

    name: str
    session: bytes
    journal: bytes
    n_samples: int
    n_frames: int
    n_poses: int

    def write(self, folder: Path) -> Path:
        """Write the files into a folder of their own within `folder`, and return the session's path."""
        path = folder / self.name / "lost.h5"
        path.parent.mkdir()
        path.write_bytes(self.session)
        journal_path(path).write_bytes(self.journal)
        return path

    def complaint(self, path: Path) -> str:
        """Say what is wrong with what is left at `path`; empty when it holds all that was synced."""
        try:
            with Session.open(path) as session:
                bad = session.verify()
                kept = (session.n_samples, len(session.frames), int(np.count_nonzero(session.poses["accepted"])))
        except SessionError as error:
            return str(error)
        wanted = (self.n_samples, self.n_frames, self.n_poses)
        if any(has < want for has, want in zip(kept, wanted, strict=True)):
            bad.append(f"samples, frames, good poses {kept}, synced {wanted}")
        return f"{path}: {'; '.join(bad)}" if bad else ""


def power_losses(events: list[Event], n: int, seed: int) -> Iterator[Image]:
    """Yield n images of power losses at random writes and syncs; an image depends on its moment and the seed only."""
    moments = [place for place, event in enumerate(events) if event.file != MARKER and place >= len(events) // 20]
    chosen = set(np.random.default_rng(seed).choice(moments, n, replace=False).tolist())
    disks = {SESSION: Disk(), JOURNAL: Disk()}
    nothing = (0, 0, 0)
    flushed, at_sync, in_session, safe = nothing, nothing, nothing, nothing
    for place, event in enumerate(events):
        if event.file == MARKER:
            flushed = tuple(json.loads(event.content))
            continue
        if (event.file, event.operation) == (SESSION, SYNC_BEGINS):
            at_sync = flushed
        elif (event.file, event.operation) == (SESSION, SYNC_DONE):
            in_session = at_sync
        elif (event.file, event.operation) == (JOURNAL, SYNC_DONE):
            safe = in_session
        disks[event.file].take(event)
        if place in chosen:
            rng = np.random.default_rng([seed, place])
            unit = int(rng.choice([512, 4096]))
            images = [disks[file].after_power_loss(rng, unit) for file in (SESSION, JOURNAL)]
            yield Image(f"seed-{seed}-event-{place}", *images, *safe)
