"""The joint method on the measurements of a session."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.answer import Answer
from calib.camera import View
from calib.corners import PoseCorners
from calib.doubts import fit_doubts
from calib.emissions import EmissionTdoas
from calib.errors import NotConvergedError
from calib.evidence import Evidence, arrivals_of_differences
from calib.fit import FittedTdoas, robust_sigma
from calib.joint.assemble import PairTdoas, assemble, emission_rows, nodes, pair_tdoas
from calib.joint.bias import without_bias
from calib.joint.continuation import Continuation
from calib.joint.contradictions import check_held_intrinsics, check_suspects
from calib.joint.heldout import hold_out
from calib.joint.next_pose import Suggestion, suggest_poses
from calib.joint.observability import observability_doubts, weakest_motion
from calib.joint.pairs import arrivals_that_agree
from calib.joint.priors import camera_std
from calib.joint.problem import JointProblem
from calib.joint.refusal import check_determined
from calib.joint.robust import JointSolution, solve_robustly
from calib.joint.start import SAME_BASIN_M, find_start
from calib.joint.strays import stray_doubts
from calib.joint.suspects import find_suspects
from calib.joint.suspicion import suspect_doubts
from calib.joint.threads import on_one_thread
from calib.joint.uncertainty import microphone_rms_m, shared_covariance
from calib.joint.unknowns import Unknowns
from calib.rejections import Rejection, solve_rejections
from calib.result import ChannelDelays
from calib.settings import Settings
from rigs.description import Intrinsics, Medium, RigDescription
from rigs.geometry import Pose

FloatArray = NDArray[np.float64]

PAIR_SIGMAS = 4.5
BIASED_STD_M = 0.005  # of the microphones, root mean square: below, the bias is nothing beside it
WORSE = 2.0  # times the scatter of an earlier solve: then that was in a wrong place


@on_one_thread
def answer_jointly(
    description: RigDescription,
    view: View,
    corners: PoseCorners,
    tdoas: EmissionTdoas,
    channels: tuple[int, ...],
    settings: Settings,
    *,
    before: Continuation | None = None,
    is_last: bool = True,
    media: tuple[Medium, ...] = (),
) -> Answer:
    """Find the microphones along with everything that is not known exactly.

    Parameters
    ----------
    description : RigDescription
    view : View
    corners : PoseCorners
    tdoas : EmissionTdoas
    channels : tuple of int
    settings : Settings
    before : Continuation or None
        Where to start; None: from nothing.
    is_last : bool
        Not, where more poses are coming: then nothing is held out.
    media : tuple of Medium
        The air of each session, where there are several.

    Raises
    ------
    NotEnoughDataError, NotConvergedError
    """

    def posed(hold: tuple[str, ...], exact: tuple[str, ...]) -> tuple[JointProblem, Unknowns]:
        return assemble(
            description, view, corners, tdoas, channels, hold=hold, exact=exact,
            find_delays=settings.find_delays, ignore_sync=settings.ignore_sync, media=media,
        )  # fmt: skip

    problem, guess = posed(settings.hold, settings.exact)
    solution, rival_m = _solved(problem, guess, view, settings, before)
    check_held_intrinsics(solution, camera_std(description.camera))
    solution, suspects = find_suspects(solution)
    doubts = suspect_doubts(suspects, solution, description, channels)
    check_suspects(suspects, doubts)
    chosen = pair_tdoas(view, tdoas, nodes(description, channels))
    solution, covariance = _refined(solution, chosen, len(channels))
    strays = stray_doubts(solution, posed((), ())[0]) if settings.holds else []
    doubts = [*_rival_doubts(solution.at.microphones_m, rival_m, channels), *strays, *doubts]
    fitted = replace(_fitted_tdoas(solution, chosen), pose_names=tdoas.pose_names)
    return replace(
        _plain_answer(solution, covariance, view, fitted, len(channels)),
        warnings=[
            *doubts,
            *fit_doubts(description, fitted),
            *observability_doubts(solution, covariance, description.camera, channels),
        ],
        held_out=hold_out(solution, chosen) if is_last else None,
        delays=_delays(solution.at, covariance, len(channels)) if settings.find_delays else None,
        suggestions=_suggestions(solution, description, len(channels), settings.suggest_poses),
        rejections=[
            *_poses_without_place(view, corners, tdoas),
            *solve_rejections(solution, tdoas, emission_rows(view, tdoas), nodes(description, channels)),
        ],
        evidence=_evidence(solution, chosen, corners.only(np.isin(corners.pose, view.pose)), len(channels)),
    )


def _solved(
    problem: JointProblem, guess: Unknowns, view: View, settings: Settings, before: Continuation | None
) -> tuple[JointSolution, FloatArray | None]:
    """Solve, near an earlier solution if that still fits; return another place that fits nearly as well, too."""
    if before is not None and before.fits(guess):
        with suppress(NotConvergedError):  # it may from nothing
            solution = solve_robustly(problem, before.start(problem, guess, view.pose))
            if solution.scales.arrivals < WORSE * before.scale:
                return solution, None
    start = find_start(problem, guess, settings.seed)
    return solve_robustly(problem, start.at), start.rival_m


def _refined(solution: JointSolution, chosen: PairTdoas, n_mics: int) -> tuple[JointSolution, FloatArray]:
    """Return the solution on the pairs that fit, without its bias, and the covariance of what all poses share."""
    if chosen.alone:
        solution = _with_pairs_that_fit(solution, chosen)
    covariance = shared_covariance(solution.problem, solution.at, solution.weights())
    check_determined(solution, covariance, n_mics)
    if solution.problem.onsets is None and microphone_rms_m(covariance, n_mics) > BIASED_STD_M:
        solution = replace(solution, at=without_bias(solution.problem, solution.at, solution.weights()))
    return solution, covariance


def _plain_answer(
    solution: JointSolution, covariance: FloatArray, view: View, fitted: FittedTdoas, n_mics: int
) -> Answer:
    """Return what came out, without judging it."""
    at = solution.at
    speed_variances = np.diag(covariance)[at.blocks.speed]
    return Answer(
        microphones_m=at.microphones_m[:n_mics],
        array_covariance_m2=covariance[: 3 * n_mics, : 3 * n_mics],
        speed_of_sound_m_s=at.speed_m_s,
        speed_of_sound_std_m_s=float(np.sqrt(speed_variances.mean())),
        view=refined_view(view, solution),
        residual=fitted.residual(),
        weakest=weakest_motion(solution, covariance, n_mics),
        continuation=Continuation(at, view.pose, solution.scales.arrivals),
        speeds_m_s=tuple(at.shared[at.blocks.speed].tolist()),
        speed_stds_m_s=tuple(np.sqrt(speed_variances).tolist()),
    )


def _delays(at: Unknowns, covariance: FloatArray, n_mics: int) -> ChannelDelays:
    std_s = np.sqrt(np.diag(covariance)[at.blocks.delays])
    shape = at.blocks.n_sessions, at.blocks.n_mics
    return ChannelDelays(at.delays_s.reshape(shape)[:, :n_mics], std_s.reshape(shape)[:, :n_mics])


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


def _evidence(solution: JointSolution, chosen: PairTdoas, corners: PoseCorners, n_mics: int) -> Evidence:
    at, table = solution.at, solution.problem.corners
    seen_px = corners.corners_px
    residuals_s = solution.residuals_s()
    if chosen.alone:
        residuals_s = _with_arrivals_of_rejected_pairs(residuals_s, solution, chosen)
    return Evidence(
        pose=chosen.pose,
        buzzer=chosen.buzzer,
        residuals_s=residuals_s[:, :n_mics],
        used=solution.used_arrivals[:, :n_mics],
        distances_m=solution.problem.arrivals.flights(at).distances_m[:, :n_mics],
        corners_px=seen_px,
        corner_residuals_px=np.full_like(seen_px, np.nan) if table is None else table.residuals_px(at),
    )


def _with_arrivals_of_rejected_pairs(residuals_s: FloatArray, solution: JointSolution, chosen: PairTdoas) -> FloatArray:
    """Fill in what became of no arrival, since its pairs were rejected before."""
    by_pairs_s = arrivals_of_differences(chosen.residuals_s(solution), chosen.pairs, solution.at.blocks.n_mics)
    fitting = np.where(np.isfinite(residuals_s), by_pairs_s, np.nan)
    present = np.isfinite(fitting)
    centre_s = np.where(present, fitting, 0.0).sum(axis=1) / np.maximum(present.sum(axis=1), 1)
    return np.where(np.isfinite(residuals_s), residuals_s, by_pairs_s - centre_s[:, None])


def _poses_without_place(view: View, corners: PoseCorners, tdoas: EmissionTdoas) -> list[Rejection]:
    lost = np.setdiff1d(corners.pose, view.pose).tolist()
    return [
        Rejection("pose", "no place of the board fits its corners", tdoas.pose_names.get(pose, pose)) for pose in lost
    ]


def _suggestions(solution: JointSolution, description: RigDescription, n_mics: int, n_poses: int) -> list[Suggestion]:
    if not n_poses:
        return []
    problem = replace(solution.problem, priors=replace(solution.problem.priors, held=False))
    return suggest_poses(replace(solution, problem=problem), description.camera.size_px, n_mics, n_poses)[1]


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
