"""The pins of the simulated board as they change: its trace, followed while it is written."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from simboard import CPU_HZ

_PACE = re.compile(rb"# pace: cycle 0 at ([\d.]+) s")


@dataclass(frozen=True)
class Edge:
    """A change of an output pin such as "PD2": when, in host monotonic time, and to which level (0 or 1)."""

    pin: str
    time_s: float
    level: int


class PinTrace:
    """Follows the file that `simboard --trace` writes; the board must run at the pace of real time.

    An edge has the time it was due, not the time at which a busy machine came round to it.

    Parameters
    ----------
    path : Path
    """

    def __init__(self, path: Path) -> None:
        self._path, self._file = path, None
        self._rest = b""
        self._start_s: float | None = None

    def new_edges(self) -> list[Edge]:
        """Return what has been written since the last call, in order."""
        if self._file is None:
            if not self._path.exists():
                return []
            self._file = self._path.open("rb")
        *lines, self._rest = (self._rest + self._file.read()).split(b"\n")
        return [edge for edge in map(self._edge, lines) if edge]

    def close(self) -> None:
        """Let the file go."""
        if self._file is not None:
            self._file.close()

    def _edge(self, line: bytes) -> Edge | None:
        if pace := _PACE.match(line):
            self._start_s = float(pace[1])
        if line.startswith(b"#"):
            return None
        cycle, pin, level = line.split()
        if pin == b"RESET" or self._start_s is None:
            return None
        return Edge(pin.decode(), self._start_s + int(cycle) / CPU_HZ, int(level))
