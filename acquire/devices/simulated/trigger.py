"""The simulated trigger board."""

from __future__ import annotations

from acquire.devices.base import ClockFit, EmissionStart, Ping
from acquire.devices.board_clock import WRAP_US, BoardClock
from acquire.devices.simulated.draws import draws
from acquire.devices.simulated.edges import TICK_S
from acquire.devices.simulated.oscillator import Oscillator
from acquire.devices.simulated.stage import Emission, Stage
from acquire.errors import DeviceError, DeviceRestartedError
from rigs.waveform import Waveform

_DRIFT = 50e-6
_COMMAND_S = 0.002  # from the host's command to the first edge
_BOOT_S = 1.6
_REPLY_S = (0.001, 0.003)
_PING_S = (0.0005, 0.0015)  # one way
_FIRST_PINGS = 8


class SimulatedTrigger:
    """Plays the buzzers of a stage, one at a time, by its own clock."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self._rng = draws(stage.scene.seed, "trigger")
        self._buzzers = [buzzer.id for buzzer in stage.scene.description.board.buzzers]
        self._ping_rng = draws(stage.scene.seed, "pings")
        self._oscillator: Oscillator | None = None
        self._busy_until_s = 0.0
        self._clock = BoardClock()
        self._pings: list[Ping] = []

    def open(self) -> str:
        """Connect and return the firmware's name and version. Raises DeviceError while it is unplugged."""
        if self._stage.is_out("trigger_lost"):
            raise DeviceError("trigger board: there is no simulated board: plug it in")
        rate = 1 + _DRIFT * self._rng.uniform(-1, 1)
        self._oscillator = Oscillator(self._stage.clock.now_s() - self._rng.uniform(0, 0.01), rate)
        self._stage.clock.sleep_s(_BOOT_S)
        self._clock = BoardClock()
        for _ in range(_FIRST_PINGS):
            self._ping(self._oscillator)
        return "simulated-board 1.0"

    def play(self, buzzer: int, waveform: Waveform) -> EmissionStart:
        """Start one emission and return when the board has replied, a few milliseconds later.

        Raises
        ------
        DeviceRestartedError
            The board restarted (fault trigger_reset).
        DeviceError
            The board is not open or lost, has no such buzzer, or still plays.
        """
        clock, oscillator = self._stage.clock, self._ready()
        self._check_free(buzzer)
        self._ping(oscillator)
        board_time_s = round(oscillator.reading_s(clock.now_s() + _COMMAND_S) / TICK_S) * TICK_S
        start_s = oscillator.host_s(board_time_s)
        self._busy_until_s = start_s + waveform.duration_s / oscillator.rate
        silent = {fault.buzzer or self._buzzers[0] for fault in self._stage.faults("silent_buzzer")}
        if buzzer not in silent:
            here, index = self._stage.board_to_camera(start_s), self._buzzers.index(buzzer)
            self._stage.emit(Emission(index, waveform, start_s, oscillator.rate, self._stage.pose, here))
        clock.sleep_s(start_s + self._rng.uniform(*_REPLY_S) - clock.now_s())
        return EmissionStart(board_time_s, self._clock.host_s(board_time_s), self._clock.fit().std_s)

    def read_clock(self) -> list[Ping]:
        """Read the board's clock once more, and return all readings since the last call. Raises as `play` does."""
        self._ping(self._ready())
        pings, self._pings = self._pings, []
        return pings

    def clock_fit(self) -> ClockFit:
        """Return the line from the board's clock to the host's; it holds since the board was opened last."""
        return self._clock.fit()

    def close(self) -> None:
        """Let the board go; safe to call twice."""
        self._oscillator = None

    def _ping(self, oscillator: Oscillator) -> None:
        """Read the board's clock, in no time: the reading is made up as if it had been asked for a moment ago."""
        there_s, back_s = self._ping_rng.uniform(*_PING_S, 2)
        now_s = self._stage.clock.now_s()
        board_us = round(1e6 * oscillator.reading_s(now_s - back_s))
        self._pings.append(self._clock.add(now_s - there_s - back_s, now_s, board_us % WRAP_US))

    def _ready(self) -> Oscillator:
        if self._stage.is_out("trigger_lost"):
            self._oscillator = None
            raise DeviceError("trigger board: no answer from the simulated board: check its cable")
        if self._oscillator is None:
            raise DeviceError("trigger board: the simulated board is not open; open it first")
        if self._stage.happens("trigger_reset"):
            self._oscillator = None
            raise DeviceRestartedError("trigger board: the simulated board restarted: check its cable and its power")
        return self._oscillator

    def _check_free(self, buzzer: int) -> None:
        if buzzer not in self._buzzers:
            raise DeviceError(f"trigger board: there is no buzzer {buzzer}; this board has {self._buzzers}")
        if self._stage.clock.now_s() < self._busy_until_s:
            raise DeviceError(f"trigger board: busy, cannot play buzzer {buzzer} yet; wait until the last sound ends")
