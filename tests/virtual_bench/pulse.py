"""A private PulseAudio whose null sink is a sound device of eight inputs: what is played to it comes back recorded."""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from threading import Thread

import numpy as np
from numpy.typing import NDArray

# The order that ALSA's pulse plugin asks for; with any other the recording is silent.
_POSITIONS = ("front-left", "front-right", "rear-left", "rear-right", "front-center", "lfe", "side-left", "side-right")
_START_TIMEOUT_S = 20.0


@dataclass
class Playing:
    """Sound on its way into the sink."""

    pacat: subprocess.Popen[bytes]
    feeder: Thread

    def wait(self, timeout_s: float = 60.0) -> None:
        """Wait until everything was played."""
        self.feeder.join(timeout_s)
        assert self.pacat.wait(timeout_s) == 0, "pacat failed"

    def stop(self) -> None:
        """Cut the sound off; harmless after its end."""
        self.pacat.kill()
        self.pacat.wait()
        self.feeder.join()


@dataclass
class PulseServer:
    """A running server.

    Parameters
    ----------
    environment : dict
        What a process needs in its environment to reach this server and no other; before it starts PortAudio.
    sink : str
        The null sink to play to; it is recorded from `source`, which is the default.
    """

    environment: dict[str, str]
    sink: str
    channels: int
    rate_hz: int
    daemon: subprocess.Popen[bytes]
    sounds: list[Playing] = field(default_factory=list)

    @property
    def source(self) -> str:
        """What to record from."""
        return f"{self.sink}.monitor"

    def play(
        self, sound: NDArray[np.float32] | Iterable[NDArray[np.float32]], latency_ms: int | None = None
    ) -> Playing:
        """Begin to play and return at once.

        Parameters
        ----------
        sound : (n_samples, channels) float32 array, or an iterable of such
            Full scale = 1. An iterable is asked for its next block as soon as the sink takes it.
        latency_ms : int
            How far ahead of the sink sound is asked for; default 1000 for an array and 50 for an iterable. On a busy
            machine a short one leaves holes in what is played: silence, in place of as many or fewer samples.
        """
        if latency_ms is None:
            latency_ms = 1000 if isinstance(sound, np.ndarray) else 50
        command = self.pacat_command(latency_ms)
        pacat = subprocess.Popen(command, stdin=subprocess.PIPE, env=self.environment)
        blocks = [sound] if isinstance(sound, np.ndarray) else sound
        playing = Playing(pacat, Thread(target=_feed, args=(pacat, blocks), daemon=True))
        playing.feeder.start()
        self.sounds.append(playing)
        return playing

    def pacat_command(self, latency_ms: int, *options: str) -> list[str]:
        """Return the command that plays to the sink what comes in as float32 samples."""
        command = ["pacat", "--playback", "--raw", "--format=float32le", f"--device={self.sink}"]
        command += [f"--rate={self.rate_hz}", f"--channels={self.channels}", f"--channel-map={_map(self.channels)}"]
        return [*command, "--no-remix", "--no-remap", f"--latency-msec={latency_ms}", *options]

    def control(self, *words: str) -> str:
        """Run `pactl` and return what it says; it fails when the server is gone."""
        run = subprocess.run(["pactl", *words], env=self.environment, capture_output=True, text=True, check=True)
        return run.stdout

    def stop(self) -> None:
        """End the server in good order: its clients are told that the device is gone."""
        self.daemon.terminate()
        self.daemon.wait(timeout=20)

    def kill(self) -> None:
        """End the server at once."""
        self.daemon.kill()
        self.daemon.wait(timeout=20)

    def freeze(self) -> None:
        """Let the device fall silent without an error, as an unplugged interface may, until `thaw`."""
        self.daemon.send_signal(signal.SIGSTOP)

    def thaw(self) -> None:
        """Let a frozen device go on."""
        self.daemon.send_signal(signal.SIGCONT)


@contextmanager
def pulse_server(
    folder: Path | None = None, *, channels: int = 8, rate_hz: int = 48000, sink: str = "rig"
) -> Iterator[PulseServer]:
    """Run a private PulseAudio until the block ends.

    Parameters
    ----------
    folder : path, optional
        Where its home goes; default a folder of its own. Its socket is elsewhere, as its path must be short.
    channels : int
        Inputs of the device, 1 to 8.
    rate_hz : int
    sink : str
        Name of the null sink.
    """
    with tempfile.TemporaryDirectory(prefix="pa-", ignore_cleanup_errors=True) as runtime:
        environment = _environment(Path(runtime), folder or Path(runtime), f"{sink}.monitor")
        # Without rewinds: with them it hands over samples up to 10 ms before they are due, which no hardware does.
        null_sink = f"module-null-sink norewinds=1 sink_name={sink} channels={channels} rate={rate_hz} format=float32le"
        command = ["pulseaudio", "-n", "--daemonize=no", "--exit-idle-time=-1", "--disable-shm=yes", "--realtime=no"]
        command += ["--high-priority=no", "--log-level=error", "-L", "module-native-protocol-unix"]
        command += ["-L", f"{null_sink} channel_map={_map(channels)}"]
        with (Path(runtime) / "log.txt").open("wb") as log:
            daemon = subprocess.Popen(command, env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        server = PulseServer(environment, sink, channels, rate_hz, daemon)
        try:
            _wait_for(server, Path(runtime) / "log.txt")
            yield server
        finally:
            for sound in server.sounds:
                sound.stop()
            server.kill()


def _environment(runtime: Path, home: Path, source: str) -> dict[str, str]:
    """The present environment with everything of another sound server taken out."""
    kept = {key: text for key, text in os.environ.items() if not key.startswith(("PULSE_", "DBUS_", "XDG_", "ALSA_"))}
    own = {"XDG_RUNTIME_DIR": str(runtime), "HOME": str(home), "DBUS_SESSION_BUS_ADDRESS": "disabled:"}
    return kept | own | {"PULSE_SERVER": f"unix:{runtime}/pulse/native", "PULSE_SOURCE": source}


def _map(channels: int) -> str:
    return ",".join(_POSITIONS[:channels]) if channels > 1 else "mono"


def _wait_for(server: PulseServer, log: Path) -> None:
    end_s = time.monotonic() + _START_TIMEOUT_S
    while time.monotonic() < end_s and server.daemon.poll() is None:
        with suppress(subprocess.CalledProcessError):
            if server.sink in server.control("list", "short", "sinks"):
                return
        time.sleep(0.05)
    raise AssertionError(f"PulseAudio did not start: {log.read_text()}")


def _feed(pacat: subprocess.Popen[bytes], blocks: Iterable[NDArray[np.float32]]) -> None:
    assert pacat.stdin is not None
    with suppress(BrokenPipeError):  # stopped, or the server is gone
        for block in blocks:
            pacat.stdin.write(np.ascontiguousarray(block, dtype=np.float32).tobytes())
    with suppress(BrokenPipeError):
        pacat.stdin.close()
