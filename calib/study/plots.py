"""Figures of a study: error against noise or number of poses, box plots of microphones, and the array in space."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter
from numpy.typing import NDArray

from calib.evaluation import PAPER_MICS
from calib.study.bound import rms_bound_m
from calib.study.description import MethodName
from calib.study.draws import draw_places
from calib.study.labels import NAMES, Labels, noise_kinds
from calib.study.pages import printed
from calib.study.run import FinishedStudy
from calib.study.scene import Scene
from calib.study.summary import CaseSummary

FloatArray = NDArray[np.float64]
# Colours that colour-blind readers tell apart (Okabe and Ito), and a sign each, for print without colour.
LOOKS = {
    "ours-1": ("#0072B2", "o"),
    "ours-2": ("#009E73", "s"),
    "ours-3": ("#E69F00", "^"),
    "search": ("#D55E00", "v"),
    "legg-2013": ("#CC79A7", "D"),
    "joint": ("#000000", "x"),
}
STYLE: Any = {
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "svg.hashsalt": "acoustic-camera-rig",  # the same figure is the same file
    "svg.fonttype": "none",
}
SPARE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")  # where methods come up twice
SIGNS, DASHES = "os^vDxP", ("-", "--", "-.")
MOST_DRAWN = 2000  # repetitions of a case: box plots tell no more with more of them
MOST_DECADES = 3  # of an axis: what lies higher has run away
FURTHEST_M = 3.0  # what ran away further is not drawn in space
BOXES = (
    "Error of each microphone in each repetition. Box: the middle half, its line the median; whiskers: up to 1.5 times "
    "the box's width further; circles: single values beyond. What is over 1000 times the median of all is not shown."
)
SPACE = "Where each method places the microphones: medians over the repetitions, and the true places."
NOTE_BOUND = "Dotted, in the same colour: its Cramer-Rao bound, for Gaussian noise of the same variance."

Line = tuple[str, MethodName, list[CaseSummary]]
Look = dict[str, Any]


def draw_study(finished: FinishedStudy, item: str | None = None) -> list[tuple[Path, str]]:
    """Draw what the study's cases call for, into its folder; return the files and their captions."""
    folder, summaries = finished.folder, finished.summaries
    with mpl.rc_context(STYLE):
        if len({summary.case.n_poses for summary in summaries}) > 1:
            figure, caption = _against_poses(finished)
            return [(_save(figure, folder.path / "poses.svg"), caption)]
        if any(len(cases) > 1 for _, _, cases in _over_noise(finished)):
            figure, caption = _against_noise(finished, item)
            return [(_save(figure, folder.path / "noise.svg"), caption)]
        figures = [(_boxes(finished), "microphones.svg", BOXES), (_in_space(finished), "space.svg", SPACE)]
        return [(_save(figure, folder.path / name), caption) for figure, name, caption in figures]


def _save(figure: Figure, path: Path) -> Path:
    figure.savefig(path, metadata={"Date": None}, bbox_inches="tight")
    return path


def _title(finished: FinishedStudy) -> str:
    told = [words for words, holds in (("--quick", finished.quick), ("stand-in poses", finished.stand_in)) if holds]
    title = finished.folder.study.title or finished.folder.study.name
    return f"{title} ({', '.join(told)})" if told else title


def _lines(finished: FinishedStudy, along: str | None) -> list[Line]:
    """Return label, method and cases of each line: what shares all but the field of the case that it runs along."""
    kinds = noise_kinds(finished.folder.study.noises)
    labels = Labels.of(each.case for each in finished.summaries)
    groups: dict[tuple[MethodName, str], list[CaseSummary]] = {}
    for each in finished.summaries:
        also = {"noise": kinds[each.case.noise], None: each.case.noise if "noise" in labels.differing else ""}
        groups.setdefault((each.case.method, labels.row(each.case, also.get(along, ""))), []).append(each)
    found = [(name, method, cases) for (method, name), cases in groups.items()]
    return sorted(found, key=lambda line: list(NAMES).index(line[1]))


def _over_noise(finished: FinishedStudy) -> list[Line]:
    """Return lines along the scale of the noise, cases in its order."""
    by_scale = [
        (name, method, sorted((each for each in cases if each.scale_s > 0), key=lambda each: each.scale_s))
        for name, method, cases in _lines(finished, "noise")
    ]
    return [(name, method, cases) for name, method, cases in by_scale if cases]


def _looks(lines: list[Line]) -> list[Look]:
    """Return how each line is drawn: as its method always is, or told apart where a method has several."""
    if len({method for _, method, _ in lines}) == len(lines):
        return [{"color": LOOKS[method][0], "marker": LOOKS[method][1], "ls": "-"} for _, method, _ in lines]
    return [
        {
            "color": SPARE[number % len(SPARE)],
            "marker": SIGNS[number % len(SIGNS)],
            "ls": DASHES[number // len(SPARE) % len(DASHES)],
        }
        for number in range(len(lines))
    ]


def _against_noise(finished: FinishedStudy, item: str | None) -> tuple[Figure, str]:
    figure, axes = _canvas()
    as_printed = bool(item and printed(item)) and finished.folder.study.name.endswith("as-published")
    shown = "paper_rmse_m" if as_printed else "rmse_m"
    lines = [line for line in _over_noise(finished) if len(line[2]) > 1]
    for (label, method, cases), look in zip(lines, _looks(lines), strict=True):
        scale_us = [1e6 * each.scale_s for each in cases]
        axes.plot(scale_us, [1e3 * getattr(each, shown) for each in cases], label=label, lw=1.2, ms=5, **look)
        bound_m = [_paper_bound_m(finished, each) if as_printed else each.bound_m for each in cases]
        _draw_bound(axes, scale_us, bound_m, look)
        values = printed(item).get(method, {}) if item and as_printed else {}
        known = [(1e6 * each.scale_s, values[each.case.noise]) for each in cases if each.case.noise in values]
        if known:
            axes.plot(*zip(*known, strict=True), "o", mfc="none", mec=look["color"], ms=11, lw=0)
    axes.set(xscale="log", xlabel="scale of the noise, µs")
    _finish_axes(axes, _title(finished), "the paper's error figure, mm" if as_printed else "RMS error, mm")
    _plain_ticks(axes.xaxis)
    counted = "of microphones 1 to 7 summed and divided by 8, as the paper does" if as_printed else "of all microphones"
    caption = f"Root mean square error over the repetitions that converged, {counted}. {NOTE_BOUND}"
    caption += " It counts microphones alike. Large circles: printed in the paper." if as_printed else ""
    dropped = len(_over_noise(finished)) - len(lines)
    return figure, caption + (" Noise that comes in one level only is in the tables." if dropped else "")


def _paper_bound_m(finished: FinishedStudy, summary: CaseSummary) -> float:
    """Return the bound of the paper's figure, as `bound_m` is that of all microphones; all poses are taken."""
    scene = finished.scenes[summary.case.number]
    return float(rms_bound_m(scene, draw_places(scene, range(1)), PAPER_MICS - 1)[0])


def _against_poses(finished: FinishedStudy) -> tuple[Figure, str]:
    """Draw root mean squares, as the bound is one; medians where there is none, as of measurements."""
    figure, axes = _canvas()
    lines = _lines(finished, "n_poses")
    bounded = any(np.isfinite(each.bound_m) for each in finished.summaries)
    shown = "rmse_m" if bounded else "median_m"
    for (label, _, group), look in zip(lines, _looks(lines), strict=True):
        cases = sorted(group, key=lambda each: _n_poses(finished, each))
        n_poses = [_n_poses(finished, each) for each in cases]
        axes.plot(n_poses, [1e3 * getattr(each, shown) for each in cases], label=label, lw=1.2, ms=4, **look)
        _draw_bound(axes, n_poses, [each.bound_m for each in cases], look)
        if not bounded:
            lower, upper = ([1e3 * min(getattr(each, name), 1e4) for each in cases] for name in ("lower_m", "upper_m"))
            axes.fill_between(n_poses, lower, upper, color=look["color"], alpha=0.15, lw=0)
    axes.set_xlabel("number of poses")
    _finish_axes(axes, _title(finished), "RMS error, mm" if bounded else "median error, mm")
    if bounded:
        return figure, f"Root mean square error of all microphones, over the repetitions that converged. {NOTE_BOUND}"
    return figure, (
        "Median of all repetitions' root mean square errors of all microphones; shaded: the middle half of them. "
        "There is no bound, as the noise of measurements is not known."
    )


def _n_poses(finished: FinishedStudy, summary: CaseSummary) -> int:
    return summary.case.n_poses or len(finished.scenes[summary.case.number].rotations)


def _canvas() -> tuple[Figure, Any]:
    figure = Figure(figsize=(6.4, 4.2))
    return figure, figure.subplots()


def _draw_bound(axes: Any, x: Sequence[float], bound_m: list[float], look: Look) -> None:
    if np.isfinite(bound_m).any():
        axes.plot(x, 1e3 * np.array(bound_m), ls=":", color=look["color"], lw=1.2)


def _finish_axes(axes: Any, title: str, error: str) -> None:
    """Scale the axis of errors by what is drawn, but for what ran away, and name everything."""
    drawn = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in axes.get_lines()] or [np.ones(1)])
    drawn = drawn[np.isfinite(drawn) & (drawn > 0)]
    if len(drawn):
        axes.set_ylim(drawn.min() / 1.3, 1.3 * min(drawn.max(), drawn.min() * 10**MOST_DECADES))
    if any(line.get_linestyle() == ":" for line in axes.get_lines()):
        axes.plot([], [], ":", color="grey", lw=1.2, label="Cramer-Rao bound of each")
    if any(line.get_markersize() > 10 for line in axes.get_lines()):
        axes.plot([], [], "o", mfc="none", mec="grey", ms=11, lw=0, label="printed in the paper")
    axes.set(yscale="log", ylabel=error)
    _plain_ticks(axes.yaxis)
    axes.set_title(title, fontsize=10)
    axes.legend(fontsize=7.5, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _boxes(finished: FinishedStudy) -> Figure:
    figure = Figure(figsize=(6.4, max(3.6, 1 + 0.3 * len(finished.summaries))))
    axes = figure.subplots()
    labels, errors = [], []
    for label, _, cases in _lines(finished, None):
        for each in cases:
            places_m = _places(finished, each)
            truth_m = finished.scenes[each.case.number].microphones_m
            found = np.linalg.norm(places_m - truth_m, axis=2).ravel()
            errors.append(1e3 * found[np.isfinite(found)])
            labels.append(label)
    axes.boxplot(errors, orientation="horizontal", medianprops={"color": "#D55E00"}, flierprops={"markersize": 3})
    axes.set_yticks(range(1, len(labels) + 1), labels, fontsize=8)
    axes.invert_yaxis()
    axes.set(xscale="log", xlabel="error of each microphone, mm")
    _limit(axes, np.concatenate(errors))
    _plain_ticks(axes.xaxis)
    axes.set_title(_title(finished), fontsize=10)
    return figure


def _limit(axes: Any, errors_mm: FloatArray) -> None:
    """End the axis where errors do, those left aside that are far from the median of all."""
    found = errors_mm[errors_mm > 0]
    if len(found):
        near = found[np.abs(np.log10(found / np.median(found))) <= MOST_DECADES]
        axes.set_xlim(near.min() / 1.2, near.max() * 1.2)


def _in_space(finished: FinishedStudy) -> Figure:
    figure = Figure(figsize=(6.4, 5.4))
    axes: Any = figure.add_subplot(projection="3d")
    scene = finished.scenes[finished.summaries[0].case.number]
    truths = {each.case.array: finished.scenes[each.case.number].microphones_m for each in finished.summaries}
    _scatter(axes, np.vstack(list(truths.values())), "o", "grey", "true places", 60)
    lines = [line for line in _lines(finished, None) if line[1] != "search"]
    for (label, _, cases), look in zip(lines, _looks(lines), strict=True):
        places_m = np.median(_places(finished, cases[0]), axis=0)
        near_m = places_m[np.abs(places_m).max(axis=1) < FURTHEST_M]
        _scatter(axes, near_m, look["marker"], look["color"], label)
    _scatter(axes, _middles(scene), ".", "#56B4E9", "middles of the boards", 6)
    _scatter(axes, np.zeros((1, 3)), "*", "red", "camera", 80)
    axes.set(xlabel="x, m", ylabel="z, m", zlabel="y, m")
    axes.invert_zaxis()  # y points down
    for scale in (axes.xaxis, axes.yaxis, axes.zaxis):
        scale.set_major_locator(MaxNLocator(4))
    axes.zaxis.labelpad = 8
    axes.set_aspect("equal")
    axes.view_init(elev=18, azim=-60)
    axes.legend(fontsize=7.5, loc="upper left", bbox_to_anchor=(1.0, 0.9))
    axes.set_title(_title(finished), fontsize=10)
    return figure


def _plain_ticks(*scales: Any) -> None:
    """Label logarithmic scales at 1, 2 and 5, in plain numbers."""
    for scale in scales:
        scale.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        scale.set_major_formatter(StrMethodFormatter("{x:g}"))
        scale.set_minor_formatter(NullFormatter())


def _scatter(axes: Any, places_m: FloatArray, sign: str, colour: str, label: str, size: float = 30) -> None:
    x, y, z = places_m.T
    face = {"facecolors": "none", "edgecolors": colour} if sign in "os^vD" else {"color": colour}
    axes.scatter(x, z, y, marker=sign, label=label, s=size, depthshade=False, **face)


def _middles(scene: Scene) -> FloatArray:
    return np.asarray(scene.rotations @ scene.buzzers_m.mean(axis=0) + scene.translations_m)


def _places(finished: FinishedStudy, summary: CaseSummary) -> FloatArray:
    """Return the places (n, n_mics, 3) that repetitions of a case found: the first of many."""
    n_mics = len(finished.scenes[summary.case.number].microphones_m)
    parts = [part for part in finished.folder.parts if part.case.number == summary.case.number]
    chosen = [part for part in parts if part.repetitions.start < MOST_DRAWN]
    found = [
        np.array([[table.column(f"{axis}_{mic + 1}_m").to_numpy() for axis in "xyz"] for mic in range(n_mics)])
        for table in finished.folder.tables(chosen)
    ]
    return np.concatenate(found, axis=2).transpose(2, 0, 1)
