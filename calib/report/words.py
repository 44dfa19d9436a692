"""What the report says in words: how it was made, what its figures mean, and which directions are weak."""

from __future__ import annotations

import math
import platform
import shlex
from importlib.metadata import version
from typing import NamedTuple

import numpy as np

from calib.result import Calibration
from calib.settings import Settings
from rigs import __version__

TELLING = 1.5  # times the best direction: less is the same in all directions, for a reader
NEARLY = 0.9  # cosine of the angle to an axis
DIRECTIONS = ("sideways (x)", "up and down (y)", "in depth (z)")
LIBRARIES = ("numpy", "scipy", "opencv-python-headless", "h5py", "pydantic", "matplotlib", "jinja2")


class Meaning(NamedTuple):
    """What a figure tells, and what it cannot tell."""

    figure: str
    tells: str
    cannot_tell: str


MEANINGS = (
    Meaning(
        "Least certain microphone, ±",
        "One standard deviation. At the top of this page and in the criteria: of the least certain microphone, along "
        "its weakest direction. In the table: of each, along x, y and z, and along its own weakest direction. How far "
        "the answer would scatter if the session were captured again with other noise, and with buzzers, "
        "squares and air that differ as much as the rig description says they may.",
        "Errors that measurements share: an echo that always comes with the sound, a delay of a "
        "sound card's input. Those are not in it.",
    ),
    Meaning(
        "Scatter of the TDOAs",
        "How well measured time differences fit the positions, blind to outliers. 1 µs is 0.34 mm of path.",
        "Whether the positions are right: an error that bends all time differences alike can hide in them.",
    ),
    Meaning(
        "Held-out poses",
        "How well time differences are predicted of board positions that took no part in the solve (five folds), and "
        "how far the folds' microphones differ. Near the fitted scatter: nothing was fitted to noise.",
        "An error that all poses share.",
    ),
    Meaning(
        "Noise floor",
        "About the scatter that the noise in the recording alone gives.",
        "What echoes add. It is estimated from the noise before each sound, good to some twenty per cent, and a fit "
        "takes up a little noise: so fitted poses may lie below it.",
    ),
    Meaning(
        "Corners of the board",
        "How well the board's corners in the pictures fit the camera's model. Good below 0.5 px, usual below 0.1 px.",
        "A wrong focal length, when all boards face the camera.",
    ),
    Meaning(
        "Speed of sound",
        "Found from the session along with everything else; far from the rig description's, something is wrong: the "
        "temperature, or the scale of the printed board.",
        "Which of the two. A wrong square size alone hides in the depths.",
    ),
    Meaning(
        "Error against the truth",
        "Where a session knows the true positions (simulation, or a ruler): the distance from them.",
        "More than the truth is good for: a ruler's frame that is tilted shows as an error of the positions.",
    ),
)


def short(value: float, digits: int = 2) -> str:
    """Return a number with so many significant digits and without an exponent, as people write it."""
    return f"{float(f'{value:.{digits}g}'):g}"


def two_digits(value: float) -> str:
    """Return a number with two significant digits, zeros at its end too, so that numbers side by side look alike."""
    rounded = float(f"{value:.2g}")
    decimals = 0 if rounded == 0 or not math.isfinite(rounded) else max(0, 1 - math.floor(math.log10(abs(rounded))))
    return f"{rounded:.{decimals}f}"


def command_line(sessions: list[str], result_name: str, settings: Settings) -> str:
    """Return the command that makes the result again."""
    usual = Settings()
    words = ["rig-calibrate", *sessions, "--method", settings.method]
    words += ["--seed", str(settings.seed)] if settings.seed != usual.seed else []
    words += ["--tdoa", settings.tdoa] if settings.tdoa != usual.tdoa else []
    words += ["--reference", str(settings.reference_channel)] if settings.reference_channel is not None else []
    words += [word for channel in settings.excluded_channels for word in ("--exclude-channel", str(channel))]
    words += [word for block in settings.hold for word in ("--hold", block)]
    words += [word for block in settings.exact for word in ("--exact", block)]
    words += ["--find-delays"] if settings.find_delays else []
    words += ["--ignore-sync"] if settings.ignore_sync else []
    words += ["--suggest-poses", str(settings.suggest_poses)] if settings.suggest_poses else []
    return shlex.join([*words, "--output", result_name])


def settings_table(settings: Settings) -> list[tuple[str, str]]:
    """Return every setting with its value."""
    return [
        ("method", settings.method),
        ("how arrivals are measured", settings.tdoa),
        ("seed of first guesses", str(settings.seed)),
        ("reference channel", "none" if settings.reference_channel is None else str(settings.reference_channel)),
        ("channels left out", ", ".join(map(str, settings.excluded_channels)) or "none"),
        ("held", ", ".join(settings.hold) or "nothing"),
        ("held as exact", ", ".join(settings.exact) or "nothing"),
        ("sync output, where recorded", "left out" if settings.ignore_sync else "used"),
        ("delays of channels", "found" if settings.find_delays else "held at 0"),
    ]


def versions_table() -> list[tuple[str, str]]:
    """Return the versions of what calculated the result."""
    libraries = [(name, version(name)) for name in LIBRARIES]
    return [("acoustic-camera-rig", __version__), ("Python", platform.python_version()), *libraries]


def weak_directions(result: Calibration) -> list[str]:
    """Say of the array, and of each microphone, in which direction it is known worst."""
    sentences = []
    if (weakest := result.weakest) is not None:
        along = f", along with {weakest.along_with}" if weakest.along_with else ""
        sentences.append(
            f"The array is known worst in {weakest.motion}: {short(1e3 * weakest.std_m)} mm per microphone{along}."
        )
    worst_mm = 1e3 * result.worst_std_m
    for row in np.argsort(-worst_mm)[:3]:
        values, vectors = np.linalg.eigh(result.covariance_m2[row])
        best_mm = 1e3 * float(np.sqrt(max(values[0], 0.0)))
        where = _direction(vectors[:, -1]) if worst_mm[row] > TELLING * best_mm else "about alike in all directions"
        known_mm = f"{short(worst_mm[row])} mm {where}; {short(best_mm)} mm where it is known best"
        sentences.append(f"Channel {result.channels[row]}: {known_mm}.")
    return sentences


def _direction(vector: np.ndarray) -> str:
    axis = int(np.argmax(np.abs(vector)))
    if abs(vector[axis]) > NEARLY:
        return DIRECTIONS[axis]
    x, y, z = vector * np.sign(vector[axis])
    return f"along ({x:+.2f}, {y:+.2f}, {z:+.2f})"
