"""What `rig-capture --list-devices` shows: sound devices, cameras, serial ports, as the rig description names them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

from rich.console import Console
from rich.table import Table

from acquire.errors import DeviceError
from acquire.ports import FoundPort, serial_ports
from acquire.sound_devices import SoundDevice, sound_devices

_CAMERAS = Path("/sys/class/video4linux")


def show_devices(console: Console) -> None:
    """Print the devices of this computer.

    Raises
    ------
    DeviceError
        PortAudio is missing or does not answer; the other devices were printed.
    """
    _show(console, "Cameras", ("name", "rig description, camera"), _camera_rows(_CAMERAS))
    _show(console, "Serial ports", ("name", "rig description, trigger"), _port_rows(serial_ports()))
    try:
        devices = sound_devices()
    except DeviceError:
        console.print("Sound devices: not known", highlight=False)
        raise
    columns = ("host API", "inputs", "default rate", "rig description, audio")
    _show(console, "Sound devices", columns, _sound_rows(devices))


def _show(console: Console, title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    if not rows:
        console.print(f"{title}: none\n", highlight=False)
        return
    table = Table(*columns[:-1], title=title, title_justify="left", title_style="bold")
    table.add_column(columns[-1], overflow="fold")  # words that are cut off cannot be copied
    for row in rows:
        table.add_row(*row)
    console.print(table)


def _sound_rows(devices: Sequence[SoundDevice]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    by_api = groupby(sorted(devices, key=lambda device: device.host_api), lambda device: device.host_api)
    for host_api, group in by_api:
        for number, device in enumerate(group):
            words = f"device: {device.words()}"
            rows.append(("" if number else host_api, str(device.inputs), f"{device.default_rate_hz:g} Hz", words))
    return rows


def _camera_rows(folder: Path) -> list[tuple[str, str]]:
    """Return Linux's cameras (name, words); elsewhere none, as OpenCV only counts them."""
    nodes = sorted(folder.iterdir(), key=lambda node: (len(node.name), node.name)) if folder.is_dir() else []
    return [((node / "name").read_text().strip(), f"source: /dev/{node.name}") for node in nodes]


def _port_rows(ports: Sequence[FoundPort]) -> list[tuple[str, str]]:
    return [(port.name, f'port: "{port.usb_id or port.path}"') for port in ports]
