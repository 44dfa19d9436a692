"""The session's writer at 8 x 48 kHz, all of it synced: throughput, memory, and the sound that a power loss costs."""

from __future__ import annotations

import os
import resource
import statistics
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.console import Console
from rich.table import Table

from rigs.library import shipped_rigs
from rigs.session import durability
from rigs.session.reader import Session
from rigs.session.recover import recover
from rigs.session.writer import SessionWriter

RATE_HZ, CHANNELS, BLOCK = 48000, 8, 1024
MINUTES = 10
REAL_TIME_S = 30
NOISE = np.random.default_rng(0).normal(0, 0.1, (64, BLOCK, CHANNELS)).astype(np.float32)
sync_s: list[float] = []


def timed(descriptor: int) -> None:
    """Sync, and note how long it took."""
    began_s = time.perf_counter()
    os.fdatasync(descriptor)
    sync_s.append(time.perf_counter() - began_s)


def peak_mb() -> float:
    """Return the most memory that this process ever held."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def new_session(path: Path) -> SessionWriter:
    """Return the writer of a session without anything but sound."""
    return SessionWriter.create(
        path,
        name="bench",
        description_text=shipped_rigs()["simulated"],
        n_channels=CHANNELS,
        sample_rate_hz=RATE_HZ,
        versions={},
    )


def write(path: Path) -> tuple[float, float, float]:
    """Return the seconds until all was written, and on the disk, and memory's growth in MB."""
    n_blocks = MINUTES * 60 * RATE_HZ // BLOCK
    began_s = time.perf_counter()
    writer = new_session(path)
    early_mb = 0.0
    for block in range(n_blocks):
        writer.append_audio(NOISE[block % 64], host_time_s=block * BLOCK / RATE_HZ, adc_time_s=0.0)
        if block == n_blocks // 10:
            early_mb = peak_mb()
    written_s = time.perf_counter() - began_s
    writer.close()
    return written_s, time.perf_counter() - began_s, peak_mb() - early_mb


def write_at_real_time(path: Path) -> tuple[float, float]:
    """Return the most sound, in seconds, that a power loss at any moment would have cost, and the share of a core."""
    flushed: list[int] = []  # samples, at the beginning of each sync of the session file
    done_s: list[float] = []  # the end of each sync of the journal

    def noted(descriptor: int) -> None:
        is_session = len(flushed) == len(done_s)
        if is_session:
            flushed.append(writer._n_flushed_samples)
        timed(descriptor)
        if not is_session:
            done_s.append(time.perf_counter() - began_s)

    writer = new_session(path)
    durability._sync = noted
    began_s, began_cpu_s = time.perf_counter(), time.process_time()
    for block in range(REAL_TIME_S * RATE_HZ // BLOCK):
        time.sleep(max(0.0, began_s + (block + 1) * BLOCK / RATE_HZ - time.perf_counter()))
        writer.append_audio(NOISE[block % 64], host_time_s=block * BLOCK / RATE_HZ, adc_time_s=0.0)
    cpu = (time.process_time() - began_cpu_s) / REAL_TIME_S
    writer.close()
    safe = [0, *flushed]
    return max(end_s - n / RATE_HZ for n, end_s in zip(safe, done_s, strict=False)), cpu


def main() -> None:
    """Print the table."""
    durability._sync = timed
    with TemporaryDirectory(dir=Path.cwd()) as folder:
        path = Path(folder) / "bench.h5"
        written_s, closed_s, growth_mb = write(path)
        with Session.open(path) as session:
            assert session.n_samples >= (MINUTES * 60 - 1) * RATE_HZ
        with new_session(Path(folder) / "minute.h5") as minute:
            for block in range(60 * RATE_HZ // BLOCK):
                minute.append_audio(NOISE[block % 64], host_time_s=0.0, adc_time_s=0.0)
        recover(Path(folder) / "minute.h5", Path(folder) / "minute-copy.h5")
        began_s, before_mb = time.perf_counter(), peak_mb()
        recover(path, Path(folder) / "copy.h5")
        recovered_s, recover_mb = time.perf_counter() - began_s, peak_mb() - before_mb
        sync_s.clear()
        lost_s, cpu = write_at_real_time(Path(folder) / "real.h5")
    sound_s = MINUTES * 60
    table = Table(
        title=f"writer, {MINUTES} minutes of 8 x 48 kHz, and {REAL_TIME_S} s at real time", title_justify="left"
    )
    for column in ("figure", "limit", "measured"):
        table.add_column(column, justify="left" if column == "figure" else "right")
    table.add_row("written, times real time", "at least 20", f"{sound_s / written_s:.0f}")
    table.add_row("written and on the disk, times real time", "", f"{sound_s / closed_s:.0f}")
    table.add_row("CPU at real time, of one core", "", f"{cpu:.1%}")
    table.add_row("sound that a power loss costs at worst", "1 s", f"{lost_s:.2f} s")
    table.add_row("memory's growth after the first minute", "10 MB", f"{growth_mb:.1f} MB")
    table.add_row(
        "one sync at real time, median and longest",
        "",
        f"{statistics.median(sync_s) * 1e3:.1f}, {max(sync_s) * 1e3:.1f} ms",
    )
    table.add_row("recovered, times real time", "", f"{sound_s / recovered_s:.0f}")
    table.add_row("memory's growth while recovering, after a minute", "10 MB", f"{recover_mb:.1f} MB")
    Console().print(table)


if __name__ == "__main__":
    main()
