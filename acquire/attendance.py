"""The attendance: what the capture does while a device's call waits for its answer, so that no sound waits with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Self

from acquire.devices.base import Clock
from acquire.errors import PARTS, DeviceLostError
from acquire.status import Status

_SLOW_S = 1.0  # whoever waits longer than this is told what for


class Attendance:
    """Goes on with the capture's other duties, and tells the operator what is waited for.

    Parameters
    ----------
    status : Status
    clock : Clock
    part : str
        The device whose call waits: "trigger", "audio" or "camera".
    duties : sequence of callable
        Each may raise DeviceLostError, which waits until the call is over; the other duties go on.
    """

    def __init__(self, status: Status, clock: Clock, part: str, duties: Sequence[Callable[[], None]]) -> None:
        self._status, self._clock, self._part, self._duties = status, clock, part, duties
        self._began_s, self._advice = clock.now_s(), status.advice
        self._loss: DeviceLostError | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._status.advice = self._advice

    def glance(self) -> None:
        """Carry out each duty once. Raises what ends the capture."""
        if self._clock.now_s() - self._began_s > _SLOW_S and not self._advice.startswith(PARTS[self._part]):
            self._status.advice = f"waiting for {PARTS[self._part]}"
        for duty in self._duties:
            try:
                duty()
            except DeviceLostError as loss:
                self._loss = self._loss or loss

    def check(self) -> None:
        """Raise DeviceLostError where a device was lost meanwhile."""
        if self._loss is not None:
            raise self._loss
