"""The bench, put together: one block starts board, sound, camera and hands, and stops them all."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from capturing import rig_text

from acquire.clock import MonotonicClock
from acquire.devices.simulated.scene import Scene, draw_scene
from rigs.description import RigDescription
from virtual_bench.ears import Ears
from virtual_bench.hands import Hands
from virtual_bench.loudspeaker import Loudspeaker
from virtual_bench.mjpeg import mjpeg_server
from virtual_bench.plugs import BoardPlug, Plugs
from virtual_bench.pulse import pulse_server
from virtual_bench.sound import Air
from virtual_bench.truth import write_truth
from virtual_bench.view import View

STEP_S = 0.01
QUIET_S = 2.5  # longer than a capture takes to judge an emission, fire it again, and look once more
PATIENCE_S = 20.0
RIG_FILE, ENVIRONMENT_FILE = "rig.yaml", "environment.sh"


@dataclass
class Bench:
    """A running bench.

    Parameters
    ----------
    folder : Path
        Where its rig file, its environment and the truth are.
    environment : dict
        What a program that records must have in its environment.
    """

    folder: Path
    environment: dict[str, str]
    scene: Scene
    hands: Hands
    ears: Ears
    loudspeaker: Loudspeaker
    plugs: Plugs

    def run_for(self, duration_s: float) -> None:
        """Let the bench live for a while."""
        end_s = time.monotonic() + duration_s
        while (now_s := time.monotonic()) < end_s:
            self.step()
            time.sleep(max(0.0, now_s + STEP_S - time.monotonic()))

    def step(self) -> None:
        """Hear what the pins did, play what is due, and move the board if it is time to."""
        for emission in self.ears.hear(self.plugs.board.new_edges()):
            self.hands.hear(emission.buzzer, emission.on_s)
        self.ears.play()
        if place := self.hands.step():
            self.ears.move(place)
            self.write_truth()

    def write_truth(self) -> None:
        """Write down what is true so far."""
        write_truth(self.folder, self.scene, self.hands.places, self.ears.emissions, self.loudspeaker.slips_s)


@contextmanager
def virtual_bench(description: RigDescription, folder: Path, *, seed: int = 0, port: int = 0) -> Iterator[Bench]:
    """Run a bench until the block ends; it lives in `run_for`.

    Parameters
    ----------
    description : RigDescription
        Drivers serial, portaudio and opencv; the bench says itself where its devices are, in `folder / RIG_FILE`.
    folder : Path
    seed : int
        Array, camera, board, places, room and noise follow from it.
    port : int
        Of the camera's address; 0: any that is free.
    """
    scene, audio = draw_scene(description, seed), description.audio
    clock, air = MonotonicClock(), Air(scene, audio.sample_rate_hz)
    with ExitStack() as stack:
        board = stack.enter_context(BoardPlug(folder))
        sound = stack.enter_context(pulse_server(channels=len(audio.recorded_channels()), rate_hz=audio.sample_rate_hz))
        loudspeaker = Loudspeaker(sound)
        stack.callback(loudspeaker.close)
        loudspeaker.start()
        executor = stack.enter_context(ThreadPoolExecutor(1))
        buzzers = [buzzer.id for buzzer in description.board.buzzers]
        ears = Ears(air, loudspeaker, buzzers, executor)
        hands = Hands(scene, clock, QUIET_S, PATIENCE_S)
        ears.move(hands.place)
        camera = stack.enter_context(mjpeg_server(View(scene, hands).jpeg, description.camera.fps, port))
        plugs = Plugs(board, camera, sound, loudspeaker)
        bench = Bench(folder, sound.environment, scene, hands, ears, loudspeaker, plugs)
        _write_rig(folder, description, str(board.port), camera.url)
        _write_environment(folder, sound.environment)
        try:
            yield bench
        finally:
            bench.write_truth()


def _write_rig(folder: Path, description: RigDescription, port: str, source: str) -> None:
    """Write the rig file with the places of this bench's devices in it."""
    trigger = description.trigger.model_copy(update={"port": port})
    camera = description.camera.model_copy(update={"source": source})
    (folder / RIG_FILE).write_text(rig_text(description.model_copy(update={"trigger": trigger, "camera": camera})))


def _write_environment(folder: Path, environment: dict[str, str]) -> None:
    """Write what a shell needs to reach this bench's sound server; last of all, so that it tells that all is there."""
    lines = [f"export {name}={value}\n" for name, value in environment.items() if name.startswith("PULSE_")]
    unfinished = folder / f"{ENVIRONMENT_FILE}.part"
    unfinished.write_text("".join(lines))
    unfinished.replace(folder / ENVIRONMENT_FILE)
