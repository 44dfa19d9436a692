"""The paper's three methods: which TDOAs each takes, and its solve by Gauss-Newton."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.baseline.gauss_newton import draw_start, gauss_newton
from calib.camera import View
from calib.emissions import EmissionTdoas
from calib.errors import MethodError, NotConvergedError, NotEnoughDataError
from calib.problem import Estimate, TdoaProblem
from calib.settings import Settings
from rigs.description import RigDescription

FloatArray = NDArray[np.float64]

# Norm of the last step, as published (arXiv 2502.06196 and its authors' code).
STEP_THRESHOLDS_M = {"ours-1": 1e-3, "ours-2": 1e-4, "ours-3": 1e-3}
MIN_TDOAS = 12
MAX_REACH_M = 20.0  # a microphone further off is a fit at infinity


def microphone_channels(description: RigDescription, settings: Settings) -> tuple[int, ...]:
    """Return the input channels of the microphones to be found.

    Raises
    ------
    MethodError
        A channel named by the settings is not one of the rig's, or too few are left.
    """
    channels = description.audio.channels
    reference = settings.reference_channel
    for channel in (*settings.excluded_channels, *(() if reference is None else (reference,))):
        if channel not in channels:
            raise MethodError(
                f"channel {channel} is not a microphone of this rig: it has {', '.join(map(str, channels))}"
            )
    if reference is not None and settings.method != "ours-1":
        raise MethodError(f"{settings.method} has no reference microphone: leave --reference out, or take ours-1")
    of_joint = settings.holds or settings.find_delays or settings.suggest_poses or settings.ignore_sync
    if settings.method != "joint" and of_joint:
        raise MethodError(
            f"{settings.method} holds all but the microphones: leave --hold, --exact, --find-delays, --ignore-sync and "
            "--suggest-poses to joint"
        )
    if reference in settings.excluded_channels:
        raise MethodError(f"channel {reference} cannot be both the reference and left out")
    left = tuple(channel for channel in channels if channel not in settings.excluded_channels)
    if len(left) < 2:
        raise MethodError("fewer than two microphones are left: leave out fewer channels")
    return left


def make_problem(description: RigDescription, view: View, tdoas: EmissionTdoas, settings: Settings) -> TdoaProblem:
    """Put together the TDOAs that a method uses and the places in the camera frame where the buzzers were.

    Raises
    ------
    MethodError
        The session does not hold the pairs that the method needs.
    """
    channels = microphone_channels(description, settings)
    reference = description.audio.reference_microphone
    known = () if reference is None else (reference.channel,)
    columns = _chosen_pairs(tdoas.pairs, channels, known, settings)
    number = {channel: node for node, channel in enumerate(channels + known)}
    pose_row = {int(pose): row for row, pose in enumerate(view.pose)}
    buzzer_m = {buzzer.id: np.array(buzzer.position_m) for buzzer in description.board.buzzers}
    rows = np.flatnonzero(np.isin(tdoas.pose, view.pose))
    sources_m = [
        view.board_to_camera[pose_row[int(tdoas.pose[row])]].apply(buzzer_m[int(tdoas.buzzer[row])]) for row in rows
    ]
    return TdoaProblem(
        sources_m=np.array(sources_m).reshape(-1, 3),
        pose=tdoas.pose[rows],
        tdoa_s=tdoas.tdoa_s[np.ix_(rows, columns)],
        pairs=np.array([[number[int(i)], number[int(j)]] for i, j in tdoas.pairs[columns]], dtype=np.int32),
        n_mics=len(channels),
        known_m=np.array([] if reference is None else reference.position_m, dtype=float).reshape(-1, 3),
    )


def check_heard(tdoas: EmissionTdoas, channels: tuple[int, ...]) -> None:
    """Refuse a session in which a microphone has hardly any TDOA.

    Raises
    ------
    NotEnoughDataError
        Naming the first such microphone.
    """
    for channel in channels:
        n_tdoas = int(np.isfinite(tdoas.tdoa_s[:, (tdoas.pairs == channel).any(axis=1)]).sum())
        if n_tdoas < MIN_TDOAS:
            raise NotEnoughDataError(
                f"channel {channel} heard no emission well enough ({n_tdoas} TDOAs): check its cable and gain and "
                f"capture again, or leave it out with --exclude-channel {channel}"
            )


def solve(problem: TdoaProblem, description: RigDescription, settings: Settings) -> Estimate:
    """Solve by one of the paper's methods.

    Raises
    ------
    NotConvergedError
    """
    box, speed_m_s = description.calibration.start_box_m, description.medium.speed_m_s()
    drawn_m = draw_start(problem.n_mics, np.array(box.low_m), np.array(box.high_m), settings.seed)
    run = gauss_newton(problem, Estimate(drawn_m, speed_m_s), STEP_THRESHOLDS_M[settings.method])
    if not run.converged or np.abs(run.estimate.microphones_m).max() > MAX_REACH_M:
        raise NotConvergedError(
            f"{settings.method}: Gauss-Newton did not settle, or ran away, from the first guess of seed "
            f"{settings.seed}: try another --seed, or --method joint, which needs no first guess"
        )
    return run.estimate


def refit(problem: TdoaProblem, estimate: Estimate, speed_m_s: float, settings: Settings) -> Estimate:
    """Solve a slightly different problem again, from an estimate."""
    start = Estimate(estimate.microphones_m, speed_m_s)
    return gauss_newton(problem, start, STEP_THRESHOLDS_M[settings.method]).estimate


def _chosen_pairs(
    pairs: NDArray[np.int32], channels: tuple[int, ...], known: tuple[int, ...], settings: Settings
) -> NDArray[np.intp]:
    """Return the columns of the pairs that the method uses."""
    among = np.isin(pairs, channels).all(axis=1)
    with_known = np.isin(pairs, channels).any(axis=1) & np.isin(pairs, known).any(axis=1)
    reference = channels[0] if settings.reference_channel is None else settings.reference_channel
    n_mics = len(channels)
    chosen, needed = {
        "ours-1": (among & (pairs == reference).any(axis=1), n_mics - 1),
        "ours-2": (among, n_mics * (n_mics - 1) // 2),
        "ours-3": (with_known, n_mics),
    }[settings.method]
    if settings.method == "ours-3" and not known:
        raise MethodError(
            "ours-3 needs a microphone at a known place, and this session has none: capture with "
            "audio.reference_microphone in the rig description, or import with --problem 8"
        )
    if int(chosen.sum()) < needed:
        raise MethodError(
            f"{settings.method} needs {needed} pairs of microphones, the session has {int(chosen.sum())} that fit: "
            "choose another --method or --reference, or import other measurements"
        )
    return np.flatnonzero(chosen)
