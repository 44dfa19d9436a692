"""avrdude: how each board is written with it, and what its complaints mean."""

from __future__ import annotations

import re
import shutil
import subprocess
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from acquire.errors import CaptureError, DeviceError

_LIMIT_S = 90.0
_HOPELESS = re.compile(r"attempt 2 of")  # ten attempts take a minute, and a board that is there answers the first
_NEXT_GUESS = {
    "nano": "try --board nano-old, its older bootloader, ",
    "nano-old": "try --board nano, its newer bootloader, ",
}
_MEANINGS = {
    r"permission denied": "no permission to use {port}: `sudo usermod -a -G dialout $USER`, then log out and in again",
    r"resource busy|device busy": "another program uses {port}: close serial monitors and captures, and try again",
    r"no such file|cannot open port|can't open device": "{port} is gone: plug the board in again, and try again",
    # avrdude names the signature in every run, good or bad: only its complaint counts
    r"expected signature|invalid (device )?signature|double check chip": (
        "the chip at {port} is not the {chip} of a {board}: name the right board with --board; other chips, "
        "such as the ATmega168 of some old Nanos, cannot run this firmware"
    ),
    r"verif\w+ (error|mismatch|failed)|mismatch": (
        "what stands on the board at {port} is not what was written: try again, with another cable or USB port"
    ),
    r"not in sync|not responding|timeout|timed out": (
        "no bootloader of a {board} answers at {port} (not in sync): check that this is the board's port, and --board, "
        "{guess}unplug what is wired to pins 0 and 1, and try again"
    ),
}
_UNKNOWN = "avrdude failed at {port}, for the reason it gives above: try another cable and USB port"


class ToolError(CaptureError):
    """A program that is needed is not installed, or a file it needs is not there."""

    exit_code = 2


class AvrdudeError(DeviceError):
    """avrdude failed; `output` is what it said where the message does not tell what it means."""

    def __init__(self, message: str, output: str = "") -> None:
        super().__init__(message)
        self.output = output


@dataclass(frozen=True)
class BoardKind:
    """How a kind of board is written: its name, chip, bootloader's protocol and speed, and whose image it takes."""

    name: str
    chip: str
    programmer: str
    baud: int
    image: str


BOARDS = {
    kind.name: kind
    for kind in (
        BoardKind("uno", "atmega328p", "arduino", 115200, "uno"),
        BoardKind("nano", "atmega328p", "arduino", 115200, "nano"),
        BoardKind("nano-old", "atmega328p", "arduino", 57600, "nano"),
        BoardKind("mega", "atmega2560", "wiring", 115200, "mega"),
    )
}


def command(kind: BoardKind, port: str, image: Path) -> list[str]:
    """Return the command line that writes an image and reads it back."""
    flash = f"flash:w:{image}:i"
    return ["avrdude", "-p", kind.chip, "-c", kind.programmer, "-P", port, "-b", str(kind.baud), "-D", "-U", flash]


def check_installed() -> None:
    """Raise ToolError where avrdude is not installed."""
    if shutil.which("avrdude") is None:
        raise ToolError(
            "avrdude is not installed: `sudo apt install avrdude` on Debian and Ubuntu, `brew install avrdude` on macOS"
        )


def write_image(kind: BoardKind, port: str, image: Path, hear: Callable[[str], None]) -> None:
    """Write an image to a board and verify it; `hear` gets each line that avrdude says.

    Raises
    ------
    AvrdudeError
        It failed.
    """
    arguments = command(kind, port, image)
    with subprocess.Popen(  # noqa: S603
        arguments, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
    ) as process:
        guard = threading.Timer(_LIMIT_S, process.kill)
        guard.start()
        try:
            output = _listen(process, hear)
            process.wait()
        finally:
            guard.cancel()
            process.kill()
    if process.returncode:
        meaning = explain(output, kind, port)
        raise AvrdudeError(meaning or _UNKNOWN.format(port=port), "" if meaning else output)


def explain(output: str, kind: BoardKind, port: str) -> str:
    """Say in one line what avrdude's complaint means, and what to do; empty where it is not known."""
    for pattern, meaning in _MEANINGS.items():
        if re.search(pattern, output, re.IGNORECASE):
            return meaning.format(port=port, board=kind.name, chip=kind.chip, guess=_NEXT_GUESS.get(kind.name, ""))
    return ""


def _listen(process: subprocess.Popen[str], hear: Callable[[str], None]) -> str:
    """Return what avrdude says, ending it once it is hopeless."""
    lines = []
    assert process.stdout is not None
    for line in process.stdout:
        lines.append(line)
        hear(line)
        if _HOPELESS.search(line):
            process.kill()
    return "".join(lines)
