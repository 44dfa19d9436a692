"""Table I of the paper: what each simulation takes, side by side."""

from __future__ import annotations

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


def parameters_page(studies: list[StudyDescription], *, stand_in: bool) -> str:
    """Return the parameters of simulations as a table; `stand_in`: the published poses are not there."""
    described = [_parameters(study, stand_in=stand_in) for study in studies]
    lines = ["## Parameters of the simulations", "", "Rows: parameters; columns: studies.", ""]
    lines.append("| | " + " | ".join(study.name for study in studies) + " |")
    lines.append("| --- " * (len(studies) + 1) + "|")
    lines += [f"| {key} | " + " | ".join(values[key] for values in described) + " |" for key in described[0]]
    return "\n".join([*lines, ""])


def _parameters(study: StudyDescription, *, stand_in: bool) -> dict[str, str]:
    (array, *_), noises, start = study.arrays.values(), study.noises, study.start
    levels = [f"{1e6 * noise.scale_s:.4g}" for noise in noises.values() if not isinstance(noise, MeasuredNoise)]
    return {
        "array": _array_words(array),
        "board poses": ", ".join(_pose_words(each, stand_in=stand_in) for each in study.pose_sets.values()),
        "buzzers": "; ".join(f"layout {name}: {len(each.places_m())}" for name, each in study.boards.items()),
        "speed of sound": f"{study.speed_of_sound_m_s:g} m/s",
        "noise": "; ".join(dict.fromkeys(_noise_words(noise) for noise in noises.values())),
        "scales of the noise, us": ", ".join(dict.fromkeys(levels)),
        "buzzers out of place": _buzzer_words(study),
        "first guess": f"box of {start.low_m} to {start.high_m} m at {start.offset_m} m, "
        f"moved by up to {start.jitter_m:g} m, "
        f"drawn {start.drawn}{_other_starts(study)}",
        "known microphone": _known_words(study.known_microphone),
        "repetitions": _repetition_words(study),
        "Legg's search is judged in the": study.search_judged_in,
    }


def _array_words(array: object) -> str:
    if isinstance(array, CubeArray):
        return f"corners of a cube of {array.side_m:g} m, centre {array.centre_m} m from the camera"
    return "measured by ruler" if isinstance(array, RulerArray) else type(array).__name__


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
