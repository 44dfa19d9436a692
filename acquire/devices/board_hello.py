"""The board's hello: which firmware answers at a port, and what it can play."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from threading import Event

from acquire.devices.board_link import BoardLink, BoardRestartedError, NoAnswerError
from acquire.devices.wire import PROTOCOL_VERSION
from acquire.errors import DeviceError, FirmwareError, UnknownFirmwareError
from acquire.ports import flash_command, has_modem_lines, open_port
from rigs.waveform import Waveform

FIRMWARE = "buzzer-board"
_BOOT_S = 2.5  # the slowest bootloader in use takes 2 s
_NO_RESET_S = 0.2  # for a port that cannot restart its board
_TRIES, _TRY_S = 5, 0.6
_CHIP_HZ = (1000, 20000)  # PROTOCOL.md; hello does not tell
_MIN_US = 5000


@dataclass(frozen=True)
class Hello:
    """What the board said to `hello`: firmware, board, number of buzzers, limits of what it plays."""

    version: str
    board: str
    n_buzzers: int
    max_us: int
    min_hz: int
    max_hz: int

    def describe(self) -> str:
        """Return firmware and board in a few words."""
        return f"{FIRMWARE} {self.version} on {self.board}"


def connect(path: str, is_given_up: Event | None = None) -> tuple[BoardLink, Hello]:
    """Open a port, wait for its board to start, and ask what it is.

    Parameters
    ----------
    path : str
    is_given_up : threading.Event, optional
        As `BoardLink` has it.

    Raises
    ------
    FirmwareError, DeviceError
        As `greet` and `open_port` do; the port is closed again.
    """
    port = open_port(path)
    link = BoardLink(port, is_given_up)
    try:
        return link, greet(link, boot_s=_BOOT_S if has_modem_lines(port) else _NO_RESET_S)
    except BaseException:
        link.close()
        raise


def greet(link: BoardLink, *, boot_s: float) -> Hello:
    """Wait for a board that may just be starting, and ask what it is.

    Parameters
    ----------
    link : BoardLink
    boot_s : float
        How long to wait for its `! boot` before asking anyway.

    Raises
    ------
    FirmwareError
        Another firmware answers, or one of another protocol; UnknownFirmwareError where nothing of it is understood.
    DeviceError
        Nothing answers, or only to what was asked long before, or the port is gone.
    """
    link.wait_for_boot(boot_s)
    for _ in range(_TRIES):
        try:
            reply = link.ask("hello", timeout_s=_TRY_S).reply
        except (NoAnswerError, BoardRestartedError):  # a late `! boot` means: ask again
            continue
        if not reply.error:
            return _checked(reply.fields, link.path)
    remedy = f"put ours on it: {flash_command(link.path)}"
    if link.n_messages:
        raise DeviceError(f"{link.path}: the board answers too late: unplug it once, and close other programs")
    if link.n_bytes:
        raise UnknownFirmwareError(f"{link.path}: what answers there is not the firmware {FIRMWARE}: {remedy}")
    raise DeviceError(
        f"{link.path}: no answer; is this the buzzer board? If it is new or ran another program, {remedy}"
    )


def number(fields: Mapping[str, str], key: str, path: str) -> int:
    """Return a whole number of a reply. Raises FirmwareError where the board did not send it."""
    value = fields.get(key, "")
    if not (value.isascii() and value.isdecimal()):
        raise FirmwareError(f"{path}: the board's reply has no number {key}: renew its firmware: {flash_command(path)}")
    return int(value)


def check_fits(hello: Hello, waveform: Waveform, buzzers: Sequence[int]) -> None:
    """Refuse what the board cannot play, before anything sounds.

    Parameters
    ----------
    hello : Hello
    waveform : Waveform
    buzzers : sequence of int
        The board's numbers of them, counted from 1.

    Raises
    ------
    DeviceError
    """
    missing = [buzzer for buzzer in buzzers if buzzer > hello.n_buzzers]
    if missing:
        raise DeviceError(
            f"trigger board: there is no buzzer {missing[0]}; this board has 1 to {hello.n_buzzers}: "
            "correct board.buzzers in the description"
        )
    duration_us = round(1e6 * waveform.duration_s)
    if not _MIN_US <= duration_us <= hello.max_us:
        raise _unplayable(f"{duration_us} us long", f"{_MIN_US} to {hello.max_us} us")
    low_hz, high_hz = _CHIP_HZ if waveform.kind == "mls" else (hello.min_hz, hello.max_hz)
    rates_hz = [waveform.chip_rate_hz] if waveform.kind == "mls" else [waveform.start_hz, waveform.stop_hz]
    for rate_hz in rates_hz:
        if not low_hz <= rate_hz <= high_hz or rate_hz != round(rate_hz):
            raise _unplayable(f"at {rate_hz:g} Hz", f"whole numbers of {low_hz} to {high_hz} Hz")


def _unplayable(wanted: str, possible: str) -> DeviceError:
    return DeviceError(
        f"trigger board: cannot play a signal {wanted}, only {possible}: change `signal` in the description"
    )


def _checked(fields: Mapping[str, str], path: str) -> Hello:
    name, version, protocol = (fields.get(key, "?") for key in ("name", "fw", "proto"))
    if name != FIRMWARE:
        raise FirmwareError(f"{path}: the firmware there is {name}, not {FIRMWARE}: put ours on: {flash_command(path)}")
    if protocol != str(PROTOCOL_VERSION):
        raise FirmwareError(
            f"{path}: {FIRMWARE} {version} speaks protocol {protocol}, this program protocol {PROTOCOL_VERSION}: "
            f"put the fitting firmware on: {flash_command(path)}"
        )
    limits = [number(fields, key, path) for key in ("buzzers", "max_us", "min_hz", "max_hz")]
    return Hello(version, fields.get("board", "unknown"), *limits)
