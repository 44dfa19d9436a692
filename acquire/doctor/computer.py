"""The computer: room and right to write, serial ports, clock and load."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from acquire.disk import in_words, session_bytes
from acquire.doctor.row import Part, Row, State
from acquire.ports import serial_ports
from rigs.description import RigDescription
from rigs.errors import reason

_SPARE = 1.5  # poses are repeated, and the disk is not ours alone
_PROBE_BYTES = 8_000_000
_RESOLUTION_S = 1e-4
_NAPS, _NAP_S, _LATE_S = 20, 0.005, 0.02
_BUSY = 0.75  # of all cores


def judge_computer(folder: Path, description: RigDescription) -> Iterator[Row]:
    """Say whether a session can be written into a folder, and whether the computer has time for it."""
    yield from _disk(folder, description)
    if description.trigger.driver == "serial":
        yield from _ports()
    yield _clock()
    yield from _load()


def _disk(folder: Path, description: RigDescription) -> Iterator[Row]:
    needed_bytes = session_bytes(description)
    try:
        write_s = _time_to_write(folder)
        free_bytes = shutil.disk_usage(folder).free
    except OSError as error:
        remedy = "go to a folder of your own, on a disk with free space"
        yield _row("folder", State.BAD, f"{folder}: cannot be written to ({reason(error)})", remedy)
        return
    yield _row("folder", State.OK, f"{folder}: can be written to, {_PROBE_BYTES / write_s / 1e6:.0f} MB/s")
    figures = {"needed_bytes": needed_bytes, "free_bytes": float(free_bytes)}
    poses = description.capture.poses
    finding = f"{in_words(free_bytes)} free, {poses} poses take about {in_words(needed_bytes)}"
    if free_bytes > _SPARE * needed_bytes:
        yield _row("disk", State.OK, finding, "", **figures)
    else:
        state = State.LOOK if free_bytes > needed_bytes else State.BAD
        yield _row("disk", state, finding, "free some space, or choose another disk", **figures)


def _time_to_write(folder: Path) -> float:
    with tempfile.TemporaryFile(dir=folder) as probe:
        began_s = time.monotonic()
        probe.write(os.urandom(_PROBE_BYTES))
        probe.flush()
        os.fsync(probe.fileno())
        return time.monotonic() - began_s


def _ports() -> Iterator[Row]:
    closed = [port.path for port in serial_ports() if port.usb_id and not os.access(port.path, os.R_OK | os.W_OK)]
    if closed:
        remedy = "run `sudo usermod -a -G dialout $USER`, then log out and in again"
        yield _row("permission", State.LOOK, f"none for {', '.join(closed)}", remedy)


def _clock() -> Row:
    resolution_s, late_s = time.get_clock_info("monotonic").resolution, _lateness_s()
    figures = {"resolution_s": resolution_s, "late_s": late_s}
    finding = f"monotonic, to {resolution_s * 1e9:.0f} ns; a pause ends at most {1e3 * late_s:.1f} ms late"
    if resolution_s > _RESOLUTION_S:
        return _row("clock", State.BAD, finding, "use a system whose monotonic clock is finer than 0.1 ms", **figures)
    if late_s > _LATE_S:
        return _row("clock", State.LOOK, finding, "close other programs", **figures)
    return _row("clock", State.OK, finding, "", **figures)


def _lateness_s() -> float:
    late_s = 0.0
    for _ in range(_NAPS):
        began_s = time.monotonic()
        time.sleep(_NAP_S)
        late_s = max(late_s, time.monotonic() - began_s - _NAP_S)
    return late_s


def _load() -> Iterator[Row]:
    if not hasattr(os, "getloadavg"):
        return
    load, cores = os.getloadavg()[0], os.cpu_count() or 1
    finding = f"{load:.1f} of {cores} cores busy over the last minute"
    busy = load > _BUSY * cores
    remedy = "close other programs" if busy else ""
    yield _row("load", State.LOOK if busy else State.OK, finding, remedy, load=load, cores=cores)


def _row(subject: str, state: State, finding: str, remedy: str = "", **figures: float) -> Row:
    return Row(Part.COMPUTER, subject, state, finding, remedy, figures)
