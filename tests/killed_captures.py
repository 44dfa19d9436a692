"""Captures that are killed: where, what they had said, and what is left of each."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from capturing import rig_text, small_description
from crash_images import build_shim

from rigs.session.reader import Session
from rigs.session.recover import recover

HARNESS = Path(__file__).parent / "kill_harness.py"


@dataclass(frozen=True)
class Kill:
    """One capture that was killed.

    Parameters
    ----------
    how : str
    path : Path
        The session file; not there when it was killed before there was one.
    n_reported : int
        Good poses that its output told of.
    n_samples : int
        Recorded until then.
    """

    how: str
    path: Path
    n_reported: int
    n_samples: int

    def complaint(self) -> str:
        """Say what is wrong with what is left; empty when nothing is."""
        if not self.path.exists():
            return f"{self.how}: no file" if self.n_samples else ""
        copy = self.path.with_name("copy.h5")
        recovery = recover(self.path, copy)
        with Session.open(copy) as session:
            lost_s = (self.n_samples - session.n_samples) / session.sample_rate_hz
            good = recovery.n_accepted >= self.n_reported and lost_s <= 1 and not recovery.dropped
            good = good and session.complete and session.verify() == []
        return "" if good else f"{self.how}: {self.n_reported} poses reported, {lost_s:.2f} s lost, kept {recovery}"


def kills(folder: Path, n: int, seed: int, poses: int = 3) -> Iterator[Kill]:
    """Kill `rig-capture` n times: half at a random write to the session or its journal, half at a random moment."""
    rng = np.random.default_rng(seed)
    rig = folder / "rig.yaml"
    description = small_description(capture={"poses": poses}, camera={"size_px": (480, 360)})
    rig.write_text(rig_text(description), encoding="utf-8")
    environment = os.environ | {"LD_PRELOAD": str(build_shim(folder))}
    with subprocess.Popen(
        [sys.executable, str(HARNESS)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
    ) as harness:

        def run(name: str, **task: Any) -> tuple[dict[str, Any], Path, str]:
            (folder / name).mkdir()
            path, output = folder / name / "crash.h5", folder / name / "output"
            arguments = ["--session", str(path), "--rig", str(rig)]
            harness.stdin.write(
                json.dumps({"arguments": arguments, "at_write": 0, "after_s": 0, "output": str(output)} | task) + "\n"
            )
            harness.stdin.flush()
            return json.loads(harness.stdout.readline()), path, output.read_text() if output.exists() else ""

        whole, _, said = run("whole")
        assert whole["exit"] == 0, said
        assert said.count("is good:") == poses
        for number in range(n):
            at_write = int(rng.integers(1, whole["writes"])) if number % 2 else 0
            after_s = 0 if at_write else float(rng.uniform(0.02, 0.98)) * whole["duration_s"]
            answer, path, said = run(str(number), at_write=at_write, after_s=after_s)
            how = f"killed at write {at_write}" if at_write else f"killed after {after_s:.3f} s"
            if answer["exit"] == -9:  # a capture that was quicker than its kill is no kill
                yield Kill(how, path, said.count("is good:"), answer["samples"])
        harness.stdin.close()
