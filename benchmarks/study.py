"""Table II of the paper: time of its 16 cells, and how much faster two workers are than one. Run by `make bench`.

The limits: 90 s on two idle cores, and 1.7 times the throughput of one worker. Figures of a busy machine say little.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from conftest import AISLAB

from calib.study.description import StudyDescription
from calib.study.library import find_study, parse_study
from calib.study.part import parts_of, solve_part
from calib.study.published import Published, read_published
from calib.study.run import run_study
from calib.study.scene import cases, make_scene
from calib.study.workers import Workers, compute

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


def timed_s(study: StudyDescription, published: Published, workers: int) -> float:
    with TemporaryDirectory() as folder:
        start_s = time.perf_counter()
        run_study(study, Path(folder) / "study", published, Workers(workers), Console(quiet=True))
        return time.perf_counter() - start_s


def parts_per_s(study: StudyDescription, published: Published, workers: int) -> float:
    """Return the rate from the first part to the last: start-up left aside."""
    scenes = [(case, make_scene(study, case, published)) for case in cases(study)]
    by_case = {case.number: scene for case, scene in scenes}
    arguments = [(by_case[part.case.number], part.repetitions) for part in parts_of(scenes)]
    times_s: list[float] = []
    compute(solve_part, arguments, Workers(workers), lambda *_: times_s.append(time.perf_counter()))
    return (len(times_s) - 1) / (times_s[-1] - times_s[0])


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--repetitions", type=int, default=100)
    parser.add_argument("--many", type=int, default=20_000, help="small repetitions, for memory; 1000000 for the limit")
    chosen = parser.parse_args()
    published = read_published(AISLAB if AISLAB.is_dir() else None)
    if published.stand_in:
        print("(the published poses are not here: stand-ins)")
    print(f"Table II, 16 cells x {chosen.repetitions} rounds, s")
    print(f"{'protocol':16}{'1 worker':>10}{'2 workers':>11}{'ratio':>8}{'ratio of throughput':>21}")
    for protocol in ("as-published", "as-written"):
        study = table_2(protocol, chosen.repetitions)
        one_s, two_s = timed_s(study, published, 1), timed_s(study, published, 2)
        ratio = parts_per_s(study, published, 2) / parts_per_s(study, published, 1)
        print(f"{protocol:16}{one_s:10.1f}{two_s:11.1f}{one_s / two_s:8.2f}{ratio:21.2f}")
    for n in (chosen.many // 10, chosen.many):
        seconds = timed_s(parse_study(MANY.format(n=n), "many"), published, 2)
        megabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"{n:10} small repetitions: {seconds:.0f} s, memory at its peak {megabytes:.0f} MB")


if __name__ == "__main__":
    main()
