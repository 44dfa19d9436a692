"""A part of a study: some repetitions of one case, computed at once, as columns of a table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.evaluation import PAPER_MICS
from calib.joint.threads import on_one_thread
from calib.study.bound import rms_bound_m
from calib.study.draws import draw_places
from calib.study.methods import solve_repetitions
from calib.study.scene import Case, Scene

Columns = dict[str, NDArray[np.generic]]

VALUES_AT_ONCE = 300_000  # measurements: a few megabytes, a second at most
MOST_AT_ONCE = {"search": 25, "legg-2013": 25, "joint": 5}
MOST = 2500


@dataclass(frozen=True)
class Part:
    """Repetitions of a case.

    Parameters
    ----------
    number : int
        Counted from 0 through the study.
    case : Case
    repetitions : range
    """

    number: int
    case: Case
    repetitions: range


def parts_of(scenes: list[tuple[Case, Scene]]) -> list[Part]:
    """Cut a study into parts; how does not depend on who computes them."""
    parts: list[Part] = []
    for case, scene in scenes:
        n_mics = len(scene.microphones_m)
        n_values = scene.n_emissions * (n_mics * (n_mics - 1) // 2 if case.method == "ours-2" else n_mics)
        size = min(max(VALUES_AT_ONCE // n_values, 1), MOST_AT_ONCE.get(case.method, MOST))
        for first in range(0, case.n_repetitions, size):
            repetitions = range(first, min(first + size, case.n_repetitions))
            parts.append(Part(len(parts), case, repetitions))
    return parts


@on_one_thread  # threads add up in another order, so last digits would tell who computed
def solve_part(scene: Scene, repetitions: range) -> Columns:
    """Compute repetitions of a scene: one row each."""
    with np.errstate(all="ignore"):  # what diverges is told by its columns
        places = draw_places(scene, repetitions)
        solved = solve_repetitions(scene, places, repetitions)
        bound_m = rms_bound_m(scene, places)
        errors_m2 = np.sum((solved.places_m - scene.microphones_m) ** 2, axis=2)
        columns: Columns = {
            "repetition": np.array(repetitions, dtype=np.int64),
            "settled": solved.settled,
            "at_optimum": solved.at_optimum,
            "n_iterations": solved.n_iterations.astype(np.int32),
            "rmse_m": np.sqrt(errors_m2.mean(axis=1)),
            "paper_rmse_m": _paper_rmse_m(errors_m2),
            "rmse_aligned_m": _rmse_aligned_m(solved.places_m, scene.microphones_m),
            "bound_m": np.broadcast_to(bound_m, len(repetitions)).copy(),
        }
    for mic in range(len(scene.microphones_m)):
        for axis, name in enumerate("xyz"):
            columns[f"{name}_{mic + 1}_m"] = solved.places_m[:, mic, axis].copy()
    return columns


def _paper_rmse_m(errors_m2: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the paper's figure: squared errors of microphones 1 to 7 summed, over 8; NaN for other arrays."""
    if errors_m2.shape[1] != PAPER_MICS:
        return np.full(len(errors_m2), np.nan)
    return np.asarray(np.sqrt(errors_m2[:, :7].sum(axis=1) / PAPER_MICS))


def _rmse_aligned_m(places_m: NDArray[np.float64], truth_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return root mean square errors (n,) after the best rigid motion each (Kabsch, doi:10.1107/S0567739476001873)."""
    usable = np.abs(places_m).max(axis=(1, 2)) < 1e6
    centred_m = np.where(usable[:, None, None], places_m, truth_m)
    centred_m = centred_m - centred_m.mean(axis=1, keepdims=True)
    target_m = truth_m - truth_m.mean(axis=0)
    u, _, vt = np.linalg.svd(centred_m.swapaxes(1, 2) @ target_m)
    turn = np.ones((len(u), 1, 3))
    turn[:, 0, 2] = np.sign(np.linalg.det(u @ vt))
    moved_m = centred_m @ ((u * turn) @ vt)
    rms_m = np.sqrt(np.sum((moved_m - target_m) ** 2, axis=(1, 2)) / len(truth_m))
    return np.where(usable, rms_m, np.nan)
