"""Whether a result can be believed, from stated criteria."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.doubts import DOUBTFUL_SPEED_SIGMAS, GOOD_RMS_PX, LARGE_REJECTED_SHARE
from calib.joint.observability import LITTLE_TILT_DEG, board_tilts_deg
from calib.report.words import short
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
    """

    name: str
    found: str
    good: str
    usable: str
    level: Level
    why: str

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
        *_of_microphones(result),
        *_of_sound(result),
        *_of_camera(result),
        *_of_poses(result),
        _of_speed(result, description),
        _of_warnings(result),
    ]
    level = LEVELS[max(LEVELS.index(criterion.level) for criterion in criteria)]
    return Verdict(level, _sentence(result, level, criteria), criteria)


def _of_microphones(result: Calibration) -> list[Criterion]:
    std_mm = 1e3 * result.worst_std_m
    worst = int(np.argmax(std_mm))
    return [
        _at_most(
            "Least certain microphone",
            float(std_mm[worst]),
            SPREAD_MM,
            "mm",
            f"standard deviation of channel {result.channels[worst]} in its weakest direction",
        )
    ]


def _of_sound(result: Calibration) -> list[Criterion]:
    residual, held = result.residual, result.held_out
    total = max(residual.n_used + residual.n_rejected, 1)
    out = [_at_most("Scatter of the TDOAs", 1e6 * residual.robust_sigma_s, SCATTER_US, "µs", "1 µs is 0.34 mm of path")]
    if held is not None:
        ratio = held.robust_sigma_s / residual.robust_sigma_s
        out.append(
            _at_most(
                "Held-out poses over fitted ones",
                ratio,
                HELD_OUT_RATIO,
                "times",
                "scatter of poses that took no part in the solve: much more means too few or too similar poses",
            )
        )
    share = 100 * residual.n_rejected / total
    limits = (100 * REJECTED_SHARE[0], 100 * REJECTED_SHARE[1])
    out.append(_at_most("Rejected TDOAs", share, limits, "%", "echoes, noise, or a rig that is not as described"))
    return out


def _of_camera(result: Calibration) -> list[Criterion]:
    why = "how well corners fit the camera, root mean square"
    return [_at_most("Corners of the board", result.view.rms_px, CORNERS_PX, "px", why)]


def _of_poses(result: Calibration) -> list[Criterion]:
    poses = result.view.board_to_camera
    tilt_deg = board_tilts_deg(np.array([pose.rotation for pose in poses]))[1]
    why = "tilt about the axis of least tilt, root mean square: it tells depth from focal length"
    return [
        _at_least("Board positions", len(poses), POSES, "", "positions of the board that were used"),
        _at_least("Tilt of the boards", tilt_deg, TILT_DEG, "degrees", why),
    ]


def _of_speed(result: Calibration, description: RigDescription) -> Criterion:
    medium = description.medium
    sigmas = abs(result.speed_of_sound_m_s - medium.speed_m_s()) / medium.speed_std_m_s()
    why = f"from the {medium.speed_m_s():.1f} m/s of the rig description: pictures and sound must agree on scale"
    return _at_most("Speed of sound", sigmas, SPEED_SIGMAS, "standard deviations off", why)


def _of_warnings(result: Calibration) -> Criterion:
    n_warnings = len(result.warnings)
    level: Level = "usable" if n_warnings else "good"
    return Criterion("Warnings", str(n_warnings), "none", "any", level, "each is listed under Doubts")


def _at_most(name: str, value: float, limits: tuple[float, float], unit: str, why: str) -> Criterion:
    good, usable = limits
    level: Level = "good" if value <= good else "usable" if value <= usable else "do not use"
    return Criterion(name, f"{short(value, 3)} {unit}", f"≤ {good:g} {unit}", f"≤ {usable:g} {unit}", level, why)


def _at_least(name: str, value: float, limits: tuple[float, float], unit: str, why: str) -> Criterion:
    good, usable = limits
    level: Level = "good" if value >= good else "usable" if value >= usable else "do not use"
    return Criterion(
        name,
        f"{short(value, 3)} {unit}".strip(),
        f"≥ {good:g} {unit}".strip(),
        f"≥ {usable:g} {unit}".strip(),
        level,
        why,
    )


def _sentence(result: Calibration, level: Level, criteria: list[Criterion]) -> str:
    std_mm = 1e3 * float(np.sqrt(np.mean(np.sum(result.std_m**2, axis=1))))
    n_mics = len(result.channels)
    found = f"{n_mics} microphones are placed in the camera's frame to {short(std_mm)} mm (one standard deviation)"
    weak = [criterion.in_words() for criterion in criteria if criterion.level == level]
    if level == "good":
        return f"{found}, and nothing speaks against them."
    if level == "usable":
        return f"{found}. Use them with care, because of: {_and(weak)}."
    return f"Do not rely on these positions, because of: {_and(weak)}."


def _and(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
