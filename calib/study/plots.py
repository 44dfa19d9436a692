"""Figures of a study: error against noise or number of poses, or else of single microphones."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from calib.evaluation import PAPER_MICS
from calib.study.bound import rms_bound_m
from calib.study.draws import draw_places
from calib.study.looks import STYLE, Line, Look, Panel, legend_of_all, lines_of, panels_of, plain_ticks, title_of
from calib.study.microphone_plots import draw_boxes, draw_in_space
from calib.study.pages import printed
from calib.study.run import FinishedStudy
from calib.study.summary import CaseSummary

FloatArray = NDArray[np.float64]
MOST_DECADES = 3  # of an axis: what lies higher has run away
MOST_TICKS = 12  # numbers of poses that are all named below an axis
ENOUGH = 0.95  # share of repetitions that converged: with fewer, what is drawn is of the easier ones
FEW = 8  # repetitions: the middle half of fewer is not shown
NOTE_BOUND = (
    "Dotted, in the same colour: its Cramer-Rao bound, for Gaussian noise of the same variance, without outliers."
)
NOTE_OPEN = " Open signs: under 95 % of the repetitions converged, and what is drawn is of these alone."
NOTE_BARS = " Bars: one standard error."


def draw_study(finished: FinishedStudy, item: str | None = None) -> list[tuple[Path, str]]:
    """Draw what the study's cases call for, into its folder; return the files and their captions."""
    with mpl.rc_context(STYLE):
        if len({summary.case.n_poses for summary in finished.summaries}) > 1:
            figures = {"poses.svg": _against_poses(finished)}
        elif any(len(line.cases) > 1 for line in _over_noise(finished)):
            figures = {"noise.svg": _against_noise(finished, item)}
        else:
            figures = {"microphones.svg": draw_boxes(finished), "space.svg": draw_in_space(finished)}
        return [(_save(figure, finished.folder.path / name), caption) for name, (figure, caption) in figures.items()]


def _save(figure: Figure, path: Path) -> Path:
    figure.savefig(path, metadata={"Date": None}, bbox_inches="tight")
    return path


def _over_noise(finished: FinishedStudy) -> list[Line]:
    """Return lines along the scale of the noise, cases in its order."""
    by_scale = [
        Line(line.method, line.rest, sorted((each for each in line.cases if each.scale_s > 0), key=lambda e: e.scale_s))
        for line in lines_of(finished, "noise")
    ]
    return [line for line in by_scale if line.cases]


def _against_noise(finished: FinishedStudy, item: str | None) -> tuple[Figure, str]:
    as_printed = bool(item and printed(item)) and finished.folder.study.name.endswith("as-published")
    shown = "paper_rmse_m" if as_printed else "rmse_m"
    every = _over_noise(finished)
    lines = [line for line in every if len(line.cases) > 1]
    panels = panels_of(lines)
    figure, axes = _canvas(panels)
    for each_axes, panel in zip(axes, panels, strict=True):
        for line, label, look in panel.lines:
            scale_us = [1e6 * each.scale_s for each in line.cases]
            _draw_errors(each_axes, scale_us, line.cases, shown, label, look)
            bound_m = [_paper_bound_m(finished, each) if as_printed else each.bound_m for each in line.cases]
            _draw_bound(each_axes, scale_us, bound_m, look)
            if as_printed and item:
                _draw_printed(each_axes, line, printed(item).get(line.method, {}), look)
        each_axes.set(xscale="log", xlabel="scale of the noise, µs")
        plain_ticks(each_axes.xaxis)
    _finish(figure, axes, title_of(finished), "the paper's error figure, mm" if as_printed else "RMS error, mm")
    counted = "of microphones 1 to 7 summed and divided by 8, as the paper does" if as_printed else "of all microphones"
    caption = f"Root mean square error over the repetitions that converged, {counted}. {NOTE_BOUND}"
    caption += " It counts microphones alike. Large circles: printed in the paper." if as_printed else NOTE_BARS
    dropped = " Noise that comes in one level only is in the tables." if len(every) > len(lines) else ""
    return figure, caption + _note_open(lines) + dropped


def _draw_printed(axes: Any, line: Line, values: dict[str, float], look: Look) -> None:
    known = [(1e6 * each.scale_s, values[each.case.noise]) for each in line.cases if each.case.noise in values]
    if known:
        axes.plot(*zip(*known, strict=True), "o", mfc="none", mec=look["color"], ms=11, lw=0)


def _paper_bound_m(finished: FinishedStudy, summary: CaseSummary) -> float:
    """Return the bound of the paper's figure, as `bound_m` is that of all microphones; all poses are taken."""
    scene = finished.scenes[summary.case.number]
    return float(rms_bound_m(scene, draw_places(scene, range(1)), PAPER_MICS - 1)[0])


def _against_poses(finished: FinishedStudy) -> tuple[Figure, str]:
    """Draw root mean squares, as the bound is one; medians where there is none, as of measurements."""
    lines = lines_of(finished, "n_poses")
    panels = panels_of(lines)
    figure, axes = _canvas(panels)
    bounded = any(np.isfinite(each.bound_m) for each in finished.summaries)
    for each_axes, panel in zip(axes, panels, strict=True):
        for line, label, look in panel.lines:
            cases = sorted(line.cases, key=lambda each: _n_poses(finished, each))
            n_poses = [_n_poses(finished, each) for each in cases]
            _draw_errors(each_axes, n_poses, cases, "rmse_m" if bounded else "median_m", label, look)
            _draw_bound(each_axes, n_poses, [each.bound_m for each in cases], look)
            if not bounded:
                _draw_quartiles(each_axes, n_poses, cases, look)
        numbers = sorted({_n_poses(finished, each) for each in finished.summaries})
        each_axes.set_xlabel("number of poses")
        if len(numbers) <= MOST_TICKS:
            each_axes.set_xticks(numbers)
    _finish(figure, axes, title_of(finished), "RMS error, mm" if bounded else "median error, mm")
    if bounded:
        counted = "Root mean square error of all microphones, over the repetitions that converged."
        return figure, f"{counted} {NOTE_BOUND}{NOTE_BARS}{_note_open(lines)}"
    return figure, (
        "Median of all repetitions' root mean square errors of all microphones, those that did not converge taken as "
        f"infinite; shaded: the middle half of them, where there are {FEW} or more. There is no bound, as the noise of "
        "measurements is not known."
    )


def _n_poses(finished: FinishedStudy, summary: CaseSummary) -> int:
    return summary.case.n_poses or len(finished.scenes[summary.case.number].rotations)


def _canvas(panels: list[Panel]) -> tuple[Figure, list[Any]]:
    """Return a figure with axes for each panel, all on the same scale."""
    n_columns = min(len(panels), 2)
    n_rows = -(-len(panels) // n_columns)
    figure = Figure(figsize=(6.4, 4.2) if n_columns == 1 else (9.0, 0.6 + 3.2 * n_rows))
    axes = list(figure.subplots(n_rows, n_columns, sharex=True, sharey=True, squeeze=False).ravel())
    for spare in axes[len(panels) :]:
        spare.remove()
    for each, panel in zip(axes, panels, strict=False):
        each.set_title(panel.title, fontsize=8)
        each.tick_params(labelbottom=True)
    return figure, axes[: len(panels)]


def _draw_errors(axes: Any, x: Sequence[float], cases: list[CaseSummary], shown: str, label: str, look: Look) -> None:
    """Draw a line; signs are open where too few repetitions converged, bars stand where an error is known."""
    values_mm = [1e3 * value if np.isfinite(value := getattr(each, shown)) else np.nan for each in cases]
    axes.plot(x, values_mm, label=label, lw=1.2, ms=4.5, **look)
    if shown == "median_m":
        return
    few = [(place, value) for place, value, each in zip(x, values_mm, cases, strict=True) if _is_open(each)]
    if few:
        sign = {"mfc": "white", "mec": look["color"], "marker": look["marker"], "ms": 4.5}
        axes.plot(*zip(*few, strict=True), lw=0, zorder=5, **sign)
    if shown == "rmse_m":
        bars_mm = [1e3 * each.rmse_std_error_m for each in cases]
        axes.errorbar(x, values_mm, bars_mm, fmt="none", ecolor=look["color"], elinewidth=0.9, capsize=2)


def _is_open(summary: CaseSummary) -> bool:
    return summary.convergence_rate < ENOUGH


def _note_open(lines: list[Line]) -> str:
    return NOTE_OPEN if any(_is_open(each) for line in lines for each in line.cases) else ""


def _draw_quartiles(axes: Any, x: Sequence[float], cases: list[CaseSummary], look: Look) -> None:
    if min(each.n for each in cases) >= FEW:
        lower, upper = ([1e3 * min(getattr(each, name), 1e4) for each in cases] for name in ("lower_m", "upper_m"))
        axes.fill_between(x, lower, upper, color=look["color"], alpha=0.15, lw=0)


def _draw_bound(axes: Any, x: Sequence[float], bound_m: list[float], look: Look) -> None:
    if np.isfinite(bound_m).any():
        sign = {} if look["ls"] == "-" else {"marker": look["marker"], "ms": 3, "mfc": "none"}
        axes.plot(x, 1e3 * np.array(bound_m), ls=":", color=look["color"], lw=1.2, **sign)


def _finish(figure: Figure, axes: list[Any], title: str, error: str) -> None:
    """Scale the axis of errors by what is drawn, but for what ran away, and name everything."""
    lines = [line for each in axes for line in each.get_lines()]
    drawn = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in lines] or [np.ones(1)])
    drawn = drawn[np.isfinite(drawn) & (drawn > 0)]
    axes[0].set(yscale="log")
    if len(drawn):
        axes[0].set_ylim(drawn.min() / 1.3, 1.3 * min(drawn.max(), drawn.min() * 10**MOST_DECADES))
    extra = []
    if any(line.get_linestyle() == ":" for line in lines):
        extra.append(Line2D([], [], ls=":", color="grey", lw=1.2, label="Cramer-Rao bound of each"))
    if any(line.get_markersize() > 10 for line in lines):
        extra.append(Line2D([], [], marker="o", mfc="none", mec="grey", ms=11, lw=0, label="printed in the paper"))
    if any(line.get_markerfacecolor() == "white" for line in lines):
        extra.append(Line2D([], [], marker="o", mfc="white", mec="grey", ms=4.5, lw=0, label="under 95 % converged"))
    for each in axes:
        each.set_yscale("log")
        plain_ticks(each.yaxis)
    for each in axes[:: 1 if len(axes) == 1 else 2]:
        each.set_ylabel(error)
    figure.suptitle(title, fontsize=10, y=0.95)
    if len(axes) > 1:
        figure.tight_layout(rect=(0, 0, 0.92, 0.97))
    legend_of_all(figure, axes, *extra)
