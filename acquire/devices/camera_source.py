"""The source of a camera's pictures: what the rig description names, and how messages may call it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path


class SourceKind(StrEnum):
    """Where pictures come from."""

    DEVICE = "device"
    ADDRESS = "address"
    FILE = "file"
    FOLDER = "folder"


@dataclass(frozen=True)
class CameraSource:
    """A camera, or recorded pictures that stand in for one.

    Parameters
    ----------
    kind : SourceKind
    place : int or str
        Number, path or address.
    label : str
        What messages call it: an address without user name, password and query.
    """

    kind: SourceKind
    place: int | str
    label: str

    @property
    def is_live(self) -> bool:
        """Tell whether a sensor is behind it, with noise in every picture; recorded pictures may repeat themselves."""
        return self.kind in (SourceKind.DEVICE, SourceKind.ADDRESS)


def camera_source(source: int | str) -> CameraSource:
    """Return the source that `camera.source` of a rig description names.

    A whole number is a device's; so is a path under /dev. What has `://` is an address, all else a file or a folder.
    """
    text = str(source).strip()
    if text.isdecimal():
        return CameraSource(SourceKind.DEVICE, int(text), f"camera {text}")
    if "://" in text:
        return CameraSource(SourceKind.ADDRESS, text, _without_secrets(text))
    if text.startswith("/dev/"):
        return CameraSource(SourceKind.DEVICE, text, text)
    path = Path(text).expanduser()
    return CameraSource(SourceKind.FOLDER if path.is_dir() else SourceKind.FILE, str(path), text)


def _without_secrets(address: str) -> str:
    """Leave out what may hold a password: all before the last @, the query and the fragment."""
    return re.sub(r"[?#].*", "", re.sub(r"://.*@", "://", address))
