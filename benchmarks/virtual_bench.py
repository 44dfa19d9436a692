"""The benchmark of a whole session at the virtual bench: real stacks without hardware, compared with the truth.

It takes real time: about seven seconds a pose.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from virtual_bench.session import (
    Outcome,
    bench_offsets_s,
    captured_and_calibrated,
    corner_errors_px,
    onset_offsets_s,
    spread_p95_s,
)

from rigs.session.layout import FLAG_OVERFLOW
from rigs.session.reader import Session

POSES = 20


def main() -> int:
    """Capture and calibrate one session, print the table, and return 1 where a limit is broken."""
    parser = argparse.ArgumentParser(description="Capture and calibrate a session at the virtual bench.")
    parser.add_argument("--quick", action="store_true", help="8 poses: too few for the limits to mean much")
    parser.add_argument("--seed", type=int, default=0, help="of the bench")
    options = parser.parse_args()
    with TemporaryDirectory() as folder:
        begin_s = time.monotonic()
        outcome = captured_and_calibrated(Path(folder), 8 if options.quick else POSES, options.seed)
        rows = figures(outcome, time.monotonic() - begin_s)
    table = Table("figure", "limit", "measured", title="A session at the virtual bench")
    for name, limit, measured, is_good in rows:
        table.add_row(name, limit, measured, style=None if is_good else "red")
    Console().print(table)
    return int(not all(is_good for *_, is_good in rows))


def figures(outcome: Outcome, duration_s: float) -> list[tuple[str, str, str, bool]]:
    """Return the rows of the table: what, limit, measured, whether it is within."""
    with Session.open(outcome.session_path) as session:
        offsets_s, p95_s = onset_offsets_s(session), spread_p95_s(onset_offsets_s(session))
        own_p95_s = spread_p95_s(bench_offsets_s(session, outcome.truth))
        corners_px = corner_errors_px(session, outcome.truth)
        n_shots, n_good = len(session.emissions), int(session.emissions["accepted"].sum())
        n_overflows = int(np.count_nonzero(session.audio_blocks["flags"] & FLAG_OVERFLOW))
        n_poses = int(session.poses["accepted"].sum())
    evaluation, late = outcome.evaluation, [e for e in outcome.truth.emissions if e.late_s or e.lost_samples]
    return [
        (
            "microphones, RMSE in the camera frame",
            "1 mm",
            f"{1e3 * evaluation.rmse_m:.2f} mm",
            evaluation.rmse_m <= 1e-3,
        ),
        ("microphones, RMSE after alignment", "", f"{1e3 * evaluation.rmse_aligned_m:.2f} mm", True),
        (
            "onset by the board's ON event, 95th percentile about the median",
            "5 ms",
            f"{1e3 * p95_s:.1f} ms",
            p95_s < 5e-3,
        ),
        ("of which the bench's own, and the way of the sound", "", f"{1e3 * own_p95_s:.1f} ms", True),
        ("onset after the ON event, median", "", f"{1e3 * np.median(offsets_s):.0f} ms", True),
        ("corners, RMSE (median over the poses)", "", f"{np.median(corners_px):.3f} px", True),
        ("overflows of the sound device", "0", f"{n_overflows}", n_overflows == 0),
        ("emissions accepted, of those fired", "", f"{n_good} of {n_shots} in {n_poses} poses", True),
        ("emissions that the busy bench itself played late", "", f"{len(late)}", True),
        ("the whole session, calibration included", "", f"{duration_s:.0f} s", True),
    ]


if __name__ == "__main__":
    sys.exit(main())
