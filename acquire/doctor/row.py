"""A row of the check-up: what was looked at, how it is, and what to do about it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from acquire.errors import CaptureError, CaptureQualityError

_SUBJECTS = ("trigger board", "audio", "camera")  # that messages begin with, as the row does already
_ANY_DEVICE = "check its cable, and its section in the rig description"


class State(StrEnum):
    """How something is; a word of its own each, for those who see no colours."""

    OK = "ok"
    LOOK = "look"
    BAD = "bad"


class Part(StrEnum):
    """What a row is about."""

    DEVICES = "devices"
    PICTURE = "picture"
    SOUND = "sound"
    COMPUTER = "computer"


@dataclass(frozen=True)
class Row:
    """One finding.

    Parameters
    ----------
    part : Part
    subject : str
        What was looked at, in a word or two.
    state : State
    finding : str
    remedy : str
        What to do; never empty unless the state is ok.
    figures : mapping of str to float
        What was measured, by names with units.
    exit_code : int
        What the command line returns where the state is bad.
    """

    part: Part
    subject: str
    state: State
    finding: str
    remedy: str = ""
    figures: Mapping[str, float] = field(default_factory=dict)
    exit_code: int = CaptureQualityError.exit_code


def refusal(subject: str, error: CaptureError, part: Part = Part.DEVICES) -> Row:
    """Return the row of a device that refuses; its message is `place: what: what to do`."""
    finding, remedy = _split(str(error))
    return Row(part, subject, State.BAD, finding, remedy or _ANY_DEVICE, exit_code=error.exit_code)


def exit_code(rows: Iterable[Row]) -> int:
    """Return 0 where nothing is bad, else the code of what has to be mended first: device, firmware, measurement."""
    return min((row.exit_code for row in rows if row.state is State.BAD), default=0)


def _split(message: str) -> tuple[str, str]:
    first, colon, rest = message.partition(": ")
    if not colon:
        return message, ""
    if " " in first and first not in _SUBJECTS:
        return first, rest
    what, separator, remedy = rest.partition(": ")
    if not separator:
        what, _, remedy = rest.partition("; ")
    return what if first in _SUBJECTS else f"{first}: {what}", remedy
