"""What the rows of each case come to: the summary table."""

from __future__ import annotations

import csv
import io
from dataclasses import asdict, dataclass, fields
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from calib.study.folder import StudyFolder
from calib.study.part import Part
from calib.study.scene import Case

FloatArray = NDArray[np.float64]
COLUMNS = ("rmse_m", "paper_rmse_m", "rmse_aligned_m", "bound_m", "at_optimum", "settled")
LEAST_FOR_ERROR = 5  # repetitions: fewer do not tell how much they vary


@dataclass(frozen=True)
class CaseSummary:
    """Figures of one case, in metres and shares; NaN where there is none.

    Parameters
    ----------
    case : Case
    scale_s : float
        Of the noise.
    n, n_settled : int
        Repetitions: all, and those that converged nearby.
    rmse_m, paper_rmse_m : float
        Roots of the mean squares over the repetitions that converged nearby: one that ran away would be all of it.
        The paper's figure leaves microphone 8 out.
    rmse_std_error_m : float
        Standard error of `rmse_m`, from the spread of the repetitions; not of measured noise, always the same.
    median_m, lower_m, upper_m : float
        Median and quartiles of all repetitions' root mean square errors; what did not converge counts as infinite.
    aligned_median_m : float
        Median after the best rigid motion each: the array's shape alone.
    bound_m : float
        Cramer-Rao bound.
    convergence_rate, optimum_rate : float
        Shares: converged nearby; where a start at the truth leads to.
    """

    case: Case
    scale_s: float
    n: int
    n_settled: int
    rmse_m: float
    rmse_std_error_m: float
    paper_rmse_m: float
    median_m: float
    lower_m: float
    upper_m: float
    aligned_median_m: float
    bound_m: float
    convergence_rate: float
    optimum_rate: float


def summarise(folder: StudyFolder) -> list[CaseSummary]:
    """Return a summary of each case, in order; the errors of one case are held at a time."""
    return [
        _summary(case, getattr(folder.study.noises[case.noise], "scale_s", float("nan")), _values(folder, list(parts)))
        for case, parts in groupby(folder.parts, lambda part: part.case)
    ]


def _values(folder: StudyFolder, parts: list[Part]) -> FloatArray:
    """Return the errors of some parts' repetitions, (figures, n)."""
    ends = np.cumsum([0, *(len(part.repetitions) for part in parts)])
    values = np.empty((len(COLUMNS), ends[-1]))
    for table, first, end in zip(folder.tables(parts, COLUMNS), ends, ends[1:], strict=False):
        for row, name in enumerate(COLUMNS):
            values[row, first:end] = table.column(name).to_numpy(zero_copy_only=False)
    return values


def summary_csv(summaries: list[CaseSummary]) -> str:
    """Return the summary as CSV."""
    text = io.StringIO()
    figures = [field.name for field in fields(CaseSummary) if field.name != "case"]
    names = ["array", "board", "pose_set", "n_poses", "noise", "method"]
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["case", *names, *figures])
    for summary in summaries:
        case, values = asdict(summary.case), asdict(summary)
        writer.writerow([case["number"], *(case[name] for name in names), *(values[name] for name in figures)])
    return text.getvalue()


def _summary(case: Case, scale_s: float, values: FloatArray) -> CaseSummary:
    rmse_m, paper_m, aligned_m, bound_m, at_optimum, settled = values
    near = settled > 0
    lower_m, median_m, upper_m = _quartiles(rmse_m, near)
    return CaseSummary(
        case=case,
        scale_s=scale_s,
        n=len(rmse_m),
        n_settled=int(near.sum()),
        rmse_m=_root_mean_square(rmse_m[near]),
        rmse_std_error_m=_standard_error(rmse_m[near]) if np.isfinite(scale_s) else float("nan"),
        paper_rmse_m=_root_mean_square(paper_m[near]),
        median_m=median_m,
        lower_m=lower_m,
        upper_m=upper_m,
        aligned_median_m=_quartiles(aligned_m, near)[1],
        bound_m=_root_mean_square(bound_m),
        convergence_rate=float(near.mean()),
        optimum_rate=float(at_optimum.mean()),
    )


def _quartiles(values: FloatArray, near: NDArray[np.bool_]) -> tuple[float, float, float]:
    """Return lower quartile, median and upper quartile; what did not converge nearby counts as infinitely far."""
    ordered = np.sort(np.where(near & np.isfinite(values), values, np.inf))
    lower, median, upper = (_between(ordered, share) for share in (0.25, 0.5, 0.75))
    return lower, median, upper


def _between(ordered: FloatArray, share: float) -> float:
    """Return a quantile, linear between two values as usual, and infinite next to an infinite one."""
    place = share * (len(ordered) - 1)
    below, part = int(place), place % 1
    if part == 0 or np.isinf(ordered[below + 1]):
        return float(ordered[below if part == 0 else below + 1])
    return float(ordered[below] + part * (ordered[below + 1] - ordered[below]))


def _root_mean_square(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def _standard_error(values: FloatArray) -> float:
    """Return the standard error of a root mean square: that of the mean square, over twice the root (delta method)."""
    root = _root_mean_square(values)
    if len(values) < LEAST_FOR_ERROR or not root > 0:
        return float("nan")
    return float(np.std(values**2, ddof=1) / np.sqrt(len(values)) / (2 * root))
