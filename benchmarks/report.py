"""How long a report takes and how large it is, for sessions of several lengths.

Run with `python benchmarks/report.py`.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from conftest import write_measured_session

from calib.pipeline import calibrate
from calib.report.page import report
from calib.settings import Settings
from rigs.library import find_description
from rigs.session.reader import Session


def main() -> None:
    """Print a line for each length."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, nargs="+", default=[12, 69, 300], help="lengths of sessions")
    lengths = parser.parse_args().poses
    print("| poses | time (limit: 5 s for 69) | processor time | size (limit: 5 MB) |\n| --- | --- | --- | --- |")
    for n_poses in lengths:
        print(f"| {n_poses} | {measured(n_poses)} |")


def measured(n_poses: int) -> str:
    """Return the cells of one line."""
    with tempfile.TemporaryDirectory() as folder:
        path = write_measured_session(Path(folder) / "s.h5", find_description("simulated").description, n_poses=n_poses)
        with Session.open(path) as session:
            result = calibrate(session, Settings())
            began_s, began_busy_s = time.perf_counter(), time.process_time()
            page = report([session], result, Settings(), "s.calib.yaml")
            took_s, busy_s = time.perf_counter() - began_s, time.process_time() - began_busy_s
    return f"{took_s:.1f} s | {busy_s:.1f} s | {len(page) / 1e6:.2f} MB"


if __name__ == "__main__":
    main()
