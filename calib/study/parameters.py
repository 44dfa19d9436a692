"""What studies try, in words: a table of one of them, and Table I of the paper, side by side."""

from __future__ import annotations

from collections.abc import Iterable

from calib.study.description import (
    Board,
    CubeArray,
    DrawnPoses,
    GaussianNoise,
    KnownMicrophone,
    ListedArray,
    MeasuredNoise,
    PublishedBoard,
    RigBoard,
    RingArray,
    StudyDescription,
    UniformNoise,
)
from calib.study.labels import noise_words
from calib.study.scene import Case

PRINTED_NOT = (
    "The content of the paper's Table I. Rows: parameters; columns: studies. What the paper prints there is not among "
    "what we have."
)


def tried_table(study: StudyDescription, cases: Iterable[Case], *, stand_in: bool) -> list[str]:
    """Return what the names in a study's cases stand for, as a Markdown table."""
    cases = list(cases)
    rows = [("array", name, _array_words(study.arrays[name])) for name in _names(cases, "array")]
    rows += [("board", name, _board_words(study.boards[name])) for name in _names(cases, "board")]
    rows += [
        ("pose set", name, _pose_words(study.pose_sets[name], stand_in=stand_in)) for name in _names(cases, "pose_set")
    ]
    rows += [("noise", name, noise_words(study.noises[name])) for name in _names(cases, "noise")]
    taken = dict.fromkeys("all" if case.n_poses is None else str(case.n_poses) for case in cases)
    drawn = "" if list(taken) == ["all"] else ", drawn at random for each repetition"
    rows.append(("poses taken", ", ".join(taken), f"of the pose set{drawn}"))
    return ["| | name | what it is |", "| --- | --- | --- |", *(f"| {' | '.join(row)} |" for row in rows)]


def _names(cases: list[Case], field: str) -> list[str]:
    return list(dict.fromkeys(getattr(case, field) for case in cases))


def parameters_page(studies: list[StudyDescription], *, stand_in: bool) -> str:
    """Return the parameters of simulations as a table; `stand_in`: the published poses are not there."""
    described = [_parameters(study, stand_in=stand_in) for study in studies]
    lines = ["## Parameters of the simulations", "", PRINTED_NOT, ""]
    lines.append("| | " + " | ".join(study.name for study in studies) + " |")
    lines.append("| --- " * (len(studies) + 1) + "|")
    lines += [f"| {key} | " + " | ".join(values[key] for values in described) + " |" for key in described[0]]
    return "\n".join([*lines, ""])


def _parameters(study: StudyDescription, *, stand_in: bool) -> dict[str, str]:
    boards = [f"{_board_words(study.boards[name])}, for {methods}" for name, methods in _users(study).items()]
    (array, *_), noises, start = study.arrays.values(), study.noises, study.start
    levels = [f"{1e6 * noise.scale_s:.4g}" for noise in noises.values() if not isinstance(noise, MeasuredNoise)]
    return {
        "array": _array_words(array),
        "board poses": ", ".join(_pose_words(each, stand_in=stand_in) for each in study.pose_sets.values()),
        "buzzers": "; ".join(boards),
        "speed of sound": f"{study.speed_of_sound_m_s:g} m/s",
        "noise": "; ".join(dict.fromkeys(_noise_words(noise) for noise in noises.values())),
        "scales of the noise, us": ", ".join(dict.fromkeys(levels)),
        "buzzers out of place": _buzzer_words(study),
        "first guess": f"box of {start.low_m} to {start.high_m} m at {start.offset_m} m, "
        f"moved by up to {start.jitter_m:g} m, drawn {_start_words(study)}",
        "known microphone": _known_words(study.known_microphone),
        "repetitions": _repetition_words(study),
        "Legg's search is judged in the": study.search_judged_in,
    }


def _array_words(array: object) -> str:
    if isinstance(array, CubeArray):
        return f"corners of a cube of {array.side_m:g} m, centre {array.centre_m} m from the camera"
    if isinstance(array, RingArray):
        rise = f"rising by {array.rise_m:g} m" if array.rise_m else "flat"
        return f"{array.n_mics} on a ring of radius {array.radius_m:g} m, {rise}, centre {array.centre_m} m"
    if isinstance(array, ListedArray):
        return f"{len(array.microphones_m)} at given places"
    return "8 of the paper's real array, as measured by ruler"


def _board_words(board: Board) -> str:
    n_buzzers = len(board.places_m())
    if isinstance(board, PublishedBoard):
        return f"layout {board.layout} of the paper's authors, {n_buzzers} buzzers"
    return f"{f'of rig {board.rig}' if isinstance(board, RigBoard) else 'at given places'}, {n_buzzers} buzzers"


def _users(study: StudyDescription) -> dict[str, str]:
    """Return which methods each board is used with."""
    users: dict[str, dict[str, None]] = {}
    for run in study.runs:
        for name in run.boards:
            users.setdefault(name, {}).update(dict.fromkeys(run.methods))
    return {name: "all" if len(users) == 1 else ", ".join(methods) for name, methods in users.items()}


def _pose_words(poses: object, *, stand_in: bool) -> str:
    if isinstance(poses, DrawnPoses):
        far = f"{poses.nearest_m:g} to {poses.furthest_m:g} m"
        return f"{poses.n_poses} drawn, {far} away, tilted up to {poses.tilt_deg:g}°"
    return "69 stand-ins, drawn at random" if stand_in else "the paper's 69"


def _repetition_words(study: StudyDescription) -> str:
    others = {method: run.repetitions for run in study.runs if run.repetitions for method in run.methods}
    return f"{study.repetitions}" + "".join(
        f"; {n} for {method}" for method, n in others.items() if n != study.repetitions
    )


def _start_words(study: StudyDescription) -> str:
    users: dict[str, list[str]] = {}
    for run in study.runs:
        users.setdefault(run.starts or study.start.drawn, []).extend(run.methods)
    if len(users) == 1:
        return study.start.drawn
    return "; ".join(f"{starts} for {', '.join(dict.fromkeys(methods))}" for starts, methods in users.items())


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
