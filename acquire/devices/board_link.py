"""The link to a board: one command at a time over an open port, its reply, and the events in between."""

from __future__ import annotations

import itertools
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from acquire.devices.wire import (
    ERROR_CHECKSUM,
    ERROR_LINE,
    SEQUENCE_NUMBERS,
    Event,
    LineDecoder,
    Message,
    Reply,
    encode,
)
from acquire.errors import DeviceError, DeviceRestartedError
from rigs.errors import reason

if TYPE_CHECKING:
    from serial import Serial

_TIMEOUT_S = 1.0
_TRIES = 3
# One sequence for all links, from wherever: a late reply to an earlier link or host is not taken for ours.
_NUMBERS = itertools.count(time.monotonic_ns() // 1_000_000)


class NoAnswerError(DeviceError):
    """The board did not answer a command in time."""


class BoardRestartedError(DeviceRestartedError):
    """The board said `! boot`: what it was told before is forgotten."""


class PortLostError(DeviceError):
    """The port is gone, most likely unplugged."""


@dataclass(frozen=True)
class Answer:
    """A reply, and the host times of its round trip."""

    reply: Reply
    sent_s: float
    received_s: float


class BoardLink:
    """Commands and replies over a port that is open.

    Parameters
    ----------
    port : serial.Serial
    is_given_up : threading.Event, optional
        Once somebody sets it, commands and waiting end, without an answer.

    Attributes
    ----------
    seq : int
        Of the last command.
    n_bytes, n_messages : int
        Received so far, whatever they were; lines whose checksum fits.
    n_stale : int
        Replies that came too late, or to nobody's command.
    last_on, last_fault : Event or None
        The newest of their kind.
    """

    def __init__(self, port: Serial, is_given_up: threading.Event | None = None) -> None:
        self._port, self._decoder = port, LineDecoder()
        self._is_given_up = is_given_up or threading.Event()
        self.seq = 0
        self.n_bytes, self.n_messages, self.n_stale = 0, 0, 0
        self.last_on: Event | None = None
        self.last_fault: Event | None = None

    @property
    def path(self) -> str:
        """The port's name."""
        return str(self._port.port)

    @property
    def n_skipped(self) -> int:
        """How many lines could not be read."""
        return self._decoder.skipped

    def ask(self, verb: str, *arguments: str | int, timeout_s: float | None = None) -> Answer:
        """Send a command once and wait for its reply, which may be an error.

        Raises
        ------
        NoAnswerError, BoardRestartedError, PortLostError
        """
        limit_s = _TIMEOUT_S if timeout_s is None else timeout_s
        self.catch_up()
        self.seq = next(_NUMBERS) % (SEQUENCE_NUMBERS - 1) + 1  # 0 is for lines that the board could not read
        sent_s = time.monotonic()
        if not self._is_given_up.is_set():
            self._send(encode(self.seq, verb, *arguments))
        is_late = False
        while not (is_late or self._is_given_up.is_set()):
            is_late = time.monotonic() > sent_s + limit_s  # one look more: the host itself may have stood still
            for message in self._receive():
                if isinstance(message, Reply) and self._is_ours(message):
                    return Answer(message, sent_s, time.monotonic())
        raise NoAnswerError(f"{self.path}: the board did not answer `{verb}` within {limit_s:g} s: check its cable")

    def ask_safely(self, verb: str, *arguments: str | int) -> Answer:
        """Ask again where a command or its reply was spoilt: for commands that may well be carried out twice.

        Raises
        ------
        DeviceError
            No answer, or an error of the board.
        """
        for _ in range(_TRIES - 1):
            try:
                answer = self.ask(verb, *arguments)
            except NoAnswerError:
                continue
            if not answer.reply.error:
                return answer
        answer = self.ask(verb, *arguments)
        if answer.reply.error:
            raise DeviceError(
                f"{self.path}: the board refuses `{verb}`: error {answer.reply.error_name}: unplug it once"
            )
        return answer

    def wait_for_boot(self, timeout_s: float) -> bool:
        """Wait until the board says that it has started; False when it does not. Raises PortLostError."""
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s and not self._is_given_up.is_set():
            try:
                self._receive()
            except BoardRestartedError:
                return True
        return False

    def catch_up(self) -> None:
        """Take in what has come unasked. Raises BoardRestartedError and PortLostError."""
        while self._waiting():
            self.n_stale += sum(isinstance(message, Reply) for message in self._receive())

    def close(self) -> None:
        """Let the port go; safe to call twice."""
        self._port.close()

    def _is_ours(self, reply: Reply) -> bool:
        unreadable = reply.seq == 0 and reply.error in (ERROR_CHECKSUM, ERROR_LINE)
        if reply.seq == self.seq or unreadable:
            return True
        self.n_stale += 1
        return False

    def _receive(self) -> list[Message]:
        """Return what came in, at most a read's time-out later; events are remembered."""
        try:
            received = self._port.read(max(1, self._port.in_waiting))
        except OSError as error:
            raise self._lost(error) from error
        self.n_bytes += len(received)
        messages = self._decoder.feed(received)
        self.n_messages += len(messages)
        for message in messages:
            if isinstance(message, Event):
                self._note(message)
        return messages

    def _note(self, event: Event) -> None:
        if event.kind == "boot":
            why = event.fields.get("reset", "unknown")
            raise BoardRestartedError(f"{self.path}: the board restarted (reset={why}): check its cable and its power")
        if event.kind == "on":
            self.last_on = event
        elif event.kind == "fault":
            self.last_fault = event

    def _waiting(self) -> int:
        try:
            return self._port.in_waiting
        except OSError as error:
            raise self._lost(error) from error

    def _send(self, line: bytes) -> None:
        try:
            self._port.write(line)
        except OSError as error:
            raise self._lost(error) from error

    def _lost(self, error: OSError) -> PortLostError:
        return PortLostError(f"{self.path}: the board is gone ({reason(error)}): plug it in again")
