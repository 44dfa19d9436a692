"""The benchmark of the capture loop: 8 channels at 192 kHz and 1280 x 720 at 30 frames/s into one session.

Sound and pictures are made up as cheaply as can be, in threads of their own and in real time, so that what is measured
is the recording: is anything lost, how much of a core does it take, and does its memory grow; quietly, and with a busy
process on each of two cores. Ten minutes each, a minute with --quick.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import shutil
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.console import Console
from rich.table import Table

from acquire.clock import MonotonicClock
from acquire.devices.base import AudioBlock, ClockFit, EmissionStart, Frame, Ping, Rhythm, Rig
from acquire.devices.camera_recorded import Paced
from acquire.devices.camera_stream import PictureStream
from acquire.devices.frame_queue import FrameQueue
from acquire.errors import DeviceError
from acquire.recording import Recording
from acquire.screen import PlainScreen
from acquire.status import Status
from rigs.description import RigDescription
from rigs.library import FoundDescription, parse_description
from rigs.session.layout import FLAG_GAP, FLAG_OVERFLOW
from rigs.session.reader import Session
from rigs.session.writer import SessionWriter
from rigs.waveform import Waveform

BLOCK_SAMPLES = 2048
QUEUE_S = 10.0
STORED_FPS = 5.0
LIMITS = {"memory": 300.0, "growth": 10.0, "cpu48": 0.25}
DESCRIPTION = """
name: benchmark
audio: {{driver: simulated, sample_rate_hz: {rate_hz}, channels: [1, 2, 3, 4, 5, 6, 7, 8]}}
camera: {{driver: simulated, size_px: [1280, 720], fps: 30}}
board:
  pattern: checkerboard
  corners: [9, 6]
  square_size_m: 0.025
  buzzers: [{{id: 1, position_m: [0.1, -0.045, 0.0]}}]
trigger: {{driver: simulated}}
signal: {{kind: sweep}}
medium: {{temperature_c: 20}}
capture: {{frame_interval_s: {frame_interval_s}}}
"""


class ThreadedAudio:
    """Delivers noise that was drawn beforehand, block after block in real time, into a queue of ten seconds."""

    def __init__(self, rate_hz: int, n_channels: int) -> None:
        self._rate_hz = rate_hz
        noise = np.random.default_rng(0).normal(scale=0.05, size=(8, BLOCK_SAMPLES, n_channels))
        self._noise = noise.astype(np.float32)
        self._queue: deque[AudioBlock] = deque()
        self._max_blocks = round(QUEUE_S * rate_hz / BLOCK_SAMPLES)
        self._thread = threading.Thread(target=self._deliver)
        self._ends = threading.Event()
        self.n_samples = 0

    def open(self) -> str:
        self._thread.start()
        return "benchmark-audio 1.0"

    def read(self) -> list[AudioBlock]:
        return [self._queue.popleft() for _ in range(len(self._queue))]

    def close(self) -> None:
        self._ends.set()
        if self._thread.is_alive():
            self._thread.join()

    def _deliver(self) -> None:
        start_s, flags = time.monotonic(), 0
        for number in range(sys.maxsize):
            due_s = start_s + (number + 1) * BLOCK_SAMPLES / self._rate_hz
            if self._ends.wait(max(due_s - time.monotonic(), 0)):
                return
            stamp_s = time.monotonic() - BLOCK_SAMPLES / self._rate_hz
            if len(self._queue) >= self._max_blocks:
                flags = FLAG_OVERFLOW
                continue
            self._queue.append(AudioBlock(self._noise[number % 8].copy(), stamp_s, float("nan"), flags))
            self.n_samples += BLOCK_SAMPLES
            flags = 0


class MadeUpPictures:
    """Four noisy pictures of a checkerboard, in turn, for ever."""

    def __init__(self, size_px: tuple[int, int]) -> None:
        width, height = size_px
        rng = np.random.default_rng(1)
        columns, rows = np.meshgrid(np.arange(width), np.arange(height))
        clean = 90.0 + 80.0 * ((columns // 60 + rows // 60) % 2)
        self._pictures = [
            np.clip(clean + rng.normal(scale=2, size=clean.shape), 0, 255).astype(np.uint8) for _ in range(4)
        ]
        self._n_grabbed = 0

    def grab(self) -> bool:
        self._n_grabbed += 1
        return True

    def retrieve(self) -> tuple[bool, np.ndarray]:
        return True, self._pictures[self._n_grabbed % len(self._pictures)].copy()

    def release(self) -> None:
        pass


class StreamedCamera:
    """The draining thread of a real camera, on pictures that are made up."""

    def __init__(self, size_px: tuple[int, int], fps: float) -> None:
        self._pictures = Paced(MadeUpPictures(size_px), fps)
        self._stream: PictureStream | None = None
        self.warnings: list[str] = []

    def open(self) -> str:
        self._stream = PictureStream(lambda: self._pictures, "benchmark camera", is_live=True, fps=30.0)
        return "benchmark-camera 1.0"

    def read(self) -> Frame:
        assert self._stream
        return self._stream.next_frame(2.0)

    def collect(self, rhythm: Rhythm | None) -> int:
        assert self._stream
        ended, self._stream.queue = self._stream.queue, None if rhythm is None else FrameQueue(rhythm)
        return 0 if ended is None else ended.n_missing_at(time.monotonic())

    def collected(self) -> list[Frame]:
        assert self._stream
        self._stream.check(2.0)
        return self._stream.queue.take() if self._stream.queue else []

    def close(self) -> None:
        if self._stream:
            self._stream.stop()


class NoTrigger:
    """A board that is not asked for anything."""

    def open(self) -> str:
        return "none"

    def play(self, buzzer: int, waveform: Waveform) -> EmissionStart:
        raise DeviceError("the benchmark fires no buzzer")

    def read_clock(self) -> list[Ping]:
        return []

    def clock_fit(self) -> ClockFit:
        raise DeviceError("the benchmark has no board")

    def close(self) -> None:
        pass


class NoOperator:
    """Nobody moves the board."""

    def ask_for_pose(self, pose: int) -> None:
        pass


@dataclass(frozen=True)
class Outcome:
    """What one run came to; memory in MB, cpu as a share of one core.

    A frame is lost where an interval has none. One may come late without that: a busy computer wakes any thread late.
    """

    lost_samples: int
    gaps: int
    lost_frames: int
    frame_late_s: float
    cpu: float
    cpu_sources: float
    peak_mb: float
    growth_mb: float
    backlog_s: float


def main() -> int:
    """Run all cases and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a minute each instead of ten")
    parser.add_argument("--duration", type=float, help="seconds each")
    parser.add_argument("--folder", type=Path, help="where the sessions go (4 GB for ten minutes); deleted afterwards")
    options = parser.parse_args()
    duration_s = options.duration or (60.0 if options.quick else 600.0)
    table = Table(
        title=f"Capture: 8 channels, 1280 x 720 grabbed at 30 and stored at 5 frames/s, {duration_s:g} s each"
    )
    for column in ("", "limit", "192 kHz, quiet", "192 kHz, 2 busy processes", "48 kHz, quiet"):
        table.add_column(column, justify="left" if not column else "right")
    runs = [
        _in_own_process(rate, busy, duration_s, options.folder) for rate, busy in ((192000, 0), (192000, 2), (48000, 0))
    ]
    for label, limit, values in _rows(runs):
        table.add_row(label, limit, *values)
    Console().print(table)
    return 0


def _rows(runs: list[Outcome]) -> Iterator[tuple[str, str, list[str]]]:
    yield "samples lost", "0", [str(run.lost_samples) for run in runs]
    yield "gaps flagged", "0", [str(run.gaps) for run in runs]
    yield "frames lost", "0", [str(run.lost_frames) for run in runs]
    yield "latest frame", "", [f"{run.frame_late_s:.2f} s" for run in runs]
    yield "longest wait of audio", "10 s", [f"{run.backlog_s:.2f} s" for run in runs]
    yield "peak memory", "300 MB", [f"{run.peak_mb:.0f} MB" for run in runs]
    yield "growth after 10 s", "none", [f"{run.growth_mb:+.1f} MB" for run in runs]
    yield "share of one core", "25 % at 48 kHz", [f"{run.cpu:.1%}" for run in runs]
    yield "of it by the sources", "", [f"{run.cpu_sources:.1%}" for run in runs]


def _in_own_process(rate_hz: int, n_busy: int, duration_s: float, folder: Path | None) -> Outcome:
    """Run one case in a fresh process, so that memory is its own."""
    context = multiprocessing.get_context("spawn")
    with ExitStack() as stack:
        for _ in range(n_busy):
            stack.enter_context(_busy_process())
        pool = stack.enter_context(context.Pool(1))
        return pool.apply(run, (rate_hz, duration_s, folder))


@contextmanager
def _busy_process() -> Iterator[None]:
    with subprocess.Popen([sys.executable, "-c", "while True: pass"]) as busy:
        try:
            yield
        finally:
            busy.kill()


def run(rate_hz: int, duration_s: float, folder: Path | None) -> Outcome:
    """Record for a while and look at what came of it."""
    text = DESCRIPTION.format(rate_hz=rate_hz, frame_interval_s=1 / STORED_FPS)
    found = FoundDescription(text, parse_description(text, "benchmark"), "benchmark", "benchmark")
    with TemporaryDirectory(dir=folder) as temporary:
        path = Path(temporary) / "benchmark.h5"
        if shutil.disk_usage(temporary).free < 1.3 * (32 * rate_hz + 4e6) * duration_s:
            raise SystemExit(f"{temporary}: too little room; name another place by --folder")
        return _record(found, path, rate_hz, duration_s)


def _record(found: FoundDescription, path: Path, rate_hz: int, duration_s: float) -> Outcome:
    description = found.description
    audio, camera = ThreadedAudio(rate_hz, 8), StreamedCamera(description.camera.size_px, description.camera.fps)
    rig = Rig(NoTrigger(), audio, camera, MonotonicClock(), NoOperator())
    status = Status("benchmark", str(path), description.audio.recorded_channels(), 1, 1)
    writer = SessionWriter.create(
        path, name="benchmark", description_text=found.text, n_channels=8, sample_rate_hz=rate_hz, versions={}
    )
    with writer:
        camera.open()
        audio.open()
        try:
            recording = Recording(rig, writer, description, PlainScreen(Console()), status, lambda: False)
            measured = _watched(recording, duration_s)
        finally:
            audio.close()
            camera.close()
        for block in audio.read():  # what came after the last look
            writer.append_audio(block.samples, host_time_s=block.host_time_s, adc_time_s=block.adc_time_s)
    sources = _source_share(description, rate_hz)
    return _judged(path, audio, recording.film.n_missing, duration_s, measured, sources)


def _watched(recording: Recording, duration_s: float) -> tuple[float, float, float, float]:
    """Record and return (cpu share, peak MB, growth MB, longest backlog s)."""
    samples_mb, backlog_s = [], 0.0
    recording.film.begin(recording.look(), pose=0)
    start_s, cpu_s = time.monotonic(), time.process_time()
    while (now_s := time.monotonic() - start_s) < duration_s:
        recording.record(min(1.0, duration_s - now_s))
        samples_mb.append(_resident_mb())
        backlog_s = max(backlog_s, recording.status.backlog_s)
    share = (time.process_time() - cpu_s) / (time.monotonic() - start_s)
    recording.film.end()
    settled = samples_mb[min(10, len(samples_mb) // 2) :]
    third = max(len(settled) // 3, 1)
    growth_mb = float(np.median(settled[-third:]) - np.median(settled[:third]))
    return share, max(samples_mb), growth_mb, backlog_s


def _source_share(description: RigDescription, rate_hz: int) -> float:
    """Return the share of a core that the sources alone take, their sound and pictures thrown away."""
    audio, camera = ThreadedAudio(rate_hz, 8), StreamedCamera(description.camera.size_px, description.camera.fps)
    camera.open()
    audio.open()
    start_s, cpu_s = time.monotonic(), time.process_time()
    while time.monotonic() - start_s < 5:
        time.sleep(0.1)
        audio.read()
    share = (time.process_time() - cpu_s) / (time.monotonic() - start_s)
    audio.close()
    camera.close()
    return share


def _judged(
    path: Path,
    audio: ThreadedAudio,
    n_missing: int,
    duration_s: float,
    measured: tuple[float, float, float, float],
    sources: float,
) -> Outcome:
    cpu, peak_mb, growth_mb, backlog_s = measured
    with Session.open(path) as session:
        flags = session.audio_blocks["flags"]
        gaps = int(np.count_nonzero(flags & (FLAG_GAP | FLAG_OVERFLOW)))
        lost_samples = audio.n_samples - session.n_samples
        late_s = float(np.diff(session.frames["host_time_s"]).max()) - 1 / STORED_FPS
        lost_frames = max(n_missing, int(duration_s * STORED_FPS) - len(session.frames))
    return Outcome(lost_samples, gaps, lost_frames, late_s, cpu, sources, peak_mb, growth_mb, backlog_s)


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


if __name__ == "__main__":
    sys.exit(main())
