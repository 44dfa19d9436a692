"""The simulated trigger board."""

from __future__ import annotations

from acquire.devices.base import EmissionStart
from acquire.devices.simulated.draws import draws
from acquire.devices.simulated.edges import TICK_S
from acquire.devices.simulated.oscillator import Oscillator
from acquire.devices.simulated.stage import Emission, Stage
from acquire.errors import DeviceError
from rigs.waveform import Waveform

_DRIFT = 50e-6
_COMMAND_S = 0.002  # from the host's command to the first edge
_BOOT_S = 1.6
_REPLY_S = (0.001, 0.003)


class SimulatedTrigger:
    """Plays the buzzers of a stage, one at a time, by its own clock."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self._rng = draws(stage.scene.seed, "trigger")
        self._buzzers = [buzzer.id for buzzer in stage.scene.description.board.buzzers]
        self._oscillator: Oscillator | None = None
        self._busy_until_s = 0.0

    def open(self) -> str:
        """Connect and return the firmware's name and version."""
        rate = 1 + _DRIFT * self._rng.uniform(-1, 1)
        self._oscillator = Oscillator(self._stage.clock.now_s() - self._rng.uniform(0, 0.01), rate)
        self._stage.clock.sleep_s(_BOOT_S)
        return "simulated-board 1.0"

    def play(self, buzzer: int, waveform: Waveform) -> EmissionStart:
        """Start one emission and return when the board has replied, a few milliseconds later.

        Raises
        ------
        DeviceError
            The board is not open or lost, has no such buzzer, or still plays.
        """
        clock, oscillator = self._stage.clock, self._ready(buzzer)
        board_time_s = round(oscillator.reading_s(clock.now_s() + _COMMAND_S) / TICK_S) * TICK_S
        start_s = oscillator.host_s(board_time_s)
        self._busy_until_s = start_s + waveform.duration_s / oscillator.rate
        silent = {fault.buzzer or self._buzzers[0] for fault in self._stage.faults("silent_buzzer")}
        if buzzer not in silent:
            here, index = self._stage.board_to_camera(start_s), self._buzzers.index(buzzer)
            self._stage.emit(Emission(index, waveform, start_s, oscillator.rate, self._stage.pose, here))
        clock.sleep_s(start_s + self._rng.uniform(*_REPLY_S) - clock.now_s())
        return EmissionStart(board_time_s, clock.now_s())

    def close(self) -> None:
        """Let the board go; safe to call twice."""
        self._oscillator = None

    def _ready(self, buzzer: int) -> Oscillator:
        if self._stage.faults("trigger_lost"):
            raise DeviceError("trigger board: no answer from the simulated board; check its cable and start again")
        if self._oscillator is None:
            raise DeviceError("trigger board: the simulated board is not open; open it first")
        if buzzer not in self._buzzers:
            raise DeviceError(f"trigger board: there is no buzzer {buzzer}; this board has {self._buzzers}")
        if self._stage.clock.now_s() < self._busy_until_s:
            raise DeviceError(f"trigger board: busy, cannot play buzzer {buzzer} yet; wait until the last sound ends")
        return self._oscillator
