"""Table II of the paper: time of its 16 cells, and how much faster two workers are than one. Run by `make bench`.

The limits: 90 s on two idle cores, and 1.7 times the throughput of one worker, start-up included, over a study long
enough that start-up does not make the figure. One and two workers take turns. On a machine that others use, too, the
ratio of times says little; then twice the ratio of processor times is what idle cores would allow at most.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from conftest import AISLAB

from calib.study.description import StudyDescription
from calib.study.library import find_study, parse_study
from calib.study.published import Published, read_published
from calib.study.run import run_study
from calib.study.scene import cases
from calib.study.workers import Workers

CELLS = ("ours-1", "ours-2", "ours-3", "search")
MANY = """
format: acoustic-study
version: 1
name: many
repetitions: {n}
arrays: {{four: {{kind: ring, n_mics: 4, radius_m: 0.2, rise_m: 0.2}}}}
boards: {{two: {{kind: places, buzzers_m: [[0, 0, 0], [0.2, 0, 0]]}}}}
pose_sets: {{six: {{kind: drawn, n_poses: 6}}}}
noises: {{quiet: {{law: gaussian, scale_s: 1.0e-6}}}}
runs:
  - {{arrays: [four], boards: [two], pose_sets: [six], noises: [quiet], methods: [ours-2]}}
"""


def table_2(protocol: str, repetitions: int) -> StudyDescription:
    """Return Table II with the paper's four methods only."""
    study = find_study(f"table2-{protocol}")
    runs = []
    for run in study.runs:
        methods = tuple(method for method in run.methods if method in CELLS)
        noises = tuple(noise for noise in run.noises if "buzzers" not in noise)
        if methods:
            runs.append(run.model_copy(update={"methods": methods, "noises": noises}))
    return study.model_copy(update={"runs": tuple(runs), "repetitions": repetitions})


@dataclass(frozen=True)
class Cost:
    """Time on the wall, and of processors, this process and its workers together."""

    wall_s: float
    processor_s: float


def cost(study: StudyDescription, published: Published, workers: int) -> Cost:
    """Run a study from nothing to its tables."""
    with TemporaryDirectory() as folder:
        start_s, used_s = time.perf_counter(), processor_s()
        run_study(study, Path(folder) / "study", published, Workers(workers), Console(quiet=True))
        return Cost(time.perf_counter() - start_s, processor_s() - used_s)


def processor_s() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def throughput(study: StudyDescription, published: Published, turns: int) -> None:
    """Print repetitions per second of one and two workers in turns, and their ratios."""
    repetitions = sum(case.n_repetitions for case in cases(study))
    print(f"{'':18}{'1 worker':>10}{'2 workers':>11}{'ratio':>8}{'processor time allows':>23}")
    for turn in range(turns):
        one, two = (cost(study, published, workers) for workers in (1, 2))
        rates = [repetitions / each.wall_s for each in (one, two)]
        allowed = 2 * one.processor_s / two.processor_s
        print(f"{f'turn {turn + 1}, 1/s':18}{rates[0]:10.1f}{rates[1]:11.1f}{rates[1] / rates[0]:8.2f}{allowed:23.2f}")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--repetitions", type=int, default=100)
    parser.add_argument("--turns", type=int, default=2, help="of one and two workers, for throughput; 0: none")
    parser.add_argument("--many", type=int, default=20_000, help="small repetitions, for memory; 1000000 for the limit")
    chosen = parser.parse_args()
    published = read_published(AISLAB if AISLAB.is_dir() else None)
    if published.stand_in:
        print("(the published poses are not here: stand-ins)")
    print(f"Table II, 16 cells x {chosen.repetitions} repetitions, 2 workers")
    for protocol in ("as-published", "as-written"):
        print(f"{protocol:16}{cost(table_2(protocol, chosen.repetitions), published, 2).wall_s:8.1f} s")
    print(f"Throughput, 16 cells x {3 * chosen.repetitions} repetitions as published, start-up included")
    throughput(table_2("as-published", 3 * chosen.repetitions), published, chosen.turns)
    for n in (chosen.many // 10, chosen.many):
        wall_s = cost(parse_study(MANY.format(n=n), "many"), published, 2).wall_s
        own, worker = (
            resource.getrusage(who).ru_maxrss / 1024 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
        )
        print(f"{n:10} small repetitions: {wall_s:.0f} s, memory at its peak {own:.0f} MB, of a worker {worker:.0f} MB")


if __name__ == "__main__":
    main()
