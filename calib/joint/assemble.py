"""The joint problem of a session, put together from its measurements and its rig description."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.camera import View
from calib.corners import PoseCorners
from calib.emissions import EmissionTdoas
from calib.joint.arrivals import ArrivalTable
from calib.joint.corners import CornerTable
from calib.joint.held import CornerFit
from calib.joint.onsets import OnsetTable
from calib.joint.pairs import arrivals_of_pairs
from calib.joint.priors import described_priors, n_corners, with_held
from calib.joint.problem import JointProblem
from calib.joint.robust import JointSolution
from calib.joint.unknowns import Unknowns
from calib.sound import SoundArrivals
from rigs.board import board_corners_m
from rigs.description import Intrinsics, Medium, RigDescription

FloatArray = NDArray[np.float64]

CORNER_STD_PX = 0.1  # only a first value: the scale is found from the residuals
LEAST_ARRIVAL_STD_S = 1e-8  # corners and poses are no better than that


@dataclass(frozen=True)
class PairTdoas:
    """TDOAs of the emissions whose poses are known, in the order of the poses.

    Parameters
    ----------
    pose, buzzer : (n_emissions,) integer arrays
        The session's number of the pose, and the buzzer's id.
    tdoa_s : (n_emissions, n_pairs) array
    pairs : (n_pairs, 2) integer array
        Microphones, numbered from 0.
    alone : bool
        There are no arrivals but what follows from these.
    """

    pose: NDArray[np.int32]
    buzzer: NDArray[np.int32]
    tdoa_s: FloatArray
    pairs: NDArray[np.int32]
    alone: bool

    def residuals_s(self, solution: JointSolution) -> FloatArray:
        """Return measured minus modelled TDOAs (n_emissions, n_pairs)."""
        times_s = solution.problem.arrivals.flights(solution.at).times_s
        return self.tdoa_s - (times_s[:, self.pairs[:, 1]] - times_s[:, self.pairs[:, 0]])


def pair_tdoas(view: View, tdoas: EmissionTdoas, channels: tuple[int, ...]) -> PairTdoas:
    """Return the TDOAs among some channels."""
    rows = emission_rows(view, tdoas)
    columns = np.flatnonzero(np.isin(tdoas.pairs, channels).all(axis=1))
    number = {channel: row for row, channel in enumerate(channels)}
    numbers = [number[channel] for channel in tdoas.pairs[columns].ravel().tolist()]
    pairs = np.array(numbers, dtype=np.int32).reshape(-1, 2)
    tdoa_s = tdoas.tdoa_s[np.ix_(rows, columns)]
    return PairTdoas(tdoas.pose[rows], tdoas.buzzer[rows], tdoa_s, pairs, tdoas.sound is None)


def assemble(
    description: RigDescription,
    view: View,
    corners: PoseCorners,
    tdoas: EmissionTdoas,
    channels: tuple[int, ...],
    *,
    hold: tuple[str, ...] = (),
    exact: tuple[str, ...] = (),
    find_delays: bool = False,
    ignore_sync: bool = False,
    media: tuple[Medium, ...] = (),
) -> tuple[JointProblem, Unknowns]:
    """Put the joint problem together.

    Parameters
    ----------
    description : RigDescription
    view : View
        Camera and poses to start from.
    corners : PoseCorners
    tdoas : EmissionTdoas
    channels : tuple of int
        Of the microphones to be found.
    hold : tuple of str
        Of "speed", "buzzers", "scale", "corners", "intrinsics" and "poses": held at what the rig description, or
        `view`, says, and as uncertain as that is.
    exact : tuple of str
        Likewise, and known exactly.
    find_delays : bool
        Channels may be late, each by a constant time.
    ignore_sync : bool
        Leave open when emissions began, even where the board's sync output was recorded.
    media : tuple of Medium
        The air of each session, where there are several; `tdoas` says which emission is of which.

    Returns
    -------
    JointProblem, and Unknowns to start from; the microphones to be found are at the origin.
    """
    start = _start(description, view, channels, media)
    table = arrival_table(description, view, tdoas, nodes(description, channels))
    onsets = None if ignore_sync else _onset_table(view, tdoas, table, len(description.board.buzzers))
    if onsets is not None:
        start = start.with_latencies(start.blocks.n_sessions * start.blocks.n_buzzers)
    priors = described_priors(start, description, media, find_delays=find_delays)
    priors = with_held(priors, start.blocks, hold=hold, exact=exact)
    seen = CornerTable(
        board_corners_m(description.board), corners.corners_px[np.isin(corners.pose, view.pose)], CORNER_STD_PX
    )
    fit = None
    if {"intrinsics", "poses"} & {*hold, *exact} and "poses" not in exact:
        fit = CornerFit.of(seen, start, camera_found=view.source == "session")
    return JointProblem(table, None if priors.poses_held else seen, priors, onsets, fit), start


def _start(description: RigDescription, view: View, channels: tuple[int, ...], media: tuple[Medium, ...]) -> Unknowns:
    reference = description.audio.reference_microphone
    known_m = np.array([] if reference is None else reference.position_m, dtype=float).reshape(-1, 3)
    start = Unknowns.of(
        np.vstack([np.zeros((len(channels), 3)), known_m]),
        description.medium.speed_m_s(),
        np.array([buzzer.position_m for buzzer in description.board.buzzers]),
        camera_vector(view.intrinsics),
        view.board_to_camera,
        n_corners(description.board),
    )
    return _in_media(start, media) if media else start


def _onset_table(view: View, tdoas: EmissionTdoas, table: ArrivalTable, n_buzzers: int) -> OnsetTable | None:
    """Return when the emissions of an arrival table began, where the sync output was recorded."""
    if tdoas.sound is None or tdoas.sound.onset_s is None or tdoas.sound.onset_std_s is None:
        return None
    rows = emission_rows(view, tdoas)
    if not np.isfinite(tdoas.sound.onset_s[rows]).any():
        return None
    session = 0 if table.session is None else table.session
    onset_s = tdoas.sound.onset_s[rows] - _about_when_s(tdoas.sound, rows)
    return OnsetTable(onset_s, tdoas.sound.onset_std_s[rows], session * n_buzzers + table.buzzer)


def _in_media(start: Unknowns, media: tuple[Medium, ...]) -> Unknowns:
    several = start.for_sessions(len(media))
    shared = several.shared.copy()
    shared[several.blocks.speed] = [medium.speed_m_s() for medium in media]
    return replace(several, shared=shared)


def nodes(description: RigDescription, channels: tuple[int, ...]) -> tuple[int, ...]:
    """Return the channels of all microphones of the problem: those to be found, then one at a known place, if any."""
    reference = description.audio.reference_microphone
    return channels if reference is None else (*channels, reference.channel)


def arrival_table(
    description: RigDescription, view: View, tdoas: EmissionTdoas, channels: tuple[int, ...]
) -> ArrivalTable:
    """Return the arrivals at some channels of the emissions whose poses are known, in the order of the poses."""
    rows = emission_rows(view, tdoas)
    buzzers = [buzzer.id for buzzer in description.board.buzzers]
    number = np.array([buzzers.index(int(buzzer)) for buzzer in tdoas.buzzer[rows]], dtype=np.intp)
    if tdoas.sound is None:
        chosen = pair_tdoas(view, tdoas, channels)
        arrival_s, std_s, _ = arrivals_of_pairs(chosen.tdoa_s, chosen.pairs, len(channels))
    else:
        columns = np.array([tdoas.sound.channels.index(channel) for channel in channels], dtype=np.intp)
        arrival_s = (tdoas.sound.arrival_s[rows] - _about_when_s(tdoas.sound, rows)[:, None])[:, columns]
        std_s = np.maximum(tdoas.sound.std_s[np.ix_(rows, columns)], LEAST_ARRIVAL_STD_S)
    session = None if tdoas.session is None else tdoas.session[rows]
    return ArrivalTable(np.searchsorted(view.pose, tdoas.pose[rows]), number, arrival_s, std_s, session)


def _about_when_s(sound: SoundArrivals, rows: NDArray[np.intp]) -> FloatArray:
    """Return when some emissions (n,) were first heard; times counted from there keep all their digits in the solve."""
    return np.asarray(np.nan_to_num(np.fmin.reduce(sound.arrival_s[rows], axis=1)))


def emission_rows(view: View, tdoas: EmissionTdoas) -> NDArray[np.intp]:
    """Return the rows of the emissions whose poses are known, in the order of the poses."""
    rows = np.flatnonzero(np.isin(tdoas.pose, view.pose))
    return rows[np.argsort(tdoas.pose[rows], kind="stable")]


def camera_vector(intrinsics: Intrinsics) -> FloatArray:
    """Return intrinsics (9,) in the order of CAMERA_VALUES."""
    return np.array([*intrinsics.focal_px, *intrinsics.principal_px, *intrinsics.distortion])
