"""Throughput of the session's writer at 8 x 48 kHz with everything synced, its memory, and what a sync costs."""

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
sync_s: list[float] = []


def timed(descriptor: int) -> None:
    """Sync, and note how long it took."""
    began_s = time.perf_counter()
    os.fdatasync(descriptor)
    sync_s.append(time.perf_counter() - began_s)


def peak_mb() -> float:
    """Return the most memory that this process ever held."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def write(path: Path) -> tuple[float, float, float, float]:
    """Return the seconds until all was written, and on the disk, those of the CPU, and memory's growth in MB."""
    noise = np.random.default_rng(0).normal(0, 0.1, (64, BLOCK, CHANNELS)).astype(np.float32)
    n_blocks = MINUTES * 60 * RATE_HZ // BLOCK
    began_s, began_cpu_s = time.perf_counter(), time.process_time()
    writer = SessionWriter.create(
        path,
        name="bench",
        description_text=shipped_rigs()["simulated"],
        n_channels=CHANNELS,
        sample_rate_hz=RATE_HZ,
        versions={},
    )
    early_mb = 0.0
    for block in range(n_blocks):
        writer.append_audio(noise[block % 64], host_time_s=block * BLOCK / RATE_HZ, adc_time_s=0.0)
        if block == n_blocks // 10:
            early_mb = peak_mb()
    written_s = time.perf_counter() - began_s
    writer.close()
    cpu_s = time.process_time() - began_cpu_s
    return written_s, time.perf_counter() - began_s, cpu_s, peak_mb() - early_mb


def main() -> None:
    """Print the table."""
    durability._sync = timed
    with TemporaryDirectory(dir=Path.cwd()) as folder:
        path = Path(folder) / "bench.h5"
        written_s, closed_s, cpu_s, growth_mb = write(path)
        with Session.open(path) as session:
            assert session.n_samples >= (MINUTES * 60 - 1) * RATE_HZ
        began_s, before_mb = time.perf_counter(), peak_mb()
        recover(path, Path(folder) / "copy.h5")
        recovered_s, recover_mb = time.perf_counter() - began_s, peak_mb() - before_mb
    sound_s = MINUTES * 60
    table = Table(title=f"writer, {MINUTES} minutes of 8 x 48 kHz, synced every second", title_justify="left")
    for column in ("figure", "limit", "measured"):
        table.add_column(column, justify="left" if column == "figure" else "right")
    table.add_row("written, times real time", "at least 20", f"{sound_s / written_s:.0f}")
    table.add_row("written and on the disk, times real time", "", f"{sound_s / closed_s:.0f}")
    table.add_row("CPU at real time, of one core", "", f"{cpu_s / sound_s:.1%}")
    table.add_row("memory's growth after the first minute", "10 MB", f"{growth_mb:.1f} MB")
    table.add_row(
        "one sync, median and longest", "", f"{statistics.median(sync_s) * 1e3:.1f}, {max(sync_s) * 1e3:.1f} ms"
    )
    table.add_row("recovered, times real time", "", f"{sound_s / recovered_s:.0f}")
    table.add_row("memory's growth while recovering", "10 MB", f"{recover_mb:.1f} MB")
    Console().print(table)


if __name__ == "__main__":
    main()
