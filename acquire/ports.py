"""The serial ports of this computer: which there are, which one is meant, and what is wrong when one does not open.

The only module that imports pyserial.
"""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from acquire.errors import DeviceError
from rigs.errors import reason

if TYPE_CHECKING:
    from serial import Serial

BAUD = 115200
_READ_TIMEOUT_S = 0.02
_WRITE_TIMEOUT_S = 1.0
# What the USB ids say: a name, and the board where only one kind carries them.
_KNOWN = {
    "2341:0001": ("Arduino Uno", "uno"),
    "2341:0043": ("Arduino Uno", "uno"),
    "2341:0243": ("Arduino Uno", "uno"),
    "2A03:0043": ("Arduino Uno", "uno"),
    "2341:0010": ("Arduino Mega 2560", "mega"),
    "2341:0042": ("Arduino Mega 2560", "mega"),
    "2341:0242": ("Arduino Mega 2560", "mega"),
    "2A03:0010": ("Arduino Mega 2560", "mega"),
    "2A03:0042": ("Arduino Mega 2560", "mega"),
    "1A86:7523": ("CH340 serial chip, as on many Nano and Uno copies", ""),
    "1A86:55D4": ("CH9102 serial chip, as on newer Nano and Uno copies", ""),
    "0403:6001": ("FTDI serial chip, as on the Nano", ""),
    "0403:6015": ("FTDI serial chip", ""),
    "10C4:EA60": ("CP2102 serial chip", ""),
    "067B:2303": ("PL2303 serial chip", ""),
}


@dataclass(frozen=True)
class FoundPort:
    """A serial port, and what its USB ids tell.

    Parameters
    ----------
    path : str
    usb_id : str
        VID:PID in capital hexadecimal digits; empty where the port is not USB.
    serial_number : str
        Empty where the device has none.
    """

    path: str
    usb_id: str = ""
    serial_number: str = ""

    @property
    def name(self) -> str:
        """What the device is."""
        return _KNOWN.get(self.usb_id, ("unknown USB device" if self.usb_id else "no USB ids", ""))[0]

    @property
    def board(self) -> str:
        """The board where the ids tell it ("uno" or "mega"), else empty."""
        return _KNOWN.get(self.usb_id, ("", ""))[1]

    @property
    def is_known(self) -> bool:
        """Whether boards such as ours carry these ids."""
        return self.usb_id in _KNOWN

    def describe(self) -> str:
        """Return path, ids and name in one line."""
        ids = ":".join(filter(None, (self.usb_id, self.serial_number)))
        return f"{self.path} ({', '.join(filter(None, (ids, self.name)))})"


def serial_ports() -> list[FoundPort]:
    """Return the serial ports that the system lists, by path."""
    from serial.tools.list_ports import comports  # noqa: PLC0415 - only where a serial board is wanted

    found = []
    for port in comports():
        usb_id = f"{port.vid:04X}:{port.pid:04X}" if port.vid is not None and port.pid is not None else ""
        found.append(FoundPort(port.device, usb_id, port.serial_number or ""))
    return sorted(found, key=lambda port: port.path)


def choose_port(wanted: str, ports: Sequence[FoundPort]) -> FoundPort:
    """Return the port that is meant.

    Parameters
    ----------
    wanted : str
        "auto", a path, or USB ids as VID:PID or VID:PID:SERIAL.
    ports : sequence of FoundPort
        What there is.

    Raises
    ------
    DeviceError
        None fits, or more than one.
    """
    if wanted == "auto":
        fitting = [port for port in ports if port.is_known] or [port for port in ports if port.usb_id]
        return _only(fitting, "no board found on any USB port", ports)
    if re.fullmatch(r"[0-9A-Fa-f]{4}:[0-9A-Fa-f]{4}(:\S+)?", wanted):
        vendor, product, *number = wanted.split(":", 2)
        usb_id = f"{vendor}:{product}".upper()
        fitting = [port for port in ports if port.usb_id == usb_id and (not number or port.serial_number == number[0])]
        return _only(fitting, f"no device with the USB ids {wanted}", ports)
    same = [port for port in ports if os.path.realpath(port.path) == os.path.realpath(wanted)]
    return FoundPort(wanted, same[0].usb_id, same[0].serial_number) if same else FoundPort(wanted)


def flash_command(path: str) -> str:
    """Return the command line that flashes the board at a port; with --board where USB ids do not tell which it is."""
    is_told = choose_port(path, serial_ports()).board
    return f"rig-flash --port {path}" + ("" if is_told else " --board uno (or nano, nano-old, mega)")


def open_port(path: str) -> Serial:
    """Open a port for this program alone, at the protocol's speed; an Uno restarts from it.

    Raises
    ------
    DeviceError
        There is no such port, it is used by another program, or the user may not use it.
    """
    import serial  # noqa: PLC0415 - only where a serial board is wanted

    try:
        return serial.Serial(path, BAUD, timeout=_READ_TIMEOUT_S, write_timeout=_WRITE_TIMEOUT_S, exclusive=True)
    except (OSError, ValueError) as error:
        raise DeviceError(_why_not(path, error)) from error


def has_modem_lines(port: Serial) -> bool:
    """Tell whether the port has DTR, so that opening it has restarted the board; a pseudo-terminal has none."""
    try:
        return port.cts in (True, False)
    except OSError:
        return False


def _only(fitting: Sequence[FoundPort], none_fits: str, ports: Sequence[FoundPort]) -> FoundPort:
    if len(fitting) == 1:
        return fitting[0]
    if not fitting:
        raise DeviceError(
            f"{none_fits}: plug the board in with a cable that carries data, not only power; {_seen(ports)}"
        )
    named = "; ".join(port.describe() for port in fitting)
    raise DeviceError(f"{len(fitting)} boards could be meant: unplug the others, or name the port: {named}")


def _seen(ports: Sequence[FoundPort]) -> str:
    return "ports here: " + ("; ".join(port.describe() for port in ports) or "none")


def _why_not(path: str, error: Exception) -> str:
    number = getattr(error, "errno", None)
    if number == errno.ENOENT or (number is None and "FileNotFoundError" in str(error)):
        return f"{path}: there is no such port: plug the board in, or name another; {_seen(serial_ports())}"
    if number == errno.EACCES:
        return (
            f"{path}: no permission to use this port: run `sudo usermod -a -G dialout $USER`, then log out and in again"
        )
    if number in (errno.EBUSY, errno.EAGAIN) or "PermissionError" in str(error):
        return (
            f"{path}: another program uses this port: close serial monitors and other captures; on a board just "
            "plugged in it may be ModemManager: wait half a minute, or run `sudo systemctl stop ModemManager`"
        )
    return f"{path}: cannot be opened as a serial port ({reason(error)}): name the port of the board"
