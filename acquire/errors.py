"""The errors of capture; every message says what is wrong, where, and what to do."""

from collections.abc import Iterator
from contextlib import contextmanager

PARTS = {"trigger": "the trigger board", "audio": "the sound device", "camera": "the camera"}


class CaptureError(Exception):
    """Base of all errors of the `acquire` package; `exit_code` is what the command line returns for it."""

    exit_code = 3


class DeviceError(CaptureError):
    """A device is missing, was lost, or does not answer."""


class DeviceRestartedError(DeviceError):
    """A device answers, but has forgotten what it was told: open it again and repeat."""


class DeviceLostError(DeviceError):
    """A device was lost while a session is captured.

    Parameters
    ----------
    message : str
    part : str
        "trigger", "audio" or "camera".
    """

    def __init__(self, message: str, part: str = "") -> None:
        super().__init__(message)
        self.part = part


@contextmanager
def losing(part: str) -> Iterator[None]:
    """Take any error of a device for its loss, unless it has only restarted, or another one is lost.

    `part` is as in `DeviceLostError`.
    """
    try:
        yield
    except (DeviceRestartedError, DeviceLostError):
        raise
    except DeviceError as error:
        raise DeviceLostError(str(error), part) from error


class DiskShortError(CaptureError):
    """No room is left on the disk, or the folder is gone; the session is closed well while that still can be done."""


class FirmwareError(CaptureError):
    """The trigger board's firmware does not fit this host."""

    exit_code = 4


class UnknownFirmwareError(FirmwareError):
    """What answers cannot be understood: another program, or a board that was held up and speaks in pieces."""


class CaptureQualityError(CaptureError):
    """What was recorded is not good enough for a calibration."""

    exit_code = 5


class InterruptedCaptureError(CaptureError):
    """Somebody ended the capture (Ctrl-C, SIGTERM); the session is saved."""

    exit_code = 130
