"""Tables of a study as Markdown, beside what the paper prints."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

import numpy as np
import yaml

from calib.study.description import (
    CubeArray,
    DrawnPoses,
    GaussianNoise,
    KnownMicrophone,
    MeasuredNoise,
    RulerArray,
    StudyDescription,
    UniformNoise,
)
from calib.study.run import FinishedStudy
from calib.study.summary import CaseSummary

NAMES = {
    "ours-1": "Ours-1 (one reference)",
    "ours-2": "Ours-2 (all pairs)",
    "ours-3": "Ours-3 (known ninth)",
    "search": "Legg, authors' search",
    "legg-2013": "Legg, 2013 method",
    "joint": "joint",
}
FIGURES = {
    "paper_rmse_m": "The paper's figure (root of the mean; microphones 1 to 7 over 8), mm",
    "rmse_m": "Root mean square error of all microphones, mm",
    "median_m": "Median of the repetitions' root mean square errors, mm",
    "aligned_median_m": "The same after the best rigid motion of each, mm",
    "bound_m": "Cramer-Rao bound for Gaussian noise of this variance, mm",
    "settled": "Share that came to rest nearby",
    "at_optimum": "Share at the optimum that the truth leads to",
}
IN_TERMINAL = ("paper_rmse_m", "rmse_m", "median_m", "bound_m", "at_optimum")
MOST_COLUMNS = 8  # of a table, in the terminal
NEVER_MM = 1e5  # more says only that some repetition ran away


def study_page(finished: FinishedStudy, item: str | None = None) -> str:
    """Return all figures of a study, methods down and noises across, with those printed for an item of the paper."""
    study = finished.folder.study
    lines = [f"## {study.title or study.name}", "", f"`{study.name}`, seed {study.seed}", ""]
    for name, title in FIGURES.items():
        rows = _pivot(finished.summaries, name)
        if rows:
            shown = printed(item) if name == "paper_rmse_m" and item else {}
            lines += [f"**{title}**", "", *_markdown(rows, shown, _columns(finished.summaries)), ""]
    return "\n".join(lines)


def terminal_page(finished: FinishedStudy, item: str | None = None) -> str:
    """Return the figures that tell most, of some columns where there are many."""
    columns = _columns(finished.summaries)
    chosen = set(columns[:: max(len(columns) // MOST_COLUMNS + 1, 1)])
    some = [summary for summary in finished.summaries if _column(summary) in chosen]
    lines = []
    for name in IN_TERMINAL:
        rows = _pivot(some, name)
        if rows:
            shown = printed(item) if name == "paper_rmse_m" and item else {}
            lines += [f"**{FIGURES[name]}**", "", *_markdown(rows, shown, _columns(some)), ""]
    return "\n".join(lines)


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


def parameters_page(studies: list[StudyDescription]) -> str:
    """Return Table I: what each simulation takes, side by side."""
    described = [_parameters(study) for study in studies]
    lines = ["## Parameters of the simulations", "", "| | " + " | ".join(study.name for study in studies) + " |"]
    lines.append("| --- " * (len(studies) + 1) + "|")
    lines += [f"| {key} | " + " | ".join(values[key] for values in described) + " |" for key in described[0]]
    return "\n".join([*lines, ""])


def _columns(summaries: list[CaseSummary]) -> list[str]:
    return list(dict.fromkeys(_column(summary) for summary in summaries))


def _column(summary: CaseSummary) -> str:
    return summary.case.noise if summary.case.n_poses is None else f"{summary.case.n_poses} poses"


def _row(summary: CaseSummary, summaries: list[CaseSummary]) -> str:
    """Return the name of a row: the method, and what else differs within the study."""
    words = [NAMES[summary.case.method]]
    for field in ("array", "board", "pose_set"):
        if len({getattr(each.case, field) for each in summaries}) > 1:
            words.append(f"{field.replace('_', ' ')} {getattr(summary.case, field)}")
    return ", ".join(words)


def _pivot(summaries: list[CaseSummary], figure: str) -> dict[tuple[str, str], dict[str, str]]:
    """Return cells by (row's name, method) and column; empty where the study has no such figure."""
    rows: dict[tuple[str, str], dict[str, str]] = {}
    share = figure in ("settled", "at_optimum")
    for summary in summaries:
        value = getattr(summary, figure)
        if np.isnan(value):
            continue
        cells = rows.setdefault((_row(summary, summaries), summary.case.method), {})
        cells[_column(summary)] = f"{100 * value:.0f} %" if share else _millimetres(value)
    return rows


def _millimetres(value_m: float) -> str:
    value_mm = 1e3 * value_m
    return f"{value_mm:.4g}" if value_mm < NEVER_MM else "diverged"


def _markdown(
    rows: dict[tuple[str, str], dict[str, str]], shown: dict[str, dict[str, float]], columns: list[str]
) -> list[str]:
    lines = ["| | " + " | ".join(columns) + " |", "| --- " + "| ---: " * len(columns) + "|"]
    for (name, method), cells in rows.items():
        lines.append(f"| {name} | " + " | ".join(cells.get(column, "") for column in columns) + " |")
        if method in shown:
            values = [f"{shown[method][column]:.4g}" if column in shown[method] else "" for column in columns]
            lines.append(
                "| *the paper prints* | " + " | ".join(f"*{value}*" if value else "" for value in values) + " |"
            )
    return lines


def _parameters(study: StudyDescription) -> dict[str, str]:
    (array, *_), noises, start = study.arrays.values(), study.noises, study.start
    levels = [f"{1e6 * noise.scale_s:.4g}" for noise in noises.values() if not isinstance(noise, MeasuredNoise)]
    return {
        "array": _array_words(array),
        "board poses": ", ".join(_pose_words(each) for each in study.pose_sets.values()),
        "buzzers": "; ".join(f"layout {name}: {len(each.places_m())}" for name, each in study.boards.items()),
        "speed of sound": f"{study.speed_of_sound_m_s:g} m/s",
        "noise": "; ".join(dict.fromkeys(_noise_words(noise) for noise in noises.values())),
        "scales of the noise, us": ", ".join(dict.fromkeys(levels)),
        "buzzers out of place": _buzzer_words(study),
        "first guess": f"box of {start.low_m} to {start.high_m} m at {start.offset_m} m, "
        f"moved by up to {start.jitter_m:g} m, "
        f"drawn {start.drawn}{_other_starts(study)}",
        "known microphone": _known_words(study.known_microphone),
        "rounds": str(study.repetitions),
        "Legg's search is judged in the": study.search_judged_in,
    }


def _array_words(array: object) -> str:
    if isinstance(array, CubeArray):
        return f"corners of a cube of {array.side_m:g} m, centre {array.centre_m} m from the camera"
    return "measured by ruler" if isinstance(array, RulerArray) else type(array).__name__


def _pose_words(poses: object) -> str:
    if isinstance(poses, DrawnPoses):
        far = f"{poses.nearest_m:g} to {poses.furthest_m:g} m"
        return f"{poses.n_poses} drawn, {far} away, tilted up to {poses.tilt_deg:g}°"
    return "the paper's 69"


def _other_starts(study: StudyDescription) -> str:
    others = {method: run.starts for run in study.runs if run.starts for method in run.methods}
    return "".join(f"; {starts} for {method}" for method, starts in others.items())


def _known_words(known: KnownMicrophone | None) -> str:
    if known is None:
        return "none"
    return f"{known.position_m} m" if known.position_m else f"{known.on_board_m} m on the board at the first pose"


def _noise_words(noise: object) -> str:
    if isinstance(noise, UniformNoise):
        return f"uniform from 0 to the scale, on {noise.adds_to}"
    if isinstance(noise, GaussianNoise):
        return f"Gaussian, the scale its standard deviation, on {noise.adds_to}"
    return "as measured"


def _buzzer_words(study: StudyDescription) -> str:
    off = [
        f"{1e3 * noise.buzzer_std_m:g} mm per axis in {name!r}"
        for name, noise in study.noises.items()
        if not isinstance(noise, MeasuredNoise) and noise.buzzer_std_m
    ]
    return ", ".join(off) or "no"
