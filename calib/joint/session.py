"""The joint method on the measurements of a session."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.answer import Answer
from calib.camera import View
from calib.corners import PoseCorners
from calib.doubts import fit_doubts
from calib.emissions import EmissionTdoas
from calib.errors import NotEnoughDataError
from calib.fit import FittedTdoas, robust_sigma
from calib.joint.assemble import PairTdoas, assemble, nodes, pair_tdoas
from calib.joint.heldout import hold_out
from calib.joint.next_pose import suggest_poses
from calib.joint.observability import board_tilts_deg, observability_doubts
from calib.joint.pairs import arrivals_that_agree
from calib.joint.robust import JointSolution, solve_robustly
from calib.joint.start import SAME_BASIN_M, find_start
from calib.joint.suspects import find_suspects
from calib.joint.suspicion import suspect_doubts
from calib.joint.uncertainty import microphone_covariances, microphone_rms_m, shared_covariance
from calib.settings import Settings
from rigs.description import Intrinsics, RigDescription
from rigs.geometry import Pose

FloatArray = NDArray[np.float64]

PAIR_SIGMAS = 4.5
MAX_STD_M = 0.05  # of the microphones, root mean square: more is no answer
MAX_REACH_M = 10.0  # a microphone further off is a fit at infinity


def answer_jointly(
    description: RigDescription,
    view: View,
    corners: PoseCorners,
    tdoas: EmissionTdoas,
    channels: tuple[int, ...],
    settings: Settings,
) -> Answer:
    """Find the microphones along with everything that is not known exactly.

    Raises
    ------
    NotEnoughDataError, NotConvergedError
    """
    problem, guess = assemble(
        description, view, corners, tdoas, channels, hold=settings.hold, find_delays=settings.find_delays
    )
    start = find_start(problem, guess, settings.seed)
    solution, suspects = find_suspects(solve_robustly(problem, start.at))
    chosen = pair_tdoas(view, tdoas, nodes(description, channels))
    if chosen.alone:
        solution = _with_pairs_that_fit(solution, chosen)
    covariance = shared_covariance(problem, solution.at, solution.weights())
    _check_determined(solution, covariance, len(channels))
    fitted = _fitted_tdoas(solution, chosen)
    at = solution.at
    return Answer(
        microphones_m=at.microphones_m[: len(channels)],
        covariance_m2=microphone_covariances(covariance, len(channels)),
        speed_of_sound_m_s=at.speed_m_s,
        speed_of_sound_std_m_s=float(np.sqrt(covariance[at.blocks.speed, at.blocks.speed][0, 0])),
        view=refined_view(view, solution),
        residual=fitted.residual(),
        warnings=[
            *_rival_doubts(start.at.microphones_m, start.rival_m, channels),
            *suspect_doubts(suspects, solution, description, channels),
            *fit_doubts(description, fitted),
            *observability_doubts(solution, covariance, description.camera, channels),
        ],
        held_out=hold_out(solution, chosen),
        suggestions=_suggestions(solution, description, len(channels), settings.suggest_poses),
        array_covariance_m2=covariance[: 3 * len(channels), : 3 * len(channels)],
    )


def refined_view(view: View, solution: JointSolution) -> View:
    """Return the camera and the poses as the solution has them."""
    at, corners = solution.at, solution.problem.corners
    if corners is None:
        return view
    fx, fy, cx, cy, *distortion = (float(value) for value in at.camera)
    intrinsics = Intrinsics(focal_px=(fx, fy), principal_px=(cx, cy), distortion=tuple(distortion))
    poses = [Pose(rotation, place) for rotation, place in zip(at.rotations, at.translations_m, strict=True)]
    rms_px = float(np.sqrt(np.nanmean(np.sum(corners.residuals_px(at) ** 2, axis=2))))
    return View(intrinsics, view.source, view.pose, poses, rms_px)


def _check_determined(solution: JointSolution, covariance: FloatArray, n_mics: int) -> None:
    """Refuse an answer that is none: a clear statement is worth more than wild places.

    Raises
    ------
    NotEnoughDataError
    """
    rms_m = microphone_rms_m(covariance, n_mics)
    far_m = float(np.abs(solution.at.microphones_m[:n_mics]).max())
    if rms_m > MAX_STD_M or far_m > MAX_REACH_M:
        most, least = board_tilts_deg(solution.at.rotations)
        raise NotEnoughDataError(
            f"the session does not place the microphones: they are uncertain by {1e3 * rms_m:.0f} mm and up to "
            f"{far_m:.1f} m away, with boards tilted by {most:.0f} and {least:.0f} degrees: capture more poses, "
            "tilted by 30 degrees both ways about both axes and at several distances"
        )


def _suggestions(solution: JointSolution, description: RigDescription, n_mics: int, n_poses: int) -> list[str]:
    if not n_poses:
        return []
    now_m, suggestions = suggest_poses(solution, description.camera.size_px, n_mics, n_poses)
    return [f"{suggestion.sentence()} (now {1e3 * now_m:.2f} mm)" for suggestion in suggestions]


def _with_pairs_that_fit(solution: JointSolution, chosen: PairTdoas) -> JointSolution:
    """Solve again on arrivals from the pairs that fit: geometry tells more of them apart than closure does."""
    residuals_s = chosen.residuals_s(solution)
    agree = np.nan_to_num(np.abs(residuals_s), nan=np.inf) < PAIR_SIGMAS * robust_sigma(residuals_s)
    n_mics = solution.at.blocks.n_mics
    arrival_s, std_s = arrivals_that_agree(chosen.tdoa_s, chosen.pairs, n_mics, agree)
    problem = solution.problem
    problem = replace(problem, arrivals=replace(problem.arrivals, arrival_s=arrival_s, std_s=std_s))
    return solve_robustly(problem, solution.at)


def _fitted_tdoas(solution: JointSolution, chosen: PairTdoas) -> FittedTdoas:
    """Return the TDOAs, and which of them the solution rests on."""
    residuals_s, (first, second) = chosen.residuals_s(solution), chosen.pairs.T
    used = solution.used_arrivals[:, first] & solution.used_arrivals[:, second] & np.isfinite(residuals_s)
    if chosen.alone:
        used &= np.nan_to_num(np.abs(residuals_s), nan=np.inf) < PAIR_SIGMAS * robust_sigma(residuals_s)
    return FittedTdoas(chosen.pose, chosen.buzzer, residuals_s, used, solution.at.speed_m_s)


def _rival_doubts(chosen_m: FloatArray, rival_m: FloatArray | None, channels: tuple[int, ...]) -> list[str]:
    """Say when microphones fit nearly as well elsewhere."""
    if rival_m is None:
        return []
    apart_m = np.linalg.norm(rival_m - chosen_m, axis=1)[: len(channels)]
    moved = [str(channel) for channel, length_m in zip(channels, apart_m, strict=True) if length_m > SAME_BASIN_M]
    doubt = (
        f"the arrivals fit nearly as well with channel {' and '.join(moved)} up to {1e3 * apart_m.max():.0f} mm "
        "elsewhere, as in a mirror: capture poses at other depths and tilted both ways"
    )
    return [doubt]
