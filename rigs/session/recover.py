"""The recovery: the good part of a session, copied to a new one; the old one is never touched."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rigs.errors import TargetError
from rigs.session import layout
from rigs.session.layers import Header
from rigs.session.layout import MeasuredTdoas
from rigs.session.publication import refuse_existing
from rigs.session.wreck import Wreck
from rigs.session.writer import SessionWriter
from rigs.target import check_target

_SPARE_BYTES = 2**24
_MAX_PLACES = 5
_SILENCE_SAMPLES = 2**16


@dataclass
class Recovery:
    """What a copy holds, and what it does not.

    Parameters
    ----------
    under_way : int or None
        Pose that was being captured when the recording broke off.
    dropped : list of str
        What was damaged or lost; empty when the copy is whole.
    n_accepted, next_pose : int
        Good poses, and the number of the next one.
    """

    duration_s: float = 0.0
    n_frames: int = 0
    n_emissions: int = 0
    n_poses: int = 0
    n_accepted: int = 0
    next_pose: int = 0
    under_way: int | None = None
    dropped: list[str] = field(default_factory=list)

    def kept(self) -> str:
        """Say in words what the copy holds."""
        broken_off = "" if self.under_way is None else f", and pose {self.under_way} in part, which does not count"
        return (
            f"{self.duration_s:.1f} s of sound, {self.n_frames} frames, {self.n_emissions} emissions, "
            f"{self.n_accepted} good poses of {self.n_poses}{broken_off}"
        )


def recover(path: Path, target: Path) -> Recovery:
    """Copy the good part of a cut-off or damaged session to a new, complete one.

    Raises
    ------
    TargetError
        The target is there already, or there is no room for it.
    SessionError
        Nothing can be recovered, or the target cannot be written.
    """
    check_target(target)
    with Wreck.open(path) as wreck:
        check_room(path, target)
        writer = SessionWriter.begin(target, copied_header(wreck), wreck.n_channels)
        try:
            recovery = copy(wreck, writer)
            text = "; ".join(recovery.dropped) or "nothing"
            writer.append_log(math.nan, "warning", f"recovered from {path.name}: {recovery.kept()}; dropped: {text}")
            writer.close()
            refuse_existing(target)
            writer.publish()
        except BaseException:
            writer.discard()
            raise
    return recovery


def check_room(path: Path, target: Path) -> None:
    """Raise TargetError where the disk of `target` has no room for another `path`."""
    needed, free = path.stat().st_size + _SPARE_BYTES, shutil.disk_usage(target.parent).free
    if free < needed:
        raise TargetError(
            f"{target}: the copy needs {needed / 1e9:.2f} GB and this disk has {free / 1e9:.2f} GB free: "
            "free some space or use another disk"
        )


def copied_header(wreck: Wreck) -> Header:
    """Return the header of a copy: that of the old file, marked as recovered from it."""
    old = wreck.header
    return Header(
        old.name,
        old.description_text,
        old.versions,
        old.sample_rate_hz,
        old.truth,
        None if old.corners_px is None else old.corners_px[: len(wreck.tables[layout.POSES])],
        None
        if old.tdoas is None
        else MeasuredTdoas(old.tdoas.tdoa_s[: len(wreck.tables[layout.EMISSIONS])], old.tdoas.pairs),
        old.created_utc,
        recovered=f"from {wreck.path.name}",
    )


def copy(wreck: Wreck, writer: SessionWriter) -> Recovery:
    """Copy all that is good; damaged sound becomes silence of the same length, so that no sample changes its place."""
    recovery = Recovery(dropped=list(wreck.remarks))
    good = _copy_sound(wreck, writer, recovery)
    frames = _copy_frames(wreck, writer, recovery)
    emissions = _still_good_emissions(wreck, good, recovery)
    poses = _with_pose_under_way(_still_good_poses(wreck, emissions, recovery), emissions, frames, recovery)
    counted = {layout.EMISSIONS: emissions, layout.POSES: poses}
    streamed = (layout.AUDIO_BLOCKS, layout.CAMERA_FRAMES)  # copied with their sound and pictures
    writer.extend({name: rows for name, rows in (wreck.tables | counted).items() if name not in streamed})
    writer.flush()
    recovery.n_emissions, recovery.n_poses = len(emissions), len(poses)
    recovery.n_accepted = int(np.count_nonzero(poses["accepted"]))
    recovery.next_pose = int(poses["pose"].max(initial=-1)) + 1
    return recovery


def _copy_sound(wreck: Wreck, writer: SessionWriter, recovery: Recovery) -> NDArray[np.int64]:
    """Copy the sound and return the first sample and the end of each good block (n, 2)."""
    damaged: list[np.void] = []  # since the last good block: silence if a good one follows, else the lost end
    silenced: list[np.void] = []
    good = []
    for block in wreck.tables[layout.AUDIO_BLOCKS]:
        samples = wreck.samples(block)
        if samples is None:
            damaged.append(block)
            continue
        for each in damaged:
            for piece in _silence(each, writer.n_samples, wreck.n_channels):
                writer.append_audio(piece, host_time_s=math.nan, adc_time_s=math.nan, flags=layout.FLAG_SILENCED)
        silenced += damaged
        damaged.clear()
        _append_block(writer, block, samples)
        good.append((int(block["first_sample"]), int(block["first_sample"]) + len(samples)))
    rate_hz = wreck.header.sample_rate_hz
    recovery.duration_s = writer.n_samples / rate_hz
    if silenced:
        recovery.dropped.append(
            f"{_seconds(silenced, rate_hz)} of damaged sound, now silence: {_at(silenced, rate_hz)}"
        )
    if damaged:
        recovery.dropped.append(f"the last {_seconds(damaged, rate_hz)} of sound, damaged or not there")
    return np.array(good, dtype=np.int64).reshape(-1, 2)


def _append_block(writer: SessionWriter, block: np.void, samples: NDArray[np.float32]) -> None:
    writer.append_audio(
        samples,
        host_time_s=float(block["host_time_s"]),
        adc_time_s=float(block["adc_time_s"]),
        flags=int(block["flags"]),
    )


def _silence(block: np.void, begin: int, n_channels: int) -> Iterator[NDArray[np.float32]]:
    end = int(block["first_sample"]) + int(block["n_samples"])
    for first in range(begin, end, _SILENCE_SAMPLES):
        yield np.zeros((min(_SILENCE_SAMPLES, end - first), n_channels), dtype=np.float32)


def _copy_frames(wreck: Wreck, writer: SessionWriter, recovery: Recovery) -> NDArray[np.void]:
    """Copy the pictures and return the rows of those that are good."""
    good = []
    for row, frame in enumerate(wreck.tables[layout.CAMERA_FRAMES]):
        png = wreck.png(frame)
        if png is not None:
            good.append(row)
            writer.append_png(png, host_time_s=float(frame["host_time_s"]), pose=int(frame["pose"]))
    recovery.n_frames = len(good)
    if len(good) < len(wreck.tables[layout.CAMERA_FRAMES]):
        recovery.dropped.append(f"{len(wreck.tables[layout.CAMERA_FRAMES]) - len(good)} damaged or lost frames")
    return wreck.tables[layout.CAMERA_FRAMES][good]


def _still_good_emissions(wreck: Wreck, good: NDArray[np.int64], recovery: Recovery) -> NDArray[np.void]:
    """Return the emissions; those whose sound is not all there count no longer."""
    emissions = wreck.tables[layout.EMISSIONS].copy()
    first = emissions["expected_sample"]
    end = first + round(wreck.description.signal.waveform().duration_s * wreck.header.sample_rate_hz)
    if not recovery.dropped:  # then what was never recorded is not lost
        n_samples = int(wreck.tables[layout.AUDIO_BLOCKS]["n_samples"].sum(dtype=np.int64))
        end = np.minimum(end, np.maximum(first + 1, n_samples))
    n_good = np.concatenate([[0], np.cumsum(good[:, 1] - good[:, 0])])

    def good_before(sample: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return how many samples before each are good."""
        index = np.searchsorted(good[:, 0], sample, side="right")
        if not len(good):
            return np.zeros_like(sample)
        last = np.maximum(index - 1, 0)
        inside = np.clip(sample - good[last, 0], 0, good[last, 1] - good[last, 0])
        return np.asarray(n_good[last] + np.where(index > 0, inside, 0))

    lost = (emissions["accepted"] != 0) & (first >= 0) & (good_before(end) - good_before(first) < end - first)
    emissions["accepted"][lost] = 0
    if lost.any():
        recovery.dropped.append(f"{np.count_nonzero(lost)} emissions count no longer: their sound is damaged or lost")
    return emissions


def _still_good_poses(wreck: Wreck, emissions: NDArray[np.void], recovery: Recovery) -> NDArray[np.void]:
    """Return the poses; those at the end that lost all of their good emissions count no longer.

    One in the middle goes on counting, for its pictures, and so that the k-th good pose stays the k-th.
    """
    poses = wreck.tables[layout.POSES].copy()
    had = np.isin(
        poses["pose"], wreck.tables[layout.EMISSIONS]["pose"][wreck.tables[layout.EMISSIONS]["accepted"] != 0]
    )
    have = np.isin(poses["pose"], emissions["pose"][emissions["accepted"] != 0])
    lost = (poses["accepted"] != 0) & had & ~have
    lost &= np.arange(len(poses)) > np.max(np.flatnonzero((poses["accepted"] != 0) & ~lost), initial=-1)
    poses["accepted"][lost] = 0
    if lost.any():
        recovery.dropped.append(
            f"{np.count_nonzero(lost)} poses at the end count no longer: none of their emissions is left"
        )
    return poses


def _with_pose_under_way(
    poses: NDArray[np.void], emissions: NDArray[np.void], frames: NDArray[np.void], recovery: Recovery
) -> NDArray[np.void]:
    """Add the row of the pose that was under way when the recording broke off: it does not count."""
    number = int(poses["pose"].max(initial=-1)) + 1
    times_s = np.concatenate([each["host_time_s"][each["pose"] == number] for each in (frames, emissions)])
    if not len(times_s):
        return poses
    recovery.under_way = number
    row = np.array([(number, times_s.min(), times_s.max(), 0)], dtype=layout.POSE)
    return np.concatenate([poses, row])


def _seconds(blocks: list[np.void], rate_hz: float) -> str:
    return f"{sum(int(block['n_samples']) for block in blocks) / rate_hz:.2f} s"


def _at(blocks: list[np.void], rate_hz: float) -> str:
    places = [f"at {int(block['first_sample']) / rate_hz:.2f} s" for block in blocks[:_MAX_PLACES]]
    more = len(blocks) - len(places)
    return ", ".join(places) + (f" and {more} more places" if more else "")
