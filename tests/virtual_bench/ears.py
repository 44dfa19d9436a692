"""From pins to played samples: each emission's edges, heard where the board is, a steady time later."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from itertools import groupby, pairwise
from math import ceil

import numpy as np
from simboard import BUZZER_PINS

from acquire.devices.simulated.impulses import HALF_WIDTH_SAMPLES
from virtual_bench.hands import Place
from virtual_bench.loudspeaker import Loudspeaker
from virtual_bench.mix import Mix
from virtual_bench.pins import Edge
from virtual_bench.sound import Air, Response

RENDER_LATENCY_S = 0.35  # from an edge to its sound: what is written ahead, and time to follow the trace and render
_PAUSE_S = 0.05  # a pin at rest for so long begins a new emission
_NUMBER_OF_PIN = {pin: number for number, pin in BUZZER_PINS.items()}


@dataclass
class Emission:
    """One sound of a buzzer.

    Parameters
    ----------
    buzzer : int
        Its number at the trigger board.
    place : int
    on_s : float
        Host time of the first edge.
    late_s : float
        How much later than others it was heard, because its edges came too late.
    lost_samples : int
        What of it could not be heard at all.
    """

    buzzer: int
    place: int
    on_s: float
    late_s: float = 0.0
    lost_samples: int = 0


class Ears:
    """Renders what the pins do.

    Parameters
    ----------
    air : Air
    loudspeaker : Loudspeaker
        Started.
    buzzers : sequence of int
        The rig description's ids, in its order.
    executor : Executor
        Works out how buzzers sound at a new place before they do.
    """

    def __init__(
        self,
        air: Air,
        loudspeaker: Loudspeaker,
        buzzers: Sequence[int],
        executor: Executor,
    ) -> None:
        self._air, self._loudspeaker, self._buzzers = air, loudspeaker, list(buzzers)
        self._executor = executor
        self._mix = Mix(loudspeaker.channels, loudspeaker.written)
        self._rng = np.random.default_rng()
        self._responses: dict[int, Future[Response]] = {}
        self._place: Place | None = None
        self._last_edge_s: dict[int, float] = {}
        self._sounding: dict[int, tuple[Emission, Response]] = {}
        self.emissions: list[Emission] = []

    def move(self, place: Place) -> None:
        """Go to a new place with the board."""
        self._place = place
        self._responses = {
            buzzer: self._executor.submit(self._air.response, index, place.board_to_camera, place.number)
            for index, buzzer in enumerate(self._buzzers)
        }

    def hear(self, edges: Sequence[Edge]) -> list[Emission]:
        """Render new edges and return the emissions that begin with them."""
        n_before = len(self.emissions)
        driven = [edge for edge in edges if _NUMBER_OF_PIN.get(edge.pin) in self._buzzers]
        for pin, of_pin in groupby(sorted(driven, key=lambda edge: edge.pin), key=lambda edge: edge.pin):
            self._hear_buzzer(_NUMBER_OF_PIN[pin], list(of_pin))
        return self.emissions[n_before:]

    def play(self) -> None:
        """Give the loudspeaker what it is due, with the microphones' noise."""
        if self._loudspeaker.stood_still:
            self._loudspeaker.restart()
            self._mix = Mix(self._loudspeaker.channels, self._loudspeaker.written)
        sound = self._mix.take(self._loudspeaker.due())
        noise = self._rng.standard_normal(sound.shape, dtype=np.float32) * self._air.noise_rms
        self._loudspeaker.play(np.clip(sound + noise, -1, 1))
        if self._mix.is_silent():
            self._loudspeaker.keep_time()

    def _hear_buzzer(self, buzzer: int, edges: list[Edge]) -> None:
        begins = {n for n, edge in enumerate(edges) if edge.time_s - self._before(buzzer, edges, n) > _PAUSE_S}
        self._last_edge_s[buzzer] = edges[-1].time_s
        bounds = sorted({0, *begins, len(edges)})
        for begin, end in pairwise(bounds):
            if begin in begins:
                self._begin(buzzer, edges[begin].time_s)
            self._render(buzzer, edges[begin:end])

    def _before(self, buzzer: int, edges: list[Edge], n: int) -> float:
        return edges[n - 1].time_s if n else self._last_edge_s.get(buzzer, float("-inf"))

    def _begin(self, buzzer: int, on_s: float) -> None:
        assert self._place is not None
        first = self._loudspeaker.sample_at(on_s + RENDER_LATENCY_S) - 3 * HALF_WIDTH_SAMPLES - 1
        late_s = max(0, ceil(self._mix.begin - first)) / self._loudspeaker.rate_hz
        emission = Emission(buzzer, self._place.number, on_s, late_s)
        self._sounding[buzzer] = (emission, self._responses[buzzer].result())
        self.emissions.append(emission)

    def _render(self, buzzer: int, edges: list[Edge]) -> None:
        emission, response = self._sounding[buzzer]
        heard_s = np.array([edge.time_s for edge in edges]) + RENDER_LATENCY_S + emission.late_s
        position = self._loudspeaker.sample_at(heard_s)
        step = np.array([2.0 * edge.level - 1 for edge in edges])
        for first_sample, pressure in response.heard(position, step):
            emission.lost_samples += self._mix.add(first_sample, pressure)
