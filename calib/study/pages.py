"""Tables of a study as Markdown, beside what the paper prints."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

import numpy as np
import yaml

from calib.methods import MAX_REACH_M
from calib.study.description import RulerArray
from calib.study.labels import NAMES, Labels
from calib.study.parameters import tried_table
from calib.study.run import FinishedStudy
from calib.study.summary import CaseSummary

FIGURES = {
    "paper_rmse_m": "The paper's error figure, mm: RMS over the repetitions that converged, squared errors of "
    "microphones 1 to 7 summed and divided by 8",
    "rmse_m": "RMS error, mm, ± its standard error: of all microphones, over the repetitions that converged",
    "bound_m": "Cramer-Rao bound of the RMS error, mm: of all microphones, for Gaussian noise of the same variance, "
    "without outliers",
    "median_m": "Median error, mm: of all repetitions' RMS errors, those that did not converge taken as infinite",
    "aligned_median_m": "Median error after rigid alignment, mm: the same of the array's shape alone",
    "convergence_rate": f"Convergence rate: repetitions that converged, within {MAX_REACH_M:g} m",
    "optimum_rate": "Optimum rate: repetitions that ended within 1 mm of where a start at the true places ends",
}
RATES = ("convergence_rate", "optimum_rate")
IN_TERMINAL = ("paper_rmse_m", "rmse_m", "bound_m", "median_m", *RATES)
OF_CONVERGED = ("paper_rmse_m", "rmse_m")
LEFT_OUT = "In brackets: how many of the repetitions converged, where not all did; the figure is of these alone."
MOST_COLUMNS = 6  # of a table, in the terminal
NEVER_MM, NOTHING_MM = 1e5, 1e-6  # more says only that some repetition ran away; less is rounding
STAND_IN = (
    "the paper's 69 board poses are stand-ins, drawn at random, since --published was not given: figures differ from "
    "the paper's"
)
QUICK = (
    "made with --quick: one repetition of each combination, of some of the numbers of poses; it shows that it runs, "
    "and nothing about the methods"
)
RULER = (
    "measured by ruler: the true places are those of the authors' ruler, in a frame that is itself turned against the "
    "camera's by 6 to 7 degrees. So errors are distances to that frame: of two methods, the nearer one need not be the "
    "better one"
)
KNOWING = (
    "Legg, 2013 method takes flight times and a microphone at a known place, which Ours-1, Ours-2 and joint do not "
    "have (times of emission are known to it; of measurements, by the distance to the known microphone); its bound is "
    "that of flight times"
)
OUTLIERS = "bounds are those of the noise without outliers, which no method reaches that does not know which they are"

Row = tuple[str, str, int]  # name, method, repetitions


def study_page(finished: FinishedStudy, item: str | None = None) -> str:
    """Return all figures of a study, with those printed for an item of the paper."""
    columns = _columns(finished, Labels.of(each.case for each in finished.summaries))
    return "\n".join([*_head(finished), *_tables(finished, item, tuple(FIGURES), columns)])


def terminal_page(finished: FinishedStudy, item: str | None = None) -> str:
    """Return the figures that tell most, of some columns where there are many."""
    columns = _columns(finished, Labels.of(each.case for each in finished.summaries))
    chosen = columns
    if len(columns) > MOST_COLUMNS:
        chosen = [columns[index] for index in np.linspace(0, len(columns) - 1, MOST_COLUMNS).round().astype(int)]
    lines = _tables(finished, item, IN_TERMINAL, chosen)
    if chosen != columns:
        lines += [f"Columns shown: {len(chosen)} of {len(columns)}; page.md has all of them.", ""]
    return "\n".join(lines)


def remarks(finished: FinishedStudy) -> list[str]:
    """Return what a reader of the figures must know first."""
    study, cases = finished.folder.study, [each.case for each in finished.summaries]
    noises = [study.noises[case.noise] for case in cases]
    told = {
        QUICK: finished.quick,
        STAND_IN: finished.stand_in,
        RULER: any(isinstance(study.arrays[case.array], RulerArray) for case in cases),
        KNOWING: any(case.method == "legg-2013" for case in cases),
        OUTLIERS: any(getattr(noise, "outliers", 0) for noise in noises),
    }
    return [text for text, holds in told.items() if holds]


def printed_beside_ours(studies: list[tuple[str, str, FinishedStudy]]) -> list[str]:
    """Return a table of what the paper prints, what came out, and the difference; nothing where it prints nothing.

    Parameters
    ----------
    studies : list of (str, str, FinishedStudy)
        Name, the paper's item, and what came out.
    """
    rows = [row for name, item, finished in studies for row in _printed_rows(name, item, finished)]
    if not rows:
        return ["The paper's text has no figures for this to stand beside.", ""]
    head = [
        "## Printed and ours, in short",
        "",
        "The paper's error figure, mm. Its figures 3 and 4 print pictures only; its Table I is not among what we have.",
        "",
    ]
    return [
        *head,
        "| study | method | noise | printed | ours | difference |",
        f"| {'--- | ' * 3}{'---: | ' * 3}",
        *rows,
        "",
    ]


def _printed_rows(name: str, item: str, finished: FinishedStudy) -> list[str]:
    rows = []
    for each in sorted(finished.summaries, key=lambda each: list(NAMES).index(each.case.method)):
        value_mm = printed(item).get(each.case.method, {}).get(each.case.noise)
        if value_mm is None:
            continue
        difference = (
            f"{round(100 * (1e3 * each.paper_rmse_m / value_mm - 1), 1) + 0.0:+.1f} %" if each.n_settled else ""
        )
        cells = (NAMES[each.case.method], each.case.noise, f"{value_mm:.4g}", _cell(each, "paper_rmse_m"), difference)
        rows.append(f"| {name} | {' | '.join(cells)} |")
    return rows


@cache
def _printed() -> dict[str, dict[str, object]]:
    text = (files("calib.study") / "printed.yaml").read_text(encoding="utf-8")
    return dict(yaml.safe_load(text))


def printed(item: str) -> dict[str, dict[str, float]]:
    """Return what the paper prints for an item such as "table2", in mm: by method and noise."""
    entry = _printed().get(item)
    if entry is None:
        return {}
    noises, methods = entry["noises"], entry["methods"]
    assert isinstance(noises, list)
    assert isinstance(methods, dict)
    return {method: dict(zip(noises, values, strict=True)) for method, values in methods.items()}


def _head(finished: FinishedStudy) -> list[str]:
    """Return title, what the columns of the tables are, what was tried, and what must be known of the figures."""
    study, cases = finished.folder.study, [each.case for each in finished.summaries]
    of_poses = Labels.of(cases).along == "n_poses"
    across = "number of poses, a random subset for each repetition" if of_poses else "noise"
    paragraphs = [
        f"## {study.title or study.name}",
        f"`{study.name}`, seed {study.seed}. Columns of the tables: n, the number of repetitions; then {across}.",
        "\n".join(tried_table(study, cases, stand_in=finished.stand_in)),
        *(f"**Note:** {remark}." for remark in remarks(finished)),
    ]
    return [line for paragraph in paragraphs for line in (paragraph, "")]


def _columns(finished: FinishedStudy, labels: Labels) -> list[str]:
    return list(dict.fromkeys(labels.column(each.case) for each in finished.summaries))


def _tables(finished: FinishedStudy, item: str | None, figures: tuple[str, ...], columns: list[str]) -> list[str]:
    lines = []
    for name in figures:
        rows = {} if name == "paper_rmse_m" and item is None else _pivot(finished.summaries, name)
        if rows and all(cell == "100 %" for cells in rows.values() for cell in cells.values()):
            lines += [f"**{FIGURES[name]}**: 100 % throughout.", ""]
        elif rows:
            shown = printed(item) if name == "paper_rmse_m" and item else {}
            lines += [f"**{FIGURES[name]}**", "", *_markdown(rows, shown, columns), ""]
            if name in OF_CONVERGED and any(each.n_settled < each.n for each in finished.summaries):
                lines += [LEFT_OUT, ""]
    return lines


def _pivot(summaries: list[CaseSummary], figure: str) -> dict[Row, dict[str, str]]:
    """Return cells by row and column; empty where the study has no such figure."""
    labels, rows = Labels.of(each.case for each in summaries), dict[Row, dict[str, str]]()
    for summary in summaries:
        cell = _cell(summary, figure)
        if cell:
            cells = rows.setdefault((labels.row(summary.case), summary.case.method, summary.n), {})
            cells[labels.column(summary.case)] = cell
    return rows


def _cell(summary: CaseSummary, figure: str) -> str:
    """Return a figure as it stands in a table; an empty word where there is none."""
    value = getattr(summary, figure)
    if figure in RATES:
        return "" if np.isnan(value) else share_words(round(value * summary.n), summary.n)
    if figure not in OF_CONVERGED:
        return "" if np.isnan(value) else _millimetres(value)
    if summary.n_settled == 0:
        return "diverged"
    if np.isnan(value):
        return ""
    error_mm = 1e3 * summary.rmse_std_error_m
    error = f" ± {error_mm:.2g}" if figure == "rmse_m" and error_mm > NOTHING_MM else ""
    used = f" ({summary.n_settled}/{summary.n})" if summary.n_settled < summary.n else ""
    return _millimetres(value) + error + used


def share_words(count: int, n: int) -> str:
    """Return a share in per cent; as a count where rounding would make it all or none."""
    rounded = f"{100 * count / n:.0f} %"
    return f"{count} of {n}" if (rounded == "100 %" and count < n) or (rounded == "0 %" and count) else rounded


def _millimetres(value_m: float) -> str:
    value_mm = 1e3 * value_m
    if value_mm < NOTHING_MM:
        return "0"
    return f"{value_mm:.4g}" if value_mm < NEVER_MM else "diverged"


def _markdown(rows: dict[Row, dict[str, str]], shown: dict[str, dict[str, float]], columns: list[str]) -> list[str]:
    lines = ["| | n | " + " | ".join(columns) + " |", "| --- | ---: " + "| ---: " * len(columns) + "|"]
    for (name, method, n), cells in rows.items():
        lines.append(f"| {name} | {n} | " + " | ".join(cells.get(column, "") for column in columns) + " |")
        if method in shown:
            values = [f"{shown[method][column]:.4g}" if column in shown[method] else "" for column in columns]
            lines.append(
                "| *the paper prints* | | " + " | ".join(f"*{value}*" if value else "" for value in values) + " |"
            )
    return lines
