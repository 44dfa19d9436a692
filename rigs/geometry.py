"""Frames and poses, said once.

Camera frame: OpenCV's, in metres; x right, y down, z forward, origin at the optical centre.
Board frame: in metres; origin at the first inner corner, x along a row of corners, y along a column
towards the next row, z = x cross y (so away from a camera that sees the board the right way round).
A pose is `board_to_camera`: it maps points of the board frame to the camera frame, `p_camera = R p_board + t`.
TDOA_ij is the arrival at microphone j minus the arrival at microphone i, in seconds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

CAMERA_FRAME = "camera: OpenCV's, x right, y down, z forward, metres"
TDOA_SIGN = "tdoa_ij = arrival at microphone j minus arrival at microphone i, seconds"


@dataclass(frozen=True)
class Pose:
    """A rigid map of points, `p_to = rotation @ p_from + translation_m`.

    Parameters
    ----------
    rotation : (3, 3) array
        Proper rotation matrix.
    translation_m : (3,) array
        Translation in metres.
    """

    rotation: FloatArray
    translation_m: FloatArray

    @classmethod
    def from_rotation_vector(cls, rotation_vector_rad: FloatArray, translation_m: FloatArray) -> Pose:
        """Make a pose from an axis times angle (3,) in radians and a translation (3,) in metres."""
        return cls(rotation_matrix(rotation_vector_rad), np.asarray(translation_m, dtype=float).reshape(3))

    def matrix(self) -> FloatArray:
        """Return the homogeneous (4, 4) matrix."""
        out = np.eye(4)
        out[:3, :3] = self.rotation
        out[:3, 3] = self.translation_m
        return out

    def apply(self, points_m: FloatArray) -> FloatArray:
        """Map points (..., 3) in metres."""
        return np.asarray(points_m @ self.rotation.T + self.translation_m)


def rotation_matrix(rotation_vector_rad: FloatArray) -> FloatArray:
    """Turn axis times angle (3,) in radians into a (3, 3) rotation matrix (Rodrigues' formula)."""
    vector = np.asarray(rotation_vector_rad, dtype=float).reshape(3)
    angle = float(np.linalg.norm(vector))
    cross = np.array([[0, -vector[2], vector[1]], [vector[2], 0, -vector[0]], [-vector[1], vector[0], 0]])
    if angle < 1e-8:  # second order series: the closed form divides by the angle
        return np.asarray(np.eye(3) + cross + cross @ cross / 2)
    return np.asarray(np.eye(3) + np.sin(angle) / angle * cross + (1 - np.cos(angle)) / angle**2 * cross @ cross)


def rigid_alignment(points_m: FloatArray, target_m: FloatArray) -> Pose:
    """Find the rigid pose that best maps points onto targets, both (n, 3), in least squares.

    Source: W. Kabsch, Acta Cryst. A32 (1976) 922, doi:10.1107/S0567739476001873.
    """
    centre, target_centre = points_m.mean(axis=0), target_m.mean(axis=0)
    u, _, vt = np.linalg.svd((points_m - centre).T @ (target_m - target_centre))
    handedness = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    rotation = vt.T @ handedness @ u.T
    return Pose(rotation, target_centre - rotation @ centre)


def pair_distances(points_m: FloatArray) -> FloatArray:
    """Return the n(n-1)/2 distances in metres between points (n, 3), in the order (0,1), (0,2) ... (n-2,n-1)."""
    first, second = np.triu_indices(len(points_m), k=1)
    return np.asarray(np.linalg.norm(points_m[first] - points_m[second], axis=1))
