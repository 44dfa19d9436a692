"""Tables of a study as Markdown, beside what the paper prints."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

import numpy as np
import yaml

from calib.methods import MAX_REACH_M
from calib.study.labels import Labels, noise_words
from calib.study.run import FinishedStudy
from calib.study.summary import CaseSummary

FIGURES = {
    "paper_rmse_m": "The paper's error figure, mm: RMS over the repetitions that converged, squared errors of "
    "microphones 1 to 7 summed and divided by 8",
    "rmse_m": "RMS error, mm: of all microphones, over the repetitions that converged",
    "bound_m": "Cramer-Rao bound of the RMS error, mm: of all microphones, for Gaussian noise of the same variance",
    "median_m": "Median error, mm: of all repetitions' RMS errors",
    "aligned_median_m": "Median error after rigid alignment, mm: of all repetitions, the array's shape alone",
    "settled": f"Convergence rate: repetitions that converged, within {MAX_REACH_M:g} m",
    "at_optimum": "Optimum rate: repetitions that ended within 1 mm of where a start at the true places ends",
}
IN_TERMINAL = ("paper_rmse_m", "rmse_m", "bound_m", "median_m", "settled", "at_optimum")
OF_CONVERGED = ("paper_rmse_m", "rmse_m")
MOST_COLUMNS = 6  # of a table, in the terminal
NEVER_MM = 1e5  # more says only that some repetition ran away
STAND_IN = (
    "the paper's 69 board poses are stand-ins, drawn at random, since --published was not given: figures differ from "
    "the paper's"
)
QUICK = "made with --quick: so few repetitions show that it runs, and nothing about the methods"

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
    return [text for text, holds in ((QUICK, finished.quick), (STAND_IN, finished.stand_in)) if holds]


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
    """Return title, what the columns of the tables are, and what must be known of the figures."""
    study, cases = finished.folder.study, [each.case for each in finished.summaries]
    of_poses = Labels.of(cases).along == "n_poses"
    across = "number of poses, a random subset for each repetition" if of_poses else "noise"
    used = {case.noise for case in cases}
    noises = [f"*{name}*: {noise_words(noise)}" for name, noise in study.noises.items() if name in used]
    paragraphs = [
        f"## {study.title or study.name}",
        f"`{study.name}`, seed {study.seed}. Columns of the tables: n, the number of repetitions; then {across}.",
        f"Noise: {'; '.join(noises)}.",
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
    return lines


def _pivot(summaries: list[CaseSummary], figure: str) -> dict[Row, dict[str, str]]:
    """Return cells by row and column; empty where the study has no such figure."""
    labels, rows = Labels.of(each.case for each in summaries), dict[Row, dict[str, str]]()
    share = figure in ("settled", "at_optimum")
    for summary in summaries:
        value = getattr(summary, figure)
        if figure in OF_CONVERGED and summary.settled == 0:
            value = np.inf
        if np.isnan(value):
            continue
        cells = rows.setdefault((labels.row(summary.case), summary.case.method, summary.n), {})
        cells[labels.column(summary.case)] = f"{100 * value:.0f} %" if share else _millimetres(value)
    return rows


def _millimetres(value_m: float) -> str:
    value_mm = 1e3 * value_m
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
