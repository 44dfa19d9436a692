"""The reconnection: a device that was lost is waited for and opened again, or the capture ends."""

from __future__ import annotations

from acquire.errors import PARTS, CaptureError, DeviceError, DeviceLostError, FirmwareError, UnknownFirmwareError
from acquire.recording import Recording
from acquire.status import State
from rigs.description import RigDescription

_RETRY_S = 0.5
_MAX_LOSSES = 5  # without a good pose in between: a loose contact, which waiting does not mend


class Reconnection:
    """Brings lost devices back.

    Parameters
    ----------
    recording : Recording
    description : RigDescription
    """

    def __init__(self, recording: Recording, description: RigDescription) -> None:
        self._recording, self._wait_s = recording, description.capture.device_wait_s
        self._losses = 0

    def forgive(self) -> None:
        """Count losses anew: a pose was good."""
        self._losses = 0

    def restore(self, loss: DeviceLostError) -> None:
        """Wait until a device is there again, and open it; audio is recorded meanwhile, if it is not the one.

        Raises
        ------
        DeviceError
            It did not come back, or was lost again and again.
        FirmwareError
            What came back is another trigger board.
        InterruptedCaptureError, DiskShortError
        """
        name, status = PARTS[loss.part], self._recording.status
        state, advice, status.advice = status.state, status.advice, f"{name}: check its cable"
        status.state = State.RECONNECTING
        self._losses += 1
        if self._losses > _MAX_LOSSES:
            raise DeviceError(f"{loss}; devices were lost {self._losses} times without a good pose in between")
        self._recording.say("warning", f"{loss}; waiting for {name}, {self._wait_s:g} s at most")
        driver = self._opened(loss)
        self._recording.reopened(loss.part)
        self._recording.say("info", f"{name} is there again ({driver})")
        status.state, status.advice = state, advice

    def _opened(self, loss: DeviceLostError) -> str:
        device, clock = getattr(self._recording.rig, loss.part), self._recording.rig.clock
        end_s = clock.now_s() + self._wait_s

        def opened() -> str:
            device.close()
            return str(device.open())

        while True:
            try:
                return self._recording.attend(loss.part, opened, is_open=False)
            except DeviceLostError as another:
                self.restore(another)
            except (DeviceError, UnknownFirmwareError) as refusal:
                if clock.now_s() >= end_s:
                    raise _given_up(refusal, loss, self._wait_s) from loss
            self._wait(loss)

    def _wait(self, loss: DeviceLostError) -> None:
        if loss.part == "audio":
            self._recording.idle(_RETRY_S)
            return
        try:
            self._recording.record(_RETRY_S)
        except DeviceLostError as another:
            self.restore(another)


def _given_up(refusal: DeviceError | UnknownFirmwareError, loss: DeviceLostError, wait_s: float) -> CaptureError:
    kind = FirmwareError if isinstance(refusal, UnknownFirmwareError) else DeviceError
    return kind(
        f"{PARTS[loss.part]} did not come back within {wait_s:g} s, go on with --resume when it is there: {refusal}"
    )
