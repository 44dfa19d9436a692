"""The loudspeaker: plays samples to a PulseAudio sink without a break, and knows when each one sounds."""

from __future__ import annotations

import fcntl
import os
import re
import subprocess
import time
from collections import deque
from threading import Thread

import numpy as np
from numpy.typing import NDArray

from virtual_bench.pulse import PulseServer

_LATENCY_MS = 400  # of pacat: the room that `_LEAD_S` needs
_LEAD_S = 0.25  # so far ahead is written: a pause of this program up to that length goes unheard
_PRIMING_S = 0.45  # silence that pacat wants before it begins
_WINDOW_S = 4.0  # of readings
_MIN_READINGS = 30
_QUANTILE = 0.1  # of the readings: most come late on a busy machine, one now and then is early
_STEP_S = 0.0005  # the origin follows in steps of at least this much: the sink's clock drifts by some 40 ppm
_SLIP_S = 0.005  # a step beyond this is a break in the sound
_PIPE_BYTES = 1 << 18
_STANDSTILL_S = 1.0  # so long takes no sample but those that a server that stood still takes
_READING = re.compile(rb"Time: ([\d.]+) sec")


class SoundOrigin:
    """When sample 0 sounded, or would have: from what pacat says about the place it has come to.

    A reading comes late on a busy machine, and now and then one is early, so a low quantile counts. After an underrun
    the sound goes on later than before: the readings say by how much.
    """

    def __init__(self) -> None:
        self._readings: deque[tuple[float, float]] = deque(maxlen=200)
        self.underruns = 0

    def add(self, host_s: float, played_s: float) -> None:
        """Take a reading: at this host time so many seconds had been played."""
        if played_s > 0:
            self._readings.append((host_s, host_s - played_s))

    def restart(self) -> None:
        """Forget the readings: there was an underrun."""
        self._readings.clear()
        self.underruns += 1

    def estimate_s(self, now_s: float) -> float | None:
        """Return the origin in host time, None while there are too few readings."""
        recent = [origin_s for host_s, origin_s in list(self._readings) if now_s - host_s < _WINDOW_S]
        return float(np.quantile(recent, _QUANTILE)) if len(recent) >= _MIN_READINGS else None

    def first_guess_s(self) -> float | None:
        """Return the origin by however few readings there are."""
        return min((origin_s for _, origin_s in list(self._readings)), default=None)


class Loudspeaker:
    """Plays through `pacat`.

    Parameters
    ----------
    server : PulseServer
    """

    def __init__(self, server: PulseServer) -> None:
        self.rate_hz, self.channels = server.rate_hz, server.channels
        self.server = server
        self.slips_s: list[float] = []
        self._paused = False
        self._spawn()

    def start(self, timeout_s: float = 20.0) -> None:
        """Play silence until it is known when each sample sounds."""
        self._play_silence(round(_PRIMING_S * self.rate_hz))
        end_s = time.monotonic() + timeout_s
        while (origin_s := self.origin.estimate_s(time.monotonic())) is None:
            assert time.monotonic() < end_s, "pacat plays nothing"
            if (guess_s := self.origin.first_guess_s()) is not None:
                self.origin_s = guess_s
                self._play_silence(self.due())
            time.sleep(0.02)
        self.origin_s = origin_s

    def has_ended(self) -> bool:
        """Tell whether `pacat` was killed, or lost its server."""
        return self._pacat.poll() is not None

    def pause(self) -> None:
        """Play nothing until `go_on`: the sink is suspended."""
        self._paused = True

    def go_on(self) -> None:
        """Play on, from the beginning."""
        self._paused, self.stood_still = False, True

    def is_paused(self) -> bool:
        """Tell whether nothing is played."""
        return self._paused

    def due(self) -> int:
        """Return how many samples should be written now."""
        if self._paused:
            return 0
        return max(0, int(self.sample_at(time.monotonic() + _LEAD_S)) - self.written)

    def play(self, samples: NDArray[np.float32]) -> None:
        """Write samples (n, channels) after those before."""
        begin_s = time.monotonic()
        self._pacat.stdin.write(samples.astype(np.float32, copy=False).tobytes())
        self._pacat.stdin.flush()
        self.written += len(samples)
        self.stood_still |= time.monotonic() - begin_s > _STANDSTILL_S

    def sample_at(self, host_s: float) -> float:
        """Return the sample, with its fraction, that sounds at a host time."""
        return (host_s - self.origin_s) * self.rate_hz

    def restart(self) -> None:
        """Begin anew: a server that stood still would play all that follows late, by as long as that was."""
        self.close()
        self._spawn()
        self.start()

    def keep_time(self) -> None:
        """Let the origin follow the sink's clock, or a break in the sound; to be called only while nothing sounds."""
        origin_s = self.origin.estimate_s(time.monotonic())
        if origin_s is None or abs(origin_s - self.origin_s) < _STEP_S:
            return
        if abs(origin_s - self.origin_s) > _SLIP_S:
            self.slips_s.append(origin_s - self.origin_s)
        self.origin_s = origin_s

    def close(self) -> None:
        """End the sound."""
        self._pacat.kill()
        self._pacat.wait()
        self._reader.join()
        self._pacat.stdin.close()
        self._pacat.stderr.close()

    def _spawn(self) -> None:
        self.origin = SoundOrigin()
        self.origin_s = float("nan")
        self.written = 0
        self.stood_still = False  # the server, while something was written
        self._pacat = subprocess.Popen(
            self.server.pacat_command(_LATENCY_MS, "--verbose"),
            stdin=subprocess.PIPE, stderr=subprocess.PIPE, env=self.server.environment,
        )  # fmt: skip
        assert self._pacat.stdin is not None
        fcntl.fcntl(self._pacat.stdin, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
        self._reader = Thread(target=self._read, daemon=True)
        self._reader.start()

    def _play_silence(self, n_samples: int) -> None:
        self.play(np.zeros((n_samples, self.channels), np.float32))

    def _read(self) -> None:
        """Follow what pacat says, 20 times a second."""
        while said := os.read(self._pacat.stderr.fileno(), 4096):
            now_s = time.monotonic()
            if b"underrun" in said:
                self.origin.restart()
            elif readings := _READING.findall(said):
                self.origin.add(now_s, float(readings[-1]))
