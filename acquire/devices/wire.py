"""The wire: bytes to messages and back, as firmware/PROTOCOL.md has it. Nothing here touches a port."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from rigs.waveform import Waveform

PROTOCOL_VERSION = 1
MAX_LINE_BYTES = 255  # of what the board says: twice as long as today's longest, for keys of a later firmware
SEQUENCE_NUMBERS = 1 << 16
ERROR_CHECKSUM, ERROR_LINE, ERROR_BUSY, ERROR_FAULT = 1, 2, 6, 8


@dataclass(frozen=True)
class Reply:
    """The board's answer to one command.

    Parameters
    ----------
    seq : int
        Of the command; 0 where the board could not read it.
    fields : mapping of str to str
        Keys and values; empty for an error.
    error : int
        The protocol's error number, 0 for `ok`.
    error_name : str
    """

    seq: int
    fields: Mapping[str, str] = field(default_factory=dict)
    error: int = 0
    error_name: str = ""


@dataclass(frozen=True)
class Event:
    """What the board says unasked: `kind` is boot, on, off, fault, or a word of a later firmware."""

    kind: str
    fields: Mapping[str, str] = field(default_factory=dict)


Message = Reply | Event


def crc8(content: bytes) -> int:
    """Return the CRC-8 (polynomial 0x07, first value 0) of some bytes."""
    crc = 0
    for byte in content:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ (0x07 if crc & 0x80 else 0)) & 0xFF
    return crc


def encode(seq: int, verb: str, *arguments: str | int) -> bytes:
    """Return the line of a command, with checksum and line feed."""
    line = " ".join(str(word) for word in (seq, verb, *arguments)).encode("ascii")
    return b"%s*%02X\n" % (line, crc8(line))


def play_arguments(buzzer: int, waveform: Waveform) -> tuple[str | int, ...]:
    """Return the arguments of the command `play`; frequencies in hertz, times in microseconds, all whole numbers."""
    if waveform.kind == "mls":
        return buzzer, "mls", waveform.order, round(waveform.chip_rate_hz)
    duration_us = round(1e6 * waveform.duration_s)
    if waveform.kind == "tone":
        return buzzer, "tone", round(waveform.start_hz), duration_us
    return buzzer, "sweep", round(waveform.start_hz), round(waveform.stop_hz), duration_us


def decode(line: bytes) -> Message | None:
    """Return the message in a line (without its line feed), None where there is none with a checksum that fits."""
    content, star, digits = line.removesuffix(b"\r").rpartition(b"*")
    if not star or len(content) + 3 > MAX_LINE_BYTES or digits.upper() != b"%02X" % crc8(content):
        return None
    words = content.decode("latin-1").split(" ")
    if words[0] == "!":
        return Event(words[1], _fields(words[2:])) if len(words) > 1 else None
    seq = _number(words[0])
    if seq is None or seq >= SEQUENCE_NUMBERS or len(words) < 2:
        return None
    if words[1] == "ok":
        return Reply(seq, _fields(words[2:]))
    error = _number(words[2]) if words[1] == "err" and len(words) > 3 else None
    return Reply(seq, error=error, error_name=words[3]) if error else None


class LineDecoder:
    """Finds messages in a stream of bytes, whatever else is in it.

    Attributes
    ----------
    skipped : int
        How many lines were no messages: garbage, halves of lines, checksums that do not fit.
    """

    def __init__(self) -> None:
        self.skipped = 0
        self._rest = b""

    def feed(self, received: bytes) -> list[Message]:
        """Take in what was received and return the messages that are now whole, in order."""
        *lines, rest = (self._rest + received).split(b"\n")
        self._rest = rest[-2 * MAX_LINE_BYTES :]  # no message is longer, so nothing of one is lost
        return [message for line in lines if (message := self._message(line)) is not None]

    def _message(self, line: bytes) -> Message | None:
        """Decode a line; a board that restarts in mid-line leaves half of it before its `! boot`.

        That half is cut off first: where its own checksum happens to be 0, that of the whole would fit as well.
        """
        if not line.strip(b"\r"):
            return None
        half, mark, event = line.rpartition(b"! ")
        message = decode(mark + event)
        if half or message is None:
            self.skipped += 1
        return message


def _fields(words: list[str]) -> dict[str, str]:
    return {key: value for key, equals, value in (word.partition("=") for word in words) if equals and key}


def _number(word: str) -> int | None:
    return int(word) if word.isascii() and word.isdecimal() and len(word) <= 10 else None
