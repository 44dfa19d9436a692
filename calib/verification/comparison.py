"""Where sounds were located, against where the camera saw their buzzers: errors, and the errors to be expected."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.camera import View
from calib.corners import PoseCorners
from calib.joint.assemble import CORNER_STD_PX, camera_vector
from calib.joint.corners import CornerTable, project
from calib.joint.unknowns import Unknowns, cross_matrices
from calib.verification.location import Located
from rigs.board import board_corners_m
from rigs.description import Board

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Seen:
    """Where the camera saw the buzzers of some emissions.

    Parameters
    ----------
    places_m : (n_emissions, 3) array
        Camera frame, from the board's corners alone.
    covariance_m2 : (n_emissions, 3, 3) array
        From the scatter of the corners and from how well the buzzers' places on the board are known.
    """

    places_m: FloatArray
    covariance_m2: FloatArray


@dataclass(frozen=True)
class Comparison:
    """Errors of located emissions, a value each; NaN where there is no place.

    Parameters
    ----------
    located_px, seen_px : (n_emissions, 2) arrays
    error_px, error_deg, error_m, across_m : (n_emissions,) arrays
        In the picture; as an angle at the camera; in space; and the part of that across the line of sight.
    distance_m : (n_emissions,) array
        From the camera to the buzzer seen.
    expected_px, expected_deg, expected_m : (n_emissions,) arrays
        Root mean square errors that the covariances promise.
    deviation : (n_emissions,) array
        Mahalanobis distance in the picture: its square has the mean 2 where the covariances are right.
    """

    located_px: FloatArray
    seen_px: FloatArray
    error_px: FloatArray
    error_deg: FloatArray
    error_m: FloatArray
    across_m: FloatArray
    distance_m: FloatArray
    expected_px: FloatArray
    expected_deg: FloatArray
    expected_m: FloatArray
    deviation: FloatArray


def see_buzzers(
    view: View, corners: PoseCorners, board: Board, pose: NDArray[np.int32], buzzer: NDArray[np.int32]
) -> Seen:
    """Place the buzzers of some emissions (n,) by the poses of `view`, which must hold all of these."""
    places_m = {one.id: np.array(one.position_m) for one in board.buzzers}
    rows = np.searchsorted(view.pose, pose)
    rotations = np.array([one.rotation for one in view.board_to_camera])[rows]
    translations_m = np.array([one.translation_m for one in view.board_to_camera])[rows]
    arms_m = np.einsum("eij,ej->ei", rotations, np.array([places_m[int(one)] for one in buzzer]))
    by_pose = np.concatenate([-cross_matrices(arms_m), np.broadcast_to(np.eye(3), (len(rows), 3, 3))], axis=2)
    covariance = by_pose @ _pose_covariances(view, corners, board)[rows] @ by_pose.swapaxes(1, 2)
    return Seen(arms_m + translations_m, covariance + board.buzzer_std_m**2 * np.eye(3))


def compare(located: Located, seen: Seen, view: View) -> Comparison:
    """Project both into the picture and measure how far they are apart."""
    camera = camera_vector(view.intrinsics)
    with np.errstate(invalid="ignore"):
        located_px, by_place, _ = project(located.places_m, camera)
    seen_px = project(seen.places_m, camera)[0]
    difference_m = located.places_m - seen.places_m
    distance_m = np.linalg.norm(seen.places_m, axis=1)
    sight = seen.places_m / distance_m[:, None]
    across_m = np.linalg.norm(np.cross(difference_m, sight), axis=1)
    together = located.covariance_m2 + seen.covariance_m2
    aside = np.eye(3) - sight[:, :, None] * sight[:, None]
    covariance_px = by_place @ together @ by_place.swapaxes(1, 2)
    return Comparison(
        located_px=located_px,
        seen_px=seen_px,
        error_px=np.linalg.norm(located_px - seen_px, axis=1),
        error_deg=_angles_deg(located.places_m, seen.places_m),
        error_m=np.linalg.norm(difference_m, axis=1),
        across_m=across_m,
        distance_m=distance_m,
        expected_px=_root_trace(covariance_px),
        expected_deg=np.degrees(_root_trace(aside @ together @ aside) / distance_m),
        expected_m=_root_trace(together),
        deviation=_deviations(located_px - seen_px, covariance_px),
    )


def _pose_covariances(view: View, corners: PoseCorners, board: Board) -> FloatArray:
    """Return the covariances (n_poses, 6, 6) of the poses, turns about the camera's axes first."""
    seen_px = corners.corners_px[np.isin(corners.pose, view.pose)]
    table = CornerTable(board_corners_m(board), seen_px, CORNER_STD_PX)
    buzzers_m = np.array([one.position_m for one in board.buzzers])
    at = Unknowns.of(np.zeros((1, 3)), 340.0, buzzers_m, camera_vector(view.intrinsics), view.board_to_camera)
    residuals_px = table.residuals_px(at)
    n_free = 2 * table.present.sum() - 6 * len(seen_px)
    scatter = float(np.nansum(residuals_px**2)) / max(n_free, 1) / CORNER_STD_PX**2
    return np.asarray(np.linalg.inv(table.normal_equations(at, table.information).poses) * scatter)


def _angles_deg(first: FloatArray, second: FloatArray) -> FloatArray:
    across = np.linalg.norm(np.cross(first, second), axis=1)
    return np.asarray(np.degrees(np.arctan2(across, np.einsum("ei,ei->e", first, second))))


def _root_trace(covariance: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.trace(covariance, axis1=1, axis2=2)))


def _deviations(difference_px: FloatArray, covariance_px2: FloatArray) -> FloatArray:
    out = np.full(len(difference_px), np.nan)
    good = np.isfinite(difference_px).all(axis=1) & np.isfinite(covariance_px2).all(axis=(1, 2))
    solved = np.linalg.solve(covariance_px2[good], difference_px[good][..., None])[..., 0]
    out[good] = np.sqrt(np.einsum("ei,ei->e", difference_px[good], solved))
    return out
