"""What an answer does not rest on, each with its reason: poses, channels, emissions, and single arrivals.

What is said of a whole pose, channel or emission is not said again of its arrivals.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.corners import PoseCorners
from calib.emissions import EmissionTdoas
from calib.flaws import HARMLESS
from calib.joint.robust import JointSolution
from calib.sound import SoundArrivals
from rigs.session.reader import Session

KINDS = ("pose", "channel", "emission", "arrival")
MOST = 0.5
NOT_ACCEPTED = "not accepted when it was captured"


@dataclass(frozen=True)
class Rejection:
    """Something that was left out.

    Parameters
    ----------
    kind : {"pose", "channel", "emission", "arrival"}
    reason : str
    pose : int or str or None
        Its number, with its session's name where there are several.
    emission : int or None
        Row of the session's table, from 0.
    buzzer, channel : int or None
    sigmas : float
        How far off it is, in standard deviations; 0 where that was not the reason.
    """

    kind: str
    reason: str
    pose: int | str | None = None
    emission: int | None = None
    buzzer: int | None = None
    channel: int | None = None
    sigmas: float = 0.0

    def of_session(self, name: str) -> Rejection:
        """Return it with the session's name, where there are several."""
        if self.pose is None:
            return replace(self, reason=f"{self.reason} ({name})")
        return replace(self, pose=f"{self.pose} of {name}")

    def document(self) -> dict[str, Any]:
        """Return plain values."""
        named = {"pose": self.pose, "emission": self.emission, "buzzer": self.buzzer, "channel": self.channel}
        return {name: value for name, value in named.items() if value is not None} | {"reason": self.reason}

    def sentence(self) -> str:
        """Name it and say why."""
        named = ", ".join(f"{name} {value}" for name, value in self.document().items() if name != "reason")
        return f"{named}: {self.reason}"


def solve_rejections(
    solution: JointSolution, tdoas: EmissionTdoas, rows: NDArray[np.intp], channels: tuple[int, ...]
) -> list[Rejection]:
    """Return what the solve left out, as it does not fit.

    Parameters
    ----------
    solution : JointSolution
    tdoas : EmissionTdoas
    rows : (n_emissions,) integer array
        Which of them the emissions of the problem are.
    channels : tuple of int
        Of all microphones of the problem.
    """
    table = solution.problem.arrivals
    present = table.present | _measured(tdoas, rows, channels)
    rejected = present & ~solution.used_arrivals
    residuals_s = solution.residuals_s()
    sigmas = np.abs(residuals_s) / (table.std_s * solution.scales.arrivals)
    poses = [own for pose in np.unique(table.pose) if _most(rejected[own := table.pose == pose], present[own])]
    columns = [column for column in range(len(channels)) if _most(rejected[:, column], present[:, column])]
    found = [
        *(Rejection("pose", _share(rejected[own], present[own]), tdoas.pose_name(rows[own][0])) for own in poses),
        *(
            Rejection("channel", _share(rejected[:, column], present[:, column]), channel=int(channels[column]))
            for column in columns
        ),
    ]
    said = np.any([*poses, np.zeros(len(rows), dtype=bool)], axis=0)[:, None] | np.isin(
        np.arange(len(channels)), columns
    )
    for number, row in enumerate(rows):
        where = (tdoas.pose_name(row), tdoas.number(row), int(tdoas.buzzer[row]))
        open_ones = rejected[number] & ~said[number]
        if _most(open_ones, present[number]):
            found.append(Rejection("emission", _share(rejected[number], present[number]), *where))
            continue
        for column in np.flatnonzero(open_ones):
            off = float(np.nan_to_num(sigmas[number, column]))
            reason = f"{1e6 * residuals_s[number, column]:+.2f} us off, {off:.1f} standard deviations"
            reason = reason if off else "its TDOAs do not agree"
            found.append(Rejection("arrival", reason, *where, int(channels[column]), off))
    return found


def _measured(tdoas: EmissionTdoas, rows: NDArray[np.intp], channels: tuple[int, ...]) -> NDArray[np.bool_]:
    """Tell which channels (n_emissions, n_mics) have any TDOA against another of them."""
    among = np.isin(tdoas.pairs, channels).all(axis=1)
    present, pairs = np.isfinite(tdoas.tdoa_s[np.ix_(rows, among)]), tdoas.pairs[among]
    return np.stack([present[:, (pairs == channel).any(axis=1)].any(axis=1) for channel in channels], axis=1)


def session_rejections(session: Session, corners: PoseCorners, tdoas: EmissionTdoas) -> list[Rejection]:
    """Return what was left out before the solve: when it was captured, in the pictures, and in the sound."""
    return [
        *(Rejection("pose", NOT_ACCEPTED, int(row["pose"])) for row in session.poses if not row["accepted"]),
        *(Rejection("pose", why, pose) for pose, why in corners.left_out.items()),
        *_emissions_not_accepted(session),
        *(_heard_badly(session, tdoas.sound) if tdoas.sound is not None else ()),
    ]


def _emissions_not_accepted(session: Session) -> Iterator[Rejection]:
    good = session.poses["pose"][session.poses["accepted"] == 1]
    for number, emission in enumerate(session.emissions):
        if not emission["accepted"] and emission["pose"] in good:
            yield Rejection("emission", NOT_ACCEPTED, int(emission["pose"]), number, int(emission["buzzer"]))


def _heard_badly(session: Session, sound: SoundArrivals) -> Iterator[Rejection]:
    """Name channels that heard nothing, emissions of which too little is left, and single arrivals with a flaw."""
    heard = np.isfinite(sound.arrival_s)
    silent = ~heard.any(axis=0)
    for column in np.flatnonzero(silent):
        flaws = [str(flaw) for flaw in sound.flaws.of_channel(int(column)) if flaw not in HARMLESS]
        yield Rejection("channel", ", ".join(flaws) or "heard no emission", channel=sound.channels[int(column)])
    for row, number in enumerate(sound.rows):
        emission = session.emissions[number]
        where = (int(emission["pose"]), int(number), int(emission["buzzer"]))
        if heard[row].sum() < 2:
            yield Rejection("emission", ", ".join(sound.flaws.of_emission(row)) or "heard by nobody", *where)
            continue
        for column in np.flatnonzero(~heard[row] & ~silent):
            flaws = [str(flaw) for flaw in sound.flaws.of_arrival(row, int(column)) if flaw not in HARMLESS]
            yield Rejection("arrival", ", ".join(flaws) or "not measured", *where, sound.channels[int(column)])


def _most(rejected: NDArray[np.bool_], present: NDArray[np.bool_]) -> bool:
    return bool(rejected.sum() > MOST * present.sum() > 0)


def _share(rejected: NDArray[np.bool_], present: NDArray[np.bool_]) -> str:
    return f"{int(rejected.sum())} of its {int(present.sum())} arrivals do not fit"
