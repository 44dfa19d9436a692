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


@dataclass(frozen=True)
class CaseSummary:
    """Figures of one case, in metres and shares; NaN where there is none.

    Parameters
    ----------
    case : Case
    scale_s : float
        Of the noise.
    n : int
        Repetitions.
    rmse_m, paper_rmse_m : float
        Roots of the mean squares over the repetitions that converged nearby: one that ran away would be all of it.
        The paper's figure leaves microphone 8 out.
    median_m, lower_m, upper_m : float
        Median and quartiles of all repetitions' root mean square errors.
    aligned_median_m : float
        Median after the best rigid motion each: the array's shape alone.
    bound_m : float
        Cramer-Rao bound.
    settled, at_optimum : float
        Shares: converged nearby; where a start at the truth leads to.
    """

    case: Case
    scale_s: float
    n: int
    rmse_m: float
    paper_rmse_m: float
    median_m: float
    lower_m: float
    upper_m: float
    aligned_median_m: float
    bound_m: float
    settled: float
    at_optimum: float


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
    lower_m, median_m, upper_m = _quartiles(rmse_m)
    return CaseSummary(
        case=case,
        scale_s=scale_s,
        n=len(rmse_m),
        rmse_m=_root_mean_square(rmse_m[settled > 0]),
        paper_rmse_m=_root_mean_square(paper_m[settled > 0]),
        median_m=median_m,
        lower_m=lower_m,
        upper_m=upper_m,
        aligned_median_m=_quartiles(aligned_m)[1],
        bound_m=_root_mean_square(bound_m),
        settled=float(settled.mean()),
        at_optimum=float(at_optimum.mean()),
    )


def _quartiles(values: FloatArray) -> tuple[float, float, float]:
    """Return quartiles; what was not found counts as infinitely far."""
    lower, median, upper = np.percentile(np.where(np.isnan(values), np.inf, values), [25, 50, 75], method="lower")
    return float(lower), float(median), float(upper)


def _root_mean_square(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")
