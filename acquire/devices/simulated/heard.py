"""A real trigger board whose buzzers sound in the simulated room."""

from __future__ import annotations

from acquire.devices.base import ClockFit, EmissionStart, Ping, TriggerBoard
from acquire.devices.simulated.stage import Emission, Stage
from acquire.errors import DeviceError
from rigs.waveform import Waveform

_RATE = 1.0  # the board's drift over one emission is too small to be heard


class HeardTrigger:
    """Plays on a real board, and lets the stage hear it from the first edge that the board reported.

    The stage must run on the host's own clock, in which the board's reports are.

    Parameters
    ----------
    board : TriggerBoard
    stage : Stage
    """

    def __init__(self, board: TriggerBoard, stage: Stage) -> None:
        self._board, self._stage = board, stage
        self._buzzers = [buzzer.id for buzzer in stage.scene.description.board.buzzers]

    def open(self) -> str:
        """Connect and return the firmware's name and version. Raises DeviceError or FirmwareError."""
        return self._board.open()

    def play(self, buzzer: int, waveform: Waveform) -> EmissionStart:
        """Start one emission and return at once. Raises DeviceError."""
        if self._stage.faults("trigger_lost"):
            raise DeviceError("trigger board: no answer, by the simulated fault trigger_lost; check its cable")
        start = self._board.play(buzzer, waveform)
        stage, silent = self._stage, {fault.buzzer or self._buzzers[0] for fault in self._stage.faults("silent_buzzer")}
        if buzzer in self._buzzers and buzzer not in silent:
            here, index = stage.board_to_camera(start.host_time_s), self._buzzers.index(buzzer)
            stage.emit(Emission(index, waveform, start.host_time_s, _RATE, stage.pose, here))
        return start

    def read_clock(self) -> list[Ping]:
        """Read the board's clock once more, and return all readings since the last call. Raises as `play` does."""
        return self._board.read_clock()

    def clock_fit(self) -> ClockFit:
        """Return the line from the board's clock to the host's."""
        return self._board.clock_fit()

    def close(self) -> None:
        """Silence the board and let it go; safe to call twice."""
        self._board.close()
