"""The devices: each one found, opened and answering, whatever ails the others."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack

from acquire.devices.base import AudioInput, Camera, Rig, TriggerBoard
from acquire.doctor.row import Part, Row, State, refusal
from acquire.errors import DeviceError, FirmwareError

_FIRST_SOUND_S, _STEP_S = 2.0, 0.05


class Devices:
    """Those of a rig's devices that answer; the others are None.

    Parameters
    ----------
    rig : Rig
        Its devices not yet opened.
    stack : ExitStack
        Closes them.
    """

    def __init__(self, rig: Rig, stack: ExitStack) -> None:
        self.clock, self.operator = rig.clock, rig.operator
        self.trigger: TriggerBoard | None = None
        self.audio: AudioInput | None = None
        self.camera: Camera | None = None
        self._rig, self._stack = rig, stack

    def open_each(self) -> Iterator[Row]:
        """Open each device, wait for its first answer, and say how it is."""
        yield from self._open_trigger(self._rig.trigger)
        self.operator.ask_for_pose(0)
        yield from self._open_camera(self._rig.camera)
        yield from self._open_audio(self._rig.audio)

    def _open_trigger(self, trigger: TriggerBoard) -> Iterator[Row]:
        self._stack.callback(trigger.close)
        try:
            firmware = trigger.open()
            trigger.read_clock()
        except FirmwareError as error:
            yield Row(Part.DEVICES, "trigger board", State.OK, "found, and something answers")
            yield refusal("firmware", error)
        except DeviceError as error:
            yield refusal("trigger board", error)
        else:
            self.trigger = trigger
            yield Row(Part.DEVICES, "trigger board", State.OK, "found, and answers")
            yield Row(Part.DEVICES, "firmware", State.OK, firmware)

    def _open_camera(self, camera: Camera) -> Iterator[Row]:
        row = self._opened("camera", camera, camera.read)
        yield row
        if row.state is State.OK:
            self.camera = camera
            for warning in camera.warnings:
                finding, _, remedy = warning.rpartition(": ")
                yield Row(Part.DEVICES, "camera", State.LOOK, finding, remedy)

    def _open_audio(self, audio: AudioInput) -> Iterator[Row]:
        row = self._opened("sound device", audio, lambda: self._wait_for_sound(audio))
        self.audio = audio if row.state is State.OK else None
        yield row

    def _opened(self, subject: str, device: Camera | AudioInput, answer: Callable[[], object]) -> Row:
        self._stack.callback(device.close)
        try:
            driver = device.open()
            answer()
        except DeviceError as error:
            return refusal(subject, error)
        return Row(Part.DEVICES, subject, State.OK, driver)

    def _wait_for_sound(self, audio: AudioInput) -> None:
        end_s = self.clock.now_s() + _FIRST_SOUND_S
        while not audio.read():
            if self.clock.now_s() > end_s:
                raise DeviceError(
                    f"audio: opened, but delivers nothing for {_FIRST_SOUND_S:g} s: check that it is plugged in and "
                    "not used by another program"
                )
            self.clock.sleep_s(_STEP_S)
