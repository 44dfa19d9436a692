"""Verification: how near sounds come to their buzzers, which microphone moved, and the published measurements.

Run by `make bench`; `--seeds 100` for the full table. Everything here is at the level of corners and arrivals.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Literal

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from conftest import AISLAB
from verified_rig import calibrated_rig, checked, met_again, one_moved

from calib.corners import find_pose_corners
from calib.emissions import measure_tdoas
from calib.measurements import Measurements
from calib.result import SOFTWARE, Recording
from calib.result_file import StoredCalibration
from calib.settings import Method, Settings
from calib.verification.comparison import Comparison
from calib.verification.heldout import calibrate_without
from calib.verification.location import Located, Speed
from calib.verification.movement import WHOLE_ARRAY
from calib.verification.pipeline import calibrated_view, locate_emissions
from rigs.description import Intrinsics
from rigs.session.aislab import import_aislab
from rigs.session.reader import Session

SPLITS = 5
LAYOUTS: dict[Method, Literal["A", "B"]] = {
    "ours-1": "B",
    "ours-2": "A",
    "joint": "A",
}  # of buzzers, the authors'
LIMIT_PX, LIMIT_M_PER_M, NAMED = 1.5, 0.003, 95


def simulated(seeds: int, n_poses: int) -> None:
    print(f"Simulated rig, 25 poses to calibrate, {n_poses} other poses to verify, {seeds} seeds")
    errors_px, per_m, expected_px, named, quiet, whole = [], [], [], 0, 0, 0
    resolution_mm = []
    for seed in range(seeds):
        rig, calibration = calibrated_rig(seed)
        still = checked(calibration, met_again(rig, seed, n_poses=n_poses))
        errors_px.append(still.comparison.error_px)
        per_m.append(still.comparison.error_m / still.comparison.distance_m)
        expected_px.append(still.comparison.expected_px)
        resolution_mm.append(1e3 * still.movement.resolution_m)
        quiet += still.moved == []
        channel, shifts_m = one_moved(seed)
        named += checked(calibration, met_again(rig, seed, n_poses=n_poses, shifts_m=shifts_m)).moved == [channel]
        shifts_m = shifts_m.sum(axis=0)
        whole += checked(calibration, met_again(rig, seed, n_poses=n_poses, shifts_m=shifts_m)).moved == [WHOLE_ARRAY]
    errors, expected = np.concatenate(errors_px), np.concatenate(expected_px)
    print(f"  in the picture, px       median {np.median(errors):.2f} (limit {LIMIT_PX}), rms {rms(errors):.2f}, "
          f"expected {rms(expected):.2f}")  # fmt: skip
    print(f"  in space, mm per metre   median {1e3 * np.median(np.concatenate(per_m)):.2f} "
          f"(limit {1e3 * LIMIT_M_PER_M:g})")  # fmt: skip
    print(f"  a microphone shows from  {np.median(resolution_mm):.2f} mm (median)")
    print(f"  one moved by 3 mm named, and no other   {named} of {seeds} (limit {NAMED} %)")
    print(f"  no alarm where nothing moved            {quiet} of {seeds} (limit {NAMED} %)")
    print(f"  whole array moved by 3 mm named         {whole} of {seeds}\n")


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def published() -> None:
    if not AISLAB.is_dir():
        print("(the published measurements are not here: no table)")
        return
    print(
        f"Published measurements (AISLAB): two thirds of the poses calibrate, the others are verified, {SPLITS} splits"
    )
    print("bearing of the located buzzers against where the camera saw them, all located by the same 28 TDOAs")
    print(f"{'':12}{'median deg':>12}{'95 % deg':>10}{'median px':>11}{'located':>9}   median of each split, deg")
    medians = {}
    for name, layout in LAYOUTS.items():
        splits = [split_errors(layout, Settings(method=name), number) for number in range(SPLITS)]
        errors_deg, errors_px = (np.concatenate([getattr(one, kind) for one, _ in splits])
                                 for kind in ("error_deg", "error_px"))  # fmt: skip
        share = np.mean(np.concatenate([located.found for _, located in splits]))
        medians[name] = float(np.nanmedian(errors_deg))
        each = " ".join(f"{np.nanmedian(one.error_deg):.3f}" for one, _ in splits)
        print(f"{name:12}{medians[name]:12.3f}{np.nanpercentile(errors_deg, 95):10.3f}{np.nanmedian(errors_px):11.2f}"
              f"{share:9.1%}   {each}")  # fmt: skip
    print(
        f"joint against ours-2: {100 * (1 - medians['joint'] / medians['ours-2']):.0f} % less in the median (limit 20)"
    )


def split_errors(layout: Literal["A", "B"], settings: Settings, number: int) -> tuple[Comparison, Located]:
    """Calibrate without the poses that a split leaves out, and locate their emissions."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "aislab.h5"
        import_aislab(AISLAB, path, problem=28, layout=layout)
        with Session.open(path) as session:
            description, corners, tdoas = session.description, find_pose_corners(session), measure_tdoas(session)
    channels = description.audio.channels
    order = np.random.default_rng(number).permutation(corners.pose)
    left_out = np.sort(order[: len(order) // 3])
    blank = StoredCalibration("blank", {"": "aislab"}, settings, SOFTWARE, channels, np.zeros((8, 3)),
                              np.eye(24), 340.0, 1.0, Intrinsics(focal_px=(1, 1), principal_px=(0, 0)),
                              Recording.by(description))  # fmt: skip
    calibration = calibrate_without(Measurements(description, corners, tdoas, settings), left_out, blank)
    corners = corners.only(np.isin(corners.pose, left_out))
    view = calibrated_view(calibration, description, corners)
    known = Speed(calibration.speed_of_sound_m_s, calibration.speed_of_sound_std_m_s)
    located, comparison = locate_emissions(calibration, description, view, corners, tdoas, known)
    return comparison, located


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=20)
    chosen = parser.parse_args()
    published()
    print()
    for n_poses in (4, 8):
        simulated(chosen.seeds, n_poses)


if __name__ == "__main__":
    main()
