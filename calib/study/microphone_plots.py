"""Figures of single microphones: box plots of their errors, and where they were found in space."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from calib.study.description import RulerArray
from calib.study.labels import NAMES
from calib.study.looks import Panel, legend_of_all, lines_of, panels_of, plain_ticks, title_of
from calib.study.run import FinishedStudy
from calib.study.scene import Scene
from calib.study.summary import CaseSummary

FloatArray = NDArray[np.float64]
MOST_DRAWN = 2000  # repetitions of a case: box plots tell no more with more of them
MOST_DECADES = 3  # of an axis: what lies higher has run away
MOST_PANELS = 12
FURTHEST_M = 3.0  # what ran away further is not drawn in space
BOXES = (
    "Error of each microphone in each repetition that converged; in brackets: how many did, where not all. Box: the "
    "middle half, its line the median; whiskers: up to 1.5 times the box's width further; circles: single values "
    "beyond. What is over 1000 times the median of all is not shown."
)


def draw_boxes(finished: FinishedStudy) -> tuple[Figure, str]:
    """Draw errors of the microphones as boxes; return the figure and its caption."""
    figure = Figure(figsize=(6.4, max(3.6, 1 + 0.3 * len(finished.summaries))))
    axes = figure.subplots()
    labels, errors = [], []
    for line in lines_of(finished, None):
        for each in line.cases:
            truth_m = finished.scenes[each.case.number].microphones_m
            found = np.linalg.norm(_places(finished, each) - truth_m, axis=2).ravel()
            errors.append(1e3 * found[np.isfinite(found)])
            used = f" ({each.n_settled}/{each.n})" if each.n_settled < each.n else ""
            labels.append(line.name + used)
    axes.boxplot(errors, orientation="horizontal", medianprops={"color": "#D55E00"}, flierprops={"markersize": 3})
    axes.set_yticks(range(1, len(labels) + 1), labels, fontsize=8)
    axes.invert_yaxis()
    axes.set(xscale="log", xlabel="error of each microphone, mm")
    _limit(axes, np.concatenate(errors))
    plain_ticks(axes.xaxis)
    axes.set_title(title_of(finished), fontsize=10)
    return figure, BOXES


def _limit(axes: Any, errors_mm: FloatArray) -> None:
    """End the axis where errors do, those left aside that are far from the median of all."""
    found = errors_mm[errors_mm > 0]
    if len(found):
        near = found[np.abs(np.log10(found / np.median(found))) <= MOST_DECADES]
        axes.set_xlim(near.min() / 1.2, near.max() * 1.2)


def draw_in_space(finished: FinishedStudy) -> tuple[Figure, str]:
    """Draw where microphones were found, a panel for each of what differs; return the figure and its caption."""
    lines = [line for line in lines_of(finished, None) if line.method != "search"]
    panels = panels_of(lines, dashes=False)
    shown = panels[:MOST_PANELS]
    n_columns = min(len(shown), 3)
    n_rows = -(-len(shown) // max(n_columns, 1))
    figure = Figure(figsize=(6.4 if n_columns < 2 else 4.2 * n_columns, 5.4 if n_columns < 2 else 4 * n_rows))
    drawn = []
    for number, panel in enumerate(shown, start=1):
        drawn.append(figure.add_subplot(n_rows, n_columns, number, projection="3d"))
        _draw_panel(drawn[-1], finished, panel)
    legend_of_all(figure, drawn)
    figure.suptitle(title_of(finished), fontsize=10, y=0.93)
    return figure, _caption(finished, n_left_out=len(panels) - len(shown))


def _draw_panel(axes: Any, finished: FinishedStudy, panel: Panel) -> None:
    cases = [line.cases[0] for line, _, _ in panel.lines]
    truths = {each.case.array: finished.scenes[each.case.number].microphones_m for each in cases}
    _scatter(axes, np.vstack(list(truths.values())), "o", "grey", _truth_name(finished), 60)
    for line, label, look in panel.lines:
        places_m = np.median(_places(finished, line.cases[0]), axis=0)
        near_m = places_m[np.abs(places_m).max(axis=1) < FURTHEST_M]
        _scatter(axes, near_m, look["marker"], look["color"], label)
    _scatter(axes, _middles(finished.scenes[cases[0].case.number]), ".", "#56B4E9", "middles of the boards", 6)
    _scatter(axes, np.zeros((1, 3)), "*", "red", "camera", 80)
    axes.set(xlabel="x, m", ylabel="z, m", zlabel="y, m")
    axes.invert_zaxis()  # y points down
    for scale in (axes.xaxis, axes.yaxis, axes.zaxis):
        scale.set_major_locator(MaxNLocator(4))
    axes.zaxis.labelpad = 10
    axes.set_aspect("equal")
    axes.view_init(elev=18, azim=-60)
    if panel.title:
        axes.set_title(panel.title, fontsize=8)


def _truth_name(finished: FinishedStudy) -> str:
    by_ruler = any(isinstance(array, RulerArray) for array in finished.folder.study.arrays.values())
    return "places by ruler" if by_ruler else "true places"


def _caption(finished: FinishedStudy, n_left_out: int) -> str:
    words = "Where each method places the microphones: medians over the repetitions that converged, and the {}.{}{}"
    searched = any(each.case.method == "search" for each in finished.summaries)
    searched_words = f" Not drawn, since it would hide the others: {NAMES['search']}." if searched else ""
    return words.format(
        _truth_name(finished), searched_words, f" {n_left_out} more panels are not drawn." if n_left_out else ""
    )


def _scatter(axes: Any, places_m: FloatArray, sign: str, colour: str, label: str, size: float = 30) -> None:
    x, y, z = places_m.T
    face = {"facecolors": "none", "edgecolors": colour} if sign in "os^vDP" else {"color": colour}
    axes.scatter(x, z, y, marker=sign, label=label, s=size, depthshade=False, **face)


def _middles(scene: Scene) -> FloatArray:
    return np.asarray(scene.rotations @ scene.buzzers_m.mean(axis=0) + scene.translations_m)


def _places(finished: FinishedStudy, summary: CaseSummary) -> FloatArray:
    """Return the places (n, n_mics, 3) that repetitions of a case found, of those that converged the first of many."""
    n_mics = len(finished.scenes[summary.case.number].microphones_m)
    parts = [part for part in finished.folder.parts if part.case.number == summary.case.number]
    chosen = [part for part in parts if part.repetitions.start < MOST_DRAWN]
    found, settled = [], []
    for table in finished.folder.tables(chosen):
        found.append([[table.column(f"{axis}_{mic + 1}_m").to_numpy() for axis in "xyz"] for mic in range(n_mics)])
        settled.append(table.column("settled").to_numpy(zero_copy_only=False))
    places_m = np.concatenate([np.array(each) for each in found], axis=2).transpose(2, 0, 1)
    return np.asarray(places_m[np.concatenate(settled).astype(bool)])
