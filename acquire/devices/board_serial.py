"""The buzzer board at a serial port."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from threading import Event, Lock

from acquire.devices.base import ClockFit, EmissionStart, Ping
from acquire.devices.board_clock import BoardClock
from acquire.devices.board_hello import Hello, check_fits, connect, number
from acquire.devices.board_link import BoardLink, NoAnswerError, PortLostError
from acquire.devices.wire import ERROR_BUSY, ERROR_CHECKSUM, ERROR_FAULT, ERROR_LINE, Reply, play_arguments
from acquire.errors import DeviceError, DeviceRestartedError
from acquire.ports import choose_port, serial_ports
from rigs.waveform import Waveform

_FIRST_PINGS = 8
_TRIES = 3
_QUIET_S = 0.5  # after an emission of which nobody knows when it began
_LEFT_BEHIND_S = 0.2  # for the reply of a board that does not answer another thread either
_OVERDUE_S, _LOOK_S = 2.0, 0.02  # how long a sound may outlast its time by the host's clock
_PLAYS_COUNTED = 1 << 16


class SerialBoard:
    """Plays the buzzers of a real board, or of the simulated Uno that runs its firmware.

    Parameters
    ----------
    port : str
        "auto", a path, or USB ids as VID:PID or VID:PID:SERIAL.
    waveform : Waveform
    buzzers : sequence of int
        What will be played, and where: checked when the board is opened, before anything sounds.

    Attributes
    ----------
    clock : BoardClock
        The board's clock since its last start.
    """

    def __init__(self, port: str, waveform: Waveform, buzzers: Sequence[int]) -> None:
        self._wanted, self._waveform, self._buzzers = port, waveform, tuple(buzzers)
        self._link: BoardLink | None = None
        self._n_buzzers, self._n_plays = 0, 0
        self._over_s = 0.0  # when the last sound should end
        self.clock = BoardClock()
        self._pings: list[Ping] = []  # that nobody has asked for yet
        self._is_given_up, self._turn = Event(), Lock()  # whoever waits for the board may be left behind

    def open(self) -> str:
        """Connect and return the firmware's name and version.

        Raises
        ------
        DeviceError
            No such port, no answer, or the board cannot play what the rig wants.
        FirmwareError
            The firmware does not fit.
        """
        with self._turn:
            self._link, hello = self._connected()
        return hello.describe()

    def play(self, buzzer: int, waveform: Waveform) -> EmissionStart:
        """Start one emission and return when the board has replied.

        Raises
        ------
        DeviceRestartedError
            The board restarted: close it, open it, and play again.
        DeviceError
            The board is not open or lost, has no such buzzer, still plays, or stopped itself.
        """
        link = self._needed_link()
        if not 1 <= buzzer <= self._n_buzzers:
            raise DeviceError(f"trigger board: there is no buzzer {buzzer}; this board has 1 to {self._n_buzzers}")
        with self._turn, self._letting_go():
            self._ping(link)
            return self._start(link, buzzer, waveform)

    def read_clock(self) -> list[Ping]:
        """Read the board's clock once more, and return all readings since the last call. Raises as `play` does."""
        link = self._needed_link()
        with self._turn, self._letting_go():
            self._ping(link)
        pings, self._pings = self._pings, []
        return pings

    def clock_fit(self) -> ClockFit:
        """Return the line from the board's clock to the host's; it holds since the board was opened last."""
        return self.clock.fit()

    def close(self) -> None:
        """Silence the board and let it go; safe to call twice, and while another thread waits for the board."""
        timeout_s = _LEFT_BEHIND_S if self._turn.locked() else None
        self._is_given_up.set()
        with self._turn:
            self._is_given_up.clear()
            link, self._link = self._link, None
            if link is None:
                return
            try:
                link.ask("stop", timeout_s=timeout_s)
            except DeviceError:
                pass  # a board that is gone is silent within its own limit
            finally:
                link.close()

    def _needed_link(self) -> BoardLink:
        if self._link is None:
            raise DeviceError("trigger board: the port is not open; open it first")
        return self._link

    @contextmanager
    def _letting_go(self) -> Iterator[None]:
        """Close the port where the board is gone or has restarted: its clock is another one from then on."""
        try:
            yield
        except (DeviceRestartedError, PortLostError):
            if self._link is not None:
                self._link.close()
            self._link = None
            raise

    def _connected(self) -> tuple[BoardLink, Hello]:
        link, hello = connect(choose_port(self._wanted, serial_ports()).path, self._is_given_up)
        try:
            check_fits(hello, self._waveform, self._buzzers)
            self._settle(link)
        except BaseException:
            link.close()
            raise
        self._n_buzzers = hello.n_buzzers
        return link, hello

    def _settle(self, link: BoardLink) -> None:
        """Silence the board, for a host that died may have left a sound, and get to know its clock."""
        link.ask_safely("stop")
        status = link.ask_safely("status").reply
        if status.fields.get("state") == "fault":
            raise self._fault(link)
        self._n_plays = number(status.fields, "plays", link.path)
        self.clock = BoardClock()
        for _ in range(_FIRST_PINGS):
            self._ping(link)

    def _ping(self, link: BoardLink) -> None:
        answer = link.ask_safely("ping")
        board_us = number(answer.reply.fields, "us", link.path)
        self._pings.append(self.clock.add(answer.sent_s, answer.received_s, board_us))

    def _start(self, link: BoardLink, buzzer: int, waveform: Waveform) -> EmissionStart:
        asked_s = time.monotonic()
        for _ in range(_TRIES):
            on_us = self._played(link, buzzer, waveform)
            if on_us is not None:
                self._n_plays = (self._n_plays + 1) % _PLAYS_COUNTED
                board_s = self.clock.board_s(on_us, time.monotonic())
                start = EmissionStart(board_s, max(asked_s, self.clock.host_s(board_s)), self.clock.fit().std_s)
                self._over_s = start.host_time_s + waveform.duration_s
                return start
        raise DeviceError(f"{link.path}: the board did not take `play`, {_TRIES} times: check its cable")

    def _played(self, link: BoardLink, buzzer: int, waveform: Waveform) -> int | None:
        """Return the board's time (us) of the first edge; None where nothing sounds and it may be tried again."""
        link.last_on = None
        try:
            reply = link.ask("play", *play_arguments(buzzer, waveform)).reply
        except NoAnswerError:
            return self._start_by_status(link, waveform)
        if reply.error in (ERROR_CHECKSUM, ERROR_LINE):
            return self._start_by_status(link, waveform)  # it may mean noise before the command
        if reply.error == ERROR_BUSY and time.monotonic() > self._over_s:
            self._wait_for_silence(link)
            return None
        if reply.error:
            raise self._refused(link, buzzer, reply)
        return number(reply.fields, "on_us", link.path)

    def _start_by_status(self, link: BoardLink, waveform: Waveform) -> int | None:
        """Find out whether a `play` without a reply sounds; where nobody knows since when, wait until it is over."""
        seq = str(link.seq)
        status = link.ask_safely("status").reply
        if link.last_on is not None and link.last_on.fields.get("seq") == seq:
            return number(link.last_on.fields, "us", link.path)
        n_plays = number(status.fields, "plays", link.path)
        if n_plays != self._n_plays:
            self._n_plays = n_plays
            time.sleep(waveform.duration_s + _QUIET_S)
        return None

    def _wait_for_silence(self, link: BoardLink) -> None:
        """Wait for the end of a sound that should have ended: the board's clock is behind, or somebody else played."""
        end_s = time.monotonic() + _OVERDUE_S
        while time.monotonic() < end_s and link.ask_safely("status").reply.fields.get("state") == "playing":
            time.sleep(_LOOK_S)

    def _refused(self, link: BoardLink, buzzer: int, reply: Reply) -> DeviceError:
        if reply.error == ERROR_BUSY:
            return DeviceError(f"trigger board: busy, cannot play buzzer {buzzer} yet; wait until the last sound ends")
        if reply.error == ERROR_FAULT:
            return self._fault(link)
        return DeviceError(
            f"{link.path}: the board refuses to play buzzer {buzzer}: error {reply.error} {reply.error_name}"
        )

    def _fault(self, link: BoardLink) -> DeviceError:
        why = link.last_fault.fields.get("name", "unknown") if link.last_fault else "unknown"
        return DeviceError(
            f"{link.path}: the board has stopped itself (fault {why}): check its wiring and unplug it once"
        )
