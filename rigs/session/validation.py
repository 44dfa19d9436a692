"""What a session's tables must agree on; each check names what is wrong.

A table of a recording that was cut off may end in rows that never reached the disk: they are left out, with a remark.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rigs.description import RigDescription
from rigs.errors import SessionError

Table = NDArray[Any]


@dataclass
class Judge:
    """Judges the tables of one file.

    Parameters
    ----------
    where : str
        The file, for messages.
    complete : bool
        The recording ended well, so every row must be good.
    remarks : list of str
        What was left out.
    """

    where: str
    complete: bool
    remarks: list[str] = field(default_factory=list)

    def channels(self, n_columns: int, description: RigDescription) -> None:
        """Refuse audio whose columns are not the rig's channels."""
        n_channels = len(description.audio.recorded_channels())
        if n_columns != n_channels:
            raise SessionError(
                f"{self.where}: time_data has {n_columns} channels where the rig description says {n_channels}: "
                "the file was put together from two rigs, or changed"
            )

    def sample_rate(self, rate_hz: object, description: RigDescription) -> float:
        """Return the sample rate in hertz; refuse one that is not the rig's (a measured drift of 0.1 % is let pass)."""
        if not isinstance(rate_hz, int | float):
            raise SessionError(f"{self.where}: the attribute sample_freq of time_data is missing or not a number")
        if not abs(rate_hz / description.audio.sample_rate_hz - 1) <= 1e-3:
            raise SessionError(
                f"{self.where}: time_data was sampled at {rate_hz:g} Hz where the rig description says "
                f"{description.audio.sample_rate_hz} Hz"
            )
        return float(rate_hz)

    def blocks(self, blocks: Table, n_rows: int) -> Table:
        """Return the audio blocks that tile the first rows of `time_data`, without gap or overlap."""
        lengths = blocks["n_samples"].astype(np.int64)
        begins = np.concatenate([[0], np.cumsum(lengths)[:-1]]) if len(blocks) else lengths
        good = (lengths >= 0) & (blocks["first_sample"] == begins) & (begins + lengths <= n_rows)
        blocks = self._trusted(blocks, good, lambda k: f"audio block {k} does not follow the one before in time_data")
        n_tiled = int(blocks["n_samples"].sum(dtype=np.int64))
        if self.complete and n_tiled != n_rows:
            raise SessionError(f"{self.where}: the audio blocks hold {n_tiled} samples, time_data holds {n_rows}")
        return blocks

    def frames(self, frames: Table, n_bytes: int) -> Table:
        """Return the frames that lie within the stream of pictures."""
        offset, length = frames["offset"], frames["length"]
        good = (offset >= 0) & (length > 0) & (length <= n_bytes) & (offset <= n_bytes - length)
        return self._trusted(frames, good, lambda k: f"frame {k} lies outside of camera/stream ({n_bytes} bytes)")

    def poses(self, poses: Table) -> Table:
        """Return the poses that are counted from 0."""
        number = poses["pose"]
        first_of_its_number = np.zeros(len(number), dtype=bool)
        first_of_its_number[np.unique(number, return_index=True)[1]] = True
        good = (number >= 0) & first_of_its_number
        return self._trusted(
            poses, good, lambda k: f"row {k} of poses has the number {number[k]}, negative or a second time"
        )

    def emissions(self, emissions: Table, poses: Table, description: RigDescription) -> Table:
        """Return the emissions of buzzers the rig has, in poses the session has."""
        buzzers = [buzzer.id for buzzer in description.board.buzzers]
        under_way = int(poses["pose"].max(initial=-1)) + 1  # its row is written when it is done
        known_pose = np.isin(emissions["pose"], [*poses["pose"], under_way])
        emissions = self._trusted(
            emissions,
            np.isin(emissions["buzzer"], buzzers),
            lambda k: f"emission {k} names buzzer {emissions['buzzer'][k]}, the rig has {buzzers}",
        )
        known_pose = known_pose[: len(emissions)]
        return self._trusted(
            emissions, known_pose, lambda k: f"emission {k} names pose {emissions['pose'][k]}, which is not in poses"
        )

    def measured_rows(self, n_measured: int, n_rows: int | None, what: str) -> None:
        """Refuse a measured layer that does not belong to its table; None: its table is not known yet."""
        if n_rows is not None and n_measured != n_rows:
            raise SessionError(f"{self.where}: {what} has {n_measured} rows, its table has {n_rows}")

    def _trusted(self, rows: Table, good: NDArray[np.bool_], complaint: Callable[[int], str]) -> Table:
        if good.all():
            return rows
        first = int(np.argmin(good))
        if self.complete:
            raise SessionError(f"{self.where}: {complaint(first)}")
        self.remarks.append(f"{complaint(first)}: this row and the {len(rows) - first - 1} after it are left out")
        return rows[:first]
