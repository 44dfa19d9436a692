"""A Dask cluster of real processes on loopback, for tests."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

START_S = 300  # of a machine that others keep busy


class DaskCluster:
    """A scheduler and workers, each a process of its own; only these are ever ended."""

    def __init__(self, folder: Path, n_workers: int) -> None:
        self._folder, file = folder, folder / "scheduler.json"
        self.scheduler = self._start("dask_scheduler", "--port", "0", "--scheduler-file", str(file))
        wait_until(lambda: file.exists() and file.read_text().endswith("}"))
        self.address = json.loads(file.read_text())["address"]
        self.workers = [
            self._start("dask_worker", self.address, "--no-nanny", "--nthreads", "1", "--local-directory", str(folder))
            for _ in range(n_workers)
        ]

    def _start(self, module: str, *arguments: str) -> subprocess.Popen:
        command = [sys.executable, "-m", f"distributed.cli.{module}", "--host", "127.0.0.1", "--dashboard-address",
                   "127.0.0.1:0", *arguments]  # fmt: skip
        with (self._folder / "cluster.log").open("ab") as log:
            return subprocess.Popen(command, cwd=self._folder, stdout=log, stderr=log)

    def hold(self) -> None:
        """Let no worker go on: what happens now happens in mid-run."""
        for process in self.workers:
            process.send_signal(signal.SIGSTOP)

    def go_on(self) -> None:
        for process in self.workers:
            if process.poll() is None:
                process.send_signal(signal.SIGCONT)

    def close(self) -> None:
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


@contextmanager
def dask_cluster(folder: Path, n_workers: int):
    folder.mkdir()
    cluster = DaskCluster(folder, n_workers)
    try:
        yield cluster
    finally:
        cluster.close()


def wait_until(condition, limit_s: float = START_S) -> None:
    end_s = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > end_s:
            raise TimeoutError("waited in vain")
        time.sleep(0.02)
