"""Whether a result can be believed, from stated criteria."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.doubts import DOUBTFUL_SPEED_SIGMAS, GOOD_RMS_PX, LARGE_REJECTED_SHARE
from calib.joint.observability import LITTLE_TILT_DEG, board_tilts_deg
from calib.report.coverage import FIELDS, depth_ratio, fields_seen, heard_shares
from calib.report.words import short, two_digits
from calib.result import Calibration
from rigs.description import RigDescription

Level = Literal["good", "usable", "do not use"]
LEVELS: tuple[Level, ...] = ("good", "usable", "do not use")

# Each: good up to the first, usable up to the second.
SPREAD_MM = (2.0, 10.0)
SCATTER_US = (2.0, 25.0)  # 2 us is 0.7 mm of path
HELD_OUT_RATIO = (1.5, 3.0)
REJECTED_SHARE = (LARGE_REJECTED_SHARE, 0.2)
CORNERS_PX = (GOOD_RMS_PX, 1.5)
SPEED_SIGMAS = (DOUBTFUL_SPEED_SIGMAS, 6.0)
TILT_DEG = (LITTLE_TILT_DEG, 2.0)  # at least
POSES = (12, 6)  # at least
FIELDS_SEEN_PERCENT = (60.0, 25.0)  # at least, of the picture's fields
DEPTH_RATIO = (1.5, 1.1)  # at least, of the farthest board's distance over the nearest one's
USED_PERCENT = (90.0, 60.0)  # at least
LEAST_HEARD_PERCENT = (80.0, 50.0)  # at least
MANY_WARNINGS = 6  # for each session
FEWEST_TO_VERIFY = 5  # microphones; rig-verify cannot place a sound with fewer and tell whether one of them moved
MORE_POSES = 6  # to be captured where there are enough, but something about them is not good
MEND_SOUND = "mend what was not heard (gains, cables, noise, echo; see Doubts and Rejected), then capture again"


@dataclass(frozen=True)
class Criterion:
    """One thing that was looked at.

    Parameters
    ----------
    name, found, good, usable : str
        What, its value, and what it must be to be good and to be usable; with units.
    level : Level
    why : str
        What it tells.
    remedy : str
        What to do where it is not good.
    """

    name: str
    found: str
    good: str
    usable: str
    level: Level
    why: str
    remedy: str

    def in_words(self) -> str:
        """Say what was found, and what it should have been."""
        limit = f"usable: {self.usable}" if self.level == "do not use" else f"good: {self.good}"
        return f"{self.name[0].lower()}{self.name[1:]} ({self.found}; {limit})"


@dataclass(frozen=True)
class Verdict:
    """What follows from all criteria: as good as the worst of them."""

    level: Level
    sentence: str
    criteria: list[Criterion]


def judge(result: Calibration, description: RigDescription) -> Verdict:
    """Judge a result."""
    criteria = [
        *_of_microphones(result, description),
        *_of_sound(result),
        *_of_hearing(result, description),
        *_of_camera(result),
        *_of_poses(result),
        *_of_coverage(result),
        _of_speed(result, description),
        _of_warnings(result),
    ]
    level = LEVELS[max(LEVELS.index(criterion.level) for criterion in criteria)]
    return Verdict(level, _sentence(result, level, criteria), criteria)


def _of_microphones(result: Calibration, description: RigDescription) -> list[Criterion]:
    std_mm = 1e3 * result.worst_std_m
    worst = int(np.argmax(std_mm))
    left_out = [channel for channel in description.audio.channels if channel not in result.channels]
    named = f", without channel {' and '.join(map(str, left_out))}" if left_out else ""
    few = f"; rig-verify needs {FEWEST_TO_VERIFY}" if len(result.channels) < FEWEST_TO_VERIFY else ""
    return [
        _at_most(
            "Least certain microphone",
            float(std_mm[worst]),
            SPREAD_MM,
            "mm",
            f"one standard deviation of channel {result.channels[worst]} in its weakest direction",
            f"{_more_poses(result)}, tilted both ways, near and far",
        ),
        Criterion(
            "Microphones placed",
            f"{len(result.channels)} of {len(description.audio.channels)}{named}",
            "all",
            "some left out",
            "usable" if left_out else "good",
            f"those left out have no position{few}",
            f"if channel {', '.join(map(str, left_out))} is needed: mend it, and capture again",
        ),
    ]


def _of_sound(result: Calibration) -> list[Criterion]:
    residual, held = result.residual, result.held_out
    total = max(residual.n_used + residual.n_rejected, 1)
    why = "1 µs is 0.34 mm of path"
    out = [_at_most("Scatter of the TDOAs", 1e6 * residual.robust_sigma_s, SCATTER_US, "µs", why, MEND_SOUND)]
    if held is not None:
        out.append(
            _at_most(
                "Held-out poses over fitted ones",
                held.robust_sigma_s / residual.robust_sigma_s,
                HELD_OUT_RATIO,
                "times",
                "scatter of poses that took no part in the solve: much more means too few or too similar poses",
                f"{_more_poses(result)}, unlike those that are there",
            )
        )
    share = 100 * residual.n_rejected / total
    limits = (100 * REJECTED_SHARE[0], 100 * REJECTED_SHARE[1])
    why = "echoes, noise, or a rig that is not as described"
    out.append(_at_most("Rejected TDOAs", share, limits, "%", why, MEND_SOUND))
    return out


def _of_hearing(result: Calibration, description: RigDescription) -> list[Criterion]:
    """Judge what is missing; it is not among the rejected, as nothing was measured there."""
    if result.evidence is None:
        return []
    shares = heard_shares(result, result.evidence, description)
    worst = int(np.argmin(shares))
    return [
        _at_least(
            "Arrivals used",
            100 * float(shares.mean()),
            USED_PERCENT,
            "%",
            "of a sound of every buzzer in every pose at these microphones; the rest was not heard, or rejected",
            MEND_SOUND,
        ),
        _at_least(
            "Least heard microphone",
            100 * float(shares[worst]),
            LEAST_HEARD_PERCENT,
            "%",
            f"share of the sounds that channel {result.channels[worst]} rests on: what is heard of few is chance",
            f"mend channel {result.channels[worst]} (cable, gain, noise), then capture again",
        ),
    ]


def _of_camera(result: Calibration) -> list[Criterion]:
    why = "how well corners fit the camera, root mean square"
    remedy = "check focus, and that the board is flat, then capture again"
    return [_at_most("Corners of the board", result.view.rms_px, CORNERS_PX, "px", why, remedy)]


def _of_poses(result: Calibration) -> list[Criterion]:
    poses = result.view.board_to_camera
    tilt_deg = board_tilts_deg(np.array([pose.rotation for pose in poses]))[1]
    why = "tilt about the axis of least tilt, root mean square: it tells depth from focal length"
    remedy = f"{_more_poses(result)}, tilted by 20 to 35 degrees about both axes"
    return [
        _at_least(
            "Board positions", len(poses), POSES, "", "positions of the board that were used", _more_poses(result)
        ),
        _at_least("Tilt of the boards", tilt_deg, TILT_DEG, "degrees", why, remedy),
    ]


def _more_poses(result: Calibration) -> str:
    """Say how to capture more; the commas of what follows come after the command."""
    if result.sessions:
        return "capture another session"
    if result.sound is None:  # measured elsewhere: no session of rig-capture's
        return "capture more poses"
    n_poses = max(POSES[0], len(result.view.pose) + MORE_POSES)
    return (
        f"capture more poses (rig-capture --session {shlex.quote(result.session_name)} --resume --poses {n_poses}; "
        "then rig-calibrate again, with --overwrite)"
    )


def _of_coverage(result: Calibration) -> list[Criterion]:
    why = "the farthest board's distance over the nearest one's"
    remedy = f"{_more_poses(result)} nearer and farther, 0.4 to 1 m"
    out = [_at_least("Depth covered", depth_ratio(result), DEPTH_RATIO, "times", why, remedy)]
    if result.evidence is not None:
        across, down = FIELDS
        why = f"of its {across} x {down} fields, those with corners of the board: elsewhere the lens is not known"
        share = 100 * float(fields_seen(result, result.evidence).mean())
        remedy = f"{_more_poses(result)}, towards the picture's edges and corners"
        out.insert(0, _at_least("Picture covered", share, FIELDS_SEEN_PERCENT, "%", why, remedy))
    return out


def _of_speed(result: Calibration, description: RigDescription) -> Criterion:
    medium = description.medium
    sigmas = abs(result.speed_of_sound_m_s - medium.speed_m_s()) / medium.speed_std_m_s()
    why = f"from the {medium.speed_m_s():.1f} m/s of the rig description: pictures and sound must agree on scale"
    remedy = "check medium and board.square_size_m in the rig description"
    return _at_most("Speed of sound", sigmas, SPEED_SIGMAS, "standard deviations off", why, remedy)


def _of_warnings(result: Calibration) -> Criterion:
    n_warnings, most = len(result.warnings), MANY_WARNINGS * max(len(result.sessions), 1)
    level: Level = "good" if not n_warnings else "usable" if n_warnings <= most else "do not use"
    why, remedy = "each is listed under Doubts", "read the warnings: each says what to do"
    return Criterion("Warnings", str(n_warnings), "none", f"≤ {most}", level, why, remedy)


def _at_most(name: str, value: float, limits: tuple[float, float], unit: str, why: str, remedy: str) -> Criterion:
    good, usable = limits
    level: Level = "good" if value <= good else "usable" if value <= usable else "do not use"
    return Criterion(
        name, f"{short(value, 3)} {unit}", f"≤ {good:g} {unit}", f"≤ {usable:g} {unit}", level, why, remedy
    )


def _at_least(name: str, value: float, limits: tuple[float, float], unit: str, why: str, remedy: str) -> Criterion:
    good, usable = limits
    level: Level = "good" if value >= good else "usable" if value >= usable else "do not use"
    return Criterion(
        name,
        f"{short(value, 3)} {unit}".strip(),
        f"≥ {good:g} {unit}".strip(),
        f"≥ {usable:g} {unit}".strip(),
        level,
        why,
        remedy,
    )


def _sentence(result: Calibration, level: Level, criteria: list[Criterion]) -> str:
    """Say what the verdict means, why it is no better, and what to do first."""
    std_mm = 1e3 * float(result.worst_std_m.max())
    n_mics = len(result.channels)
    found = (
        f"{n_mics} microphones are placed in the camera's frame, each to {two_digits(std_mm)} mm or better (one "
        "standard deviation, in the weakest direction)"
    )
    if level == "good":
        return f"{found}, and nothing speaks against them."
    weak = [criterion for criterion in criteria if criterion.level == level]
    because = _and([criterion.in_words() for criterion in weak])
    first = f"First: {weak[0].remedy}."
    if level == "usable":
        return f"{found}. Use them with care, because of: {because}. {first}"
    return f"Do not rely on these positions, because of: {because}. {first}"


def _and(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
