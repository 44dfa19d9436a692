"""The simulated board for tests: builds it and the firmware with make, starts it, resets it, reads its trace."""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import serial
from numpy.typing import NDArray

FIRMWARE = Path(__file__).parents[1] / "firmware"
BUILD = FIRMWARE / "build"
OPTIBOOT = BUILD / "optiboot.hex"  # made when a board with it is started
CPU_HZ = 16_000_000
# The Uno's pins by the names of the chip's ports: digital pins 2 to 7, 8 and 13.
BUZZER_PINS = {number: f"PD{number + 1}" for number in range(1, 7)}
SYNC_PIN = "PB0"
LED_PIN = "PB5"


@cache
def make(target: str = "all") -> None:
    """Run `make` in firmware/, one at a time however many test processes there are."""
    BUILD.mkdir(exist_ok=True)
    with (BUILD / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        run = subprocess.run(["make", "-C", FIRMWARE, target], capture_output=True, text=True, check=False)
    assert run.returncode == 0, f"make -C firmware {target} failed:\n{run.stdout}{run.stderr}"


def firmware(board: str = "uno", kind: str = "elf") -> Path:
    """Build the firmware and return its image: the .elf or the .hex for "uno", "nano" or "mega"."""
    make()
    return BUILD / f"buzzer-board-{board}.{kind}"


@dataclass(frozen=True)
class Trace:
    """Every change of the board's output pins.

    Parameters
    ----------
    edges : dict
        Pin name such as "PD2" -> (times_s (n,), levels (n,)): when it changed since power-on, and to what.
    resets : list of (time_s, cause)
        "power", "external" or "watchdog".
    """

    edges: dict[str, tuple[NDArray[np.float64], NDArray[np.int64]]]
    resets: list[tuple[float, str]]

    def pin(self, name: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return a pin's edges; empty arrays for one that never changed."""
        return self.edges.get(name, (np.empty(0), np.empty(0, dtype=np.int64)))


def read_trace(path: Path) -> Trace:
    """Read the file that `simboard --trace` writes; an unfinished last line is left out."""
    rows: dict[str, list[tuple[float, int]]] = {}
    resets = []
    for line in path.read_text().rpartition("\n")[0].splitlines():
        if line.startswith("#"):
            continue
        cycle, pin, level = line.split()
        if pin == "RESET":
            resets.append((int(cycle) / CPU_HZ, level))
        else:
            rows.setdefault(pin, []).append((int(cycle) / CPU_HZ, int(level)))
    edges = {pin: (np.array([t for t, _ in of]), np.array([level for _, level in of])) for pin, of in rows.items()}
    return Trace(edges, resets)


@dataclass(frozen=True)
class Pace:
    """When the simulated board really ran, as it wrote down itself every 0.2 ms.

    Parameters
    ----------
    board_s : (n,) array
        Board time since power-on.
    host_s : (n,) array
        The host's monotonic clock then.
    """

    board_s: NDArray[np.float64]
    host_s: NDArray[np.float64]

    def host_time_s(self, board_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return when it was, by the host's clock, that the board came to these times since power-on."""
        return np.interp(board_s, self.board_s, self.host_s)

    def late_s(self, board_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how far the board was then behind where a real one, which never stands still, would have been."""
        delay_s = self.host_s - self.board_s
        return self.host_time_s(board_s) - board_s - delay_s.min()


@dataclass(frozen=True)
class SimulatedBoard:
    """A running simulated board."""

    port: str
    pid: int
    trace_path: Path
    pace_path: Path
    process: subprocess.Popen[str]

    def reset(self) -> None:
        """Press its reset button."""
        os.kill(self.pid, signal.SIGUSR1)

    def trace(self) -> Trace:
        """Return what its pins did; up to 5 ms of board time may still be missing while it runs."""
        return read_trace(self.trace_path)

    def pace(self) -> Pace:
        """Return when it ran; up to 5 ms of board time may still be missing while it runs."""
        rows = self.pace_path.read_text().rpartition("\n")[0].splitlines()[1:]
        cycle, nanoseconds = np.array([row.split() for row in rows], dtype=np.int64).T
        return Pace(cycle / CPU_HZ, 1e-9 * nanoseconds)

    def settle(self, board_s: float = 0.01) -> None:
        """Wait until that much of the board's own time has passed, and what happened till now is in the trace."""
        with Talk(self.port) as host:
            host.serial.write(b"*\n")
            start_us = host.now_us()
            while (host.now_us() - start_us) % 2**32 < 1e6 * board_s:
                time.sleep(0.002)


class Talk:
    """A raw host: lines out and in over a real serial port, with nothing of the project's host side in between."""

    def __init__(self, port: str) -> None:
        self.serial = serial.Serial(port, 115200, timeout=20, exclusive=False)
        self.events: list[str] = []

    def __enter__(self) -> Talk:
        return self

    def __exit__(self, *_: object) -> None:
        self.serial.close()

    def restart(self, board: SimulatedBoard) -> dict[str, str]:
        """Reset the board and return the values of its `! boot`, whatever it was saying before."""
        board.reset()
        while (boot := self.next_boot())["reset"] == "power":
            pass
        return boot

    def next_boot(self) -> dict[str, str]:
        """Return the values of the next `! boot`, skipping whatever else the board says."""
        while "! boot " not in (line := self.serial.readline().decode()):
            assert line, "the board does not start"
        return values(line.rpartition("*")[0])

    def send(self, text: str) -> None:
        """Send a line with its checksum."""
        self.serial.write(with_checksum(text).encode() + b"\n")

    def line(self) -> str:
        """Return the next line without its checksum, which must fit."""
        line = self.serial.readline().decode()
        assert line.endswith("\n"), f"the board says nothing more than {line!r}"
        text, _, _ = line.rpartition("*")
        assert line == with_checksum(text) + "\n"
        return text

    def ask(self, text: str) -> dict[str, str]:
        """Send a command and return its reply's values; an error is {"err": name}. Events are kept."""
        self.send(text)
        while (line := self.line()).startswith("!"):
            self.events.append(line)
        seq, outcome, *words = line.split()
        assert seq == text.split(maxsplit=1)[0], f"{text!r} was answered {line!r}"
        return {"err": words[1]} if outcome == "err" else values(line)

    def now_us(self) -> int:
        """Return the board's clock, skipping whatever else it says."""
        self.send("9 ping")
        while not (line := self.serial.readline()).startswith(b"9 ok us="):
            assert line, "the board does not answer"
        return int(values(line.decode().rpartition("*")[0])["us"])

    def event(self, kind: str) -> dict[str, str]:
        """Return the values of the next event, which must be of this kind."""
        line = self.events.pop(0) if self.events else self.line()
        assert line.startswith(f"! {kind} "), line
        return values(line)

    def play(self, text: str) -> tuple[int, int]:
        """Play, wait for the end, and return the board's times in microseconds of `! on` and `! off`."""
        assert "on_us" in self.ask(text), text
        return int(self.event("on")["us"]), int(self.event("off")["us"])


def values(line: str) -> dict[str, str]:
    """Return the `key=value` words of a line."""
    return dict(word.split("=", 1) for word in line.split() if "=" in word)


def with_checksum(text: str) -> str:
    """Return a line's text with its checksum, worked out apart from the project's own code."""
    crc = 0
    for byte in text.encode():
        for bit in range(7, -1, -1):
            crc = (crc << 1 | byte >> bit & 1) ^ (0x107 if crc & 0x80 else 0)
    for _ in range(8):
        crc = crc << 1 ^ (0x107 if crc & 0x80 else 0)
    return f"{text}*{crc:02X}"


@contextmanager
def running_board(
    image: Path | Sequence[Path] | None = None,
    *,
    dtr: bool = False,
    fast: bool = False,
    mcu: str = "atmega328p",
    may_be_killed: bool = False,
) -> Iterator[SimulatedBoard]:
    """Run a simulated board until the block ends.

    Parameters
    ----------
    image : path or paths, optional
        What is in its flash; default the Uno's firmware. `OPTIBOOT` alone is a board as bought.
    dtr : bool
        Reset the board whenever a host opens its port, as a real Uno does.
    fast : bool
        As fast as the machine can, instead of real time.
    mcu : str
        "atmega328p", or "atmega2560" for a Mega.
    may_be_killed : bool
        Any end of it will do.
    """
    make("simboard")
    images = [firmware()] if image is None else [image] if isinstance(image, Path) else list(image)
    if OPTIBOOT in images:
        make("optiboot")
    flags = [flag for flag, is_set in (("--dtr", dtr), ("--fast", fast)) if is_set]
    with TemporaryDirectory() as folder:
        trace, pace = Path(folder) / "trace.txt", Path(folder) / "pace.txt"
        words = [BUILD / "simboard", "--mcu", mcu, "--trace", trace, "--pace", pace, *flags, *images]
        command = [str(word) for word in words]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as board:
            try:
                assert board.stdout is not None
                port = board.stdout.readline().strip()
                assert port, f"the simulated board did not start: {command}"
                yield SimulatedBoard(port, board.pid, trace, pace, board)
            finally:
                board.terminate()
                ended = board.wait(timeout=10)
        assert ended == 0 or may_be_killed, f"the simulated board ended with code {ended}"
