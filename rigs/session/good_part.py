"""The good part of a session: copied to another, with what is damaged made silent or left out, and told."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rigs.interruption import interrupted_between_steps
from rigs.session import layout
from rigs.session.wreck import Wreck
from rigs.session.writer import SessionWriter

# Gives the rows on, and shows how far it is, and with what.
Watch = Callable[[NDArray[np.void], str], Iterable[np.void]]
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


def unwatched(rows: NDArray[np.void], _what: str) -> Iterable[np.void]:
    """Show nothing."""
    return rows


def copy(wreck: Wreck, writer: SessionWriter, watch: Watch = unwatched) -> Recovery:
    """Copy all that is good; damaged sound becomes silence of the same length, so that no sample changes its place."""
    with interrupted_between_steps() as check:
        return _copy(wreck, writer, lambda rows, what: _checked(watch(rows, what), check))


def _checked(rows: Iterable[np.void], check: Callable[[], None]) -> Iterator[np.void]:
    for row in rows:
        check()
        yield row


def _copy(wreck: Wreck, writer: SessionWriter, watch: Watch) -> Recovery:
    recovery = Recovery(dropped=list(wreck.remarks))
    good = _copy_sound(wreck, writer, recovery, watch)
    frames = _copy_frames(wreck, writer, recovery, watch)
    emissions = _still_good_emissions(wreck, good, recovery)
    poses = _with_pose_under_way(_still_good_poses(wreck, emissions, frames, recovery), emissions, frames, recovery)
    counted = {layout.EMISSIONS: emissions, layout.POSES: poses}
    streamed = (layout.AUDIO_BLOCKS, layout.CAMERA_FRAMES)  # copied with their sound and pictures
    writer.extend({name: rows for name, rows in (wreck.tables | counted).items() if name not in streamed})
    writer.flush()
    recovery.n_emissions, recovery.n_poses = len(emissions), len(poses)
    recovery.n_accepted = int(np.count_nonzero(poses["accepted"]))
    recovery.next_pose = int(poses["pose"].max(initial=-1)) + 1
    return recovery


def _copy_sound(wreck: Wreck, writer: SessionWriter, recovery: Recovery, watch: Watch) -> NDArray[np.int64]:
    """Copy the sound and return the first sample and the end of each good block (n, 2)."""
    damaged: list[np.void] = []  # since the last good block: silence if a good one follows, else the lost end
    silenced: list[np.void] = []
    blocks = wreck.tables[layout.AUDIO_BLOCKS]
    is_good = np.ones(len(blocks), dtype=bool)
    for row, block in enumerate(watch(blocks, "copying sound")):
        samples = wreck.samples(block)
        if samples is None:
            damaged.append(block)
            is_good[row] = False
            continue
        _append_silence(writer, damaged, wreck.n_channels)
        silenced += damaged
        damaged.clear()
        _append_block(writer, block, samples)
    recovery.duration_s = writer.n_samples / wreck.header.sample_rate_hz
    recovery.dropped += _lost_sound(silenced, damaged, wreck.header.sample_rate_hz)
    first = blocks["first_sample"][is_good]
    return np.stack([first, first + blocks["n_samples"][is_good]], axis=1)


def _append_block(writer: SessionWriter, block: np.void, samples: NDArray[np.float32]) -> None:
    writer.append_audio(
        samples,
        host_time_s=float(block["host_time_s"]),
        adc_time_s=float(block["adc_time_s"]),
        flags=int(block["flags"]),
    )


def _append_silence(writer: SessionWriter, blocks: list[np.void], n_channels: int) -> None:
    """Append silence as long as the damaged blocks, from where the writer is to where the last of them ends."""
    for block in blocks:
        end = int(block["first_sample"]) + int(block["n_samples"])
        for first in range(writer.n_samples, end, _SILENCE_SAMPLES):
            silence = np.zeros((min(_SILENCE_SAMPLES, end - first), n_channels), dtype=np.float32)
            writer.append_audio(silence, host_time_s=math.nan, adc_time_s=math.nan, flags=layout.FLAG_SILENCED)


def _lost_sound(silenced: list[np.void], cut_off: list[np.void], rate_hz: float) -> list[str]:
    """Say in words what sound is lost."""
    lost = []
    if silenced:
        lost.append(f"{_seconds(silenced, rate_hz)} of damaged sound, now silence: {_at(silenced, rate_hz)}")
    if cut_off:
        lost.append(f"the last {_seconds(cut_off, rate_hz)} of sound, damaged or not there")
    return lost


def _copy_frames(wreck: Wreck, writer: SessionWriter, recovery: Recovery, watch: Watch) -> NDArray[np.void]:
    """Copy the pictures and return the rows of those that are good."""
    frames = wreck.tables[layout.CAMERA_FRAMES]
    good = []
    for row, frame in enumerate(watch(frames, "copying pictures")):
        png = wreck.png(frame)
        if png is not None:
            good.append(row)
            writer.append_png(png, host_time_s=float(frame["host_time_s"]), pose=int(frame["pose"]))
    recovery.n_frames = len(good)
    if len(good) < len(frames):
        recovery.dropped.append(f"{len(frames) - len(good)} damaged or lost frames")
    return frames[good]


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


def _still_good_poses(
    wreck: Wreck, emissions: NDArray[np.void], frames: NDArray[np.void], recovery: Recovery
) -> NDArray[np.void]:
    """Return the poses; those at the end that lost all of their good emissions, or all pictures, count no longer.

    One in the middle goes on counting, so that the k-th good pose stays the k-th.
    """
    poses, before = wreck.tables[layout.POSES].copy(), wreck.tables[layout.EMISSIONS]
    lost = np.zeros(len(poses), dtype=bool)
    for had, have in (
        (before["pose"][before["accepted"] != 0], emissions["pose"][emissions["accepted"] != 0]),
        (wreck.tables[layout.CAMERA_FRAMES]["pose"], frames["pose"]),
    ):
        lost |= np.isin(poses["pose"], had) & ~np.isin(poses["pose"], have)
    lost &= poses["accepted"] != 0
    lost &= np.arange(len(poses)) > np.max(np.flatnonzero((poses["accepted"] != 0) & ~lost), initial=-1)
    poses["accepted"][lost] = 0
    if lost.any():
        recovery.dropped.append(
            f"{np.count_nonzero(lost)} poses at the end count no longer: their emissions or their pictures are all lost"
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
