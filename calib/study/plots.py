"""Figures of a study: error against noise or number of poses, box plots of microphones, and the array in space."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter
from numpy.typing import NDArray

from calib.study.folder import StudyFolder
from calib.study.pages import NAMES, printed
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
    "svg.hashsalt": "acoustic-camera-rig",
}
MOST_DRAWN = 2000  # repetitions of a case: box plots tell no more with more of them
MOST_MM = 2000.0  # more is no answer
FURTHEST_M = 3.0  # what ran away further is not drawn in space


def draw_study(finished: FinishedStudy, item: str | None = None) -> list[Path]:
    """Draw what the study's cases call for, into its folder; return the files."""
    folder, summaries = finished.folder, finished.summaries
    with mpl.rc_context(STYLE):
        if len({summary.case.n_poses for summary in summaries}) > 1:
            return [_save(_against_poses(folder, summaries), folder.path / "poses.svg")]
        if len({summary.scale_s for summary in summaries if summary.scale_s > 0}) > 1:
            return [_save(_against_noise(folder, summaries, item), folder.path / "noise.svg")]
        errors = _save(_boxes(finished), folder.path / "microphones.svg")
        return [errors, _save(_in_space(finished), folder.path / "space.svg")]


def _save(figure: Figure, path: Path) -> Path:
    figure.savefig(path, metadata={"Date": None}, bbox_inches="tight")
    return path


def _series(summaries: list[CaseSummary]) -> list[tuple[str, str, list[CaseSummary]]]:
    """Return label, method and cases of each line: what shares all but noise and number of poses."""

    def key(summary: CaseSummary) -> tuple[str, str, str, str, bool]:
        case = summary.case
        return case.method, case.array, case.board, case.pose_set, "buzzers" in case.noise

    found = []
    for (method, *names, off), group in groupby(sorted(summaries, key=key), key):
        differing = [
            f"{field.replace('_', ' ')} {name}"
            for name, field in zip(names, ("array", "board", "pose_set"), strict=True)
            if len({getattr(each.case, field) for each in summaries}) > 1
        ]
        label = ", ".join([NAMES[method], *differing]) + (", buzzers off" if off else "")
        found.append((label, method, list(group)))
    return sorted(found, key=lambda each: list(LOOKS).index(each[1]))


def _against_noise(folder: StudyFolder, summaries: list[CaseSummary], item: str | None) -> Figure:
    figure = Figure(figsize=(6.4, 4.2))
    axes = figure.subplots()
    as_printed = bool(item and printed(item)) and folder.study.name.endswith("as-published")
    shown, words = ("paper_rmse_m", "the paper's figure") if as_printed else ("median_m", "median error")
    for label, method, cases in _series(summaries):
        if "buzzers off" in label:
            continue
        colour, sign = LOOKS[method]
        scale_us = [1e6 * each.scale_s for each in cases]
        axes.plot(
            scale_us,
            [1e3 * getattr(each, shown) for each in cases],
            sign,
            ls="-",
            color=colour,
            label=label,
            lw=1.2,
            ms=5,
        )
        if method in ("ours-2", "ours-3"):
            axes.plot(scale_us, [1e3 * each.bound_m for each in cases], ls=":", color=colour, lw=1,
                      label=f"bound of {NAMES[method].split()[0]}")  # fmt: skip
        values = printed(item).get(method, {}) if item else {}
        by_noise = {each.case.noise: each.scale_s for each in cases}
        known = [(1e6 * by_noise[noise], value) for noise, value in values.items() if noise in by_noise]
        if known:
            axes.plot(*zip(*known, strict=True), "o", mfc="none", mec=colour, ms=11, lw=0)
    if item and printed(item):
        axes.plot([], [], "o", mfc="none", mec="grey", ms=11, lw=0, label="printed in the paper")
    axes.set(xscale="log", yscale="log", xlabel="scale of the noise, µs", ylabel=f"{words} of the microphones, mm")
    axes.set_ylim(top=min(axes.get_ylim()[1], MOST_MM))
    _plain_ticks(axes.xaxis, axes.yaxis)
    axes.set_title(folder.study.title, fontsize=10)
    axes.legend(fontsize=7.5, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _against_poses(folder: StudyFolder, summaries: list[CaseSummary]) -> Figure:
    figure = Figure(figsize=(6.4, 4.2))
    axes = figure.subplots()
    for label, method, cases in _series(summaries):
        colour, sign = LOOKS[method]
        n_poses = [each.case.n_poses or 0 for each in cases]
        axes.plot(
            n_poses, [1e3 * each.median_m for each in cases], sign, ls="-", color=colour, label=label, lw=1.2, ms=4
        )
        lower, upper = ([1e3 * min(getattr(each, name), 1e4) for each in cases] for name in ("lower_m", "upper_m"))
        axes.fill_between(n_poses, lower, upper, color=colour, alpha=0.15, lw=0)
    axes.set(yscale="log", ylim=(10, MOST_MM), xlabel="number of poses", ylabel="error of the microphones, mm")
    _plain_ticks(axes.yaxis)
    axes.set_title(f"{folder.study.title}: median and quartiles", fontsize=10)
    axes.legend(fontsize=7.5, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _boxes(finished: FinishedStudy) -> Figure:
    figure = Figure(figsize=(6.4, 3.6))
    axes = figure.subplots()
    labels, errors = [], []
    for label, _, cases in _series(finished.summaries):
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
    _plain_ticks(axes.xaxis)
    axes.set_title(finished.folder.study.title, fontsize=10)
    return figure


def _in_space(finished: FinishedStudy) -> Figure:
    figure = Figure(figsize=(6.4, 5.4))
    axes: Any = figure.add_subplot(projection="3d")
    scene = finished.scenes[finished.summaries[0].case.number]
    _scatter(axes, scene.microphones_m, "o", "grey", "true places", 60)
    for label, method, cases in _series(finished.summaries):
        if method != "search":
            places_m = np.median(_places(finished, cases[0]), axis=0)
            _scatter(
                axes, places_m[np.abs(places_m).max(axis=1) < FURTHEST_M], LOOKS[method][1], LOOKS[method][0], label
            )
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
    axes.set_title(finished.folder.study.title, fontsize=10)
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
