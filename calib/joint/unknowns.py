"""The unknowns of the joint problem, in named blocks.

Most unknowns are shared by all measurements; only a pose of the board belongs to one pose's measurements alone. So
the shared ones stand in one vector, the blocks one after the other, and the poses beside it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rigs.geometry import Pose

FloatArray = NDArray[np.float64]

CAMERA_VALUES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
POSE_SIZE = 6  # rotation vector in radians about the camera's axes, then translation in metres


@dataclass(frozen=True)
class Blocks:
    """Where each block stands in the vector of shared unknowns.

    Parameters
    ----------
    n_mics, n_buzzers : int
    n_corners : int
        Of the board, if their places on it are to be found, else 0.
    n_sessions : int
        Each has its own speed of sound and its own delays; all else is shared.
    n_latencies : int
        Of buzzers after the sync output, where that is used, else 0.
    """

    n_mics: int
    n_buzzers: int
    n_corners: int = 0
    n_sessions: int = 1
    n_latencies: int = 0

    @property
    def microphones(self) -> slice:
        """Three coordinates of each microphone, metres, camera frame."""
        return slice(0, 3 * self.n_mics)

    @property
    def delays(self) -> slice:
        """How late each channel is, seconds, session by session."""
        return slice(3 * self.n_mics, 3 * self.n_mics + self.n_sessions * self.n_mics)

    @property
    def speed(self) -> slice:
        """Speed of sound, m/s, of each session."""
        return slice(self.delays.stop, self.delays.stop + self.n_sessions)

    @property
    def buzzers(self) -> slice:
        """Three coordinates of each buzzer, metres, board frame."""
        return slice(self.speed.stop, self.speed.stop + 3 * self.n_buzzers)

    @property
    def scale(self) -> slice:
        """Side of the printed squares over that of the rig description."""
        return slice(self.buzzers.stop, self.buzzers.stop + 1)

    @property
    def camera(self) -> slice:
        """Intrinsics, in the order of CAMERA_VALUES."""
        return slice(self.scale.stop, self.scale.stop + len(CAMERA_VALUES))

    @property
    def corners(self) -> slice:
        """How far each corner is from its place on a perfect board, three coordinates in metres, board frame."""
        return slice(self.camera.stop, self.camera.stop + 3 * self.n_corners)

    @property
    def latencies(self) -> slice:
        """How late each buzzer sounds after the sync output, seconds, session by session."""
        return slice(self.corners.stop, self.corners.stop + self.n_latencies)

    @property
    def size(self) -> int:
        """Length of the vector."""
        return int(self.latencies.stop)

    def of_session(self, number: int) -> NDArray[np.intp]:
        """Return where the unknowns of one session stand, in the order of a vector of that session alone."""
        places = np.arange(self.size)
        own_delays = self.delays.start + number * self.n_mics + np.arange(self.n_mics)
        before, after = places[self.microphones], places[self.buzzers.start :]
        return np.concatenate([before, own_delays, [self.speed.start + number], after])

    def microphone(self, number: int) -> slice:
        """Return where one microphone stands."""
        return slice(3 * number, 3 * number + 3)

    def buzzer(self, number: int) -> slice:
        """Return where one buzzer stands."""
        return slice(self.buzzers.start + 3 * number, self.buzzers.start + 3 * number + 3)


@dataclass(frozen=True)
class Unknowns:
    """Values of all unknowns.

    Parameters
    ----------
    blocks : Blocks
    shared : (n_shared,) array
        As `blocks` divides it.
    rotations : (n_poses, 3, 3) array
        Of `board_to_camera`.
    translations_m : (n_poses, 3) array
    """

    blocks: Blocks
    shared: FloatArray
    rotations: FloatArray
    translations_m: FloatArray

    @classmethod
    def of(
        cls,
        microphones_m: FloatArray,
        speed_m_s: float,
        buzzers_m: FloatArray,
        camera: FloatArray,
        poses: list[Pose],
        n_corners: int = 0,
    ) -> Unknowns:
        """Put values together; delays are 0, the board is perfect and its scale is 1."""
        blocks = Blocks(len(microphones_m), len(buzzers_m), n_corners)
        delays_s, corners_m = np.zeros(len(microphones_m)), np.zeros(3 * n_corners)
        shared = np.concatenate(
            [microphones_m.ravel(), delays_s, [speed_m_s], buzzers_m.ravel(), [1.0], camera, corners_m]
        )
        rotations = np.array([pose.rotation for pose in poses]).reshape(-1, 3, 3)
        return cls(blocks, shared, rotations, np.array([pose.translation_m for pose in poses]).reshape(-1, 3))

    @property
    def microphones_m(self) -> FloatArray:
        """Places (n_mics, 3) in the camera frame."""
        return self.shared[self.blocks.microphones].reshape(-1, 3)

    @property
    def delays_s(self) -> FloatArray:
        """Delays (n_sessions * n_mics,) of the channels, session by session."""
        return self.shared[self.blocks.delays]

    @property
    def speed_m_s(self) -> float:
        """Speed of sound; of several sessions the mean."""
        return float(self.shared[self.blocks.speed].mean())

    @property
    def buzzers_m(self) -> FloatArray:
        """Places (n_buzzers, 3) in the board frame."""
        return self.shared[self.blocks.buzzers].reshape(-1, 3)

    @property
    def scale(self) -> float:
        """Side of the printed squares over that of the rig description."""
        return float(self.shared[self.blocks.scale][0])

    @property
    def camera(self) -> FloatArray:
        """Intrinsics (9,)."""
        return self.shared[self.blocks.camera]

    @property
    def corners_m(self) -> FloatArray | float:
        """How far each corner (n_corners, 3) is from its place on a perfect board; 0 where that is not to be found."""
        return self.shared[self.blocks.corners].reshape(-1, 3) if self.blocks.n_corners else 0.0

    def moved(self, shared_step: FloatArray, pose_steps: FloatArray) -> Unknowns:
        """Return the unknowns after steps (n_shared,) and (n_poses, 6)."""
        rotations = rotation_matrices(pose_steps[:, :3]) @ self.rotations
        return replace(
            self,
            shared=self.shared + shared_step,
            rotations=rotations,
            translations_m=self.translations_m + pose_steps[:, 3:],
        )

    def placed(self, microphones_m: FloatArray) -> Unknowns:
        """Return the unknowns with the microphones (n_mics, 3) elsewhere."""
        shared = self.shared.copy()
        shared[self.blocks.microphones] = microphones_m.ravel()
        return replace(self, shared=shared)

    def for_sessions(self, n_sessions: int) -> Unknowns:
        """Return the values of one session as those of several."""
        shared = [
            self.shared[self.blocks.microphones],
            np.tile(self.shared[self.blocks.delays], n_sessions),
            np.repeat(self.shared[self.blocks.speed], n_sessions),
            self.shared[self.blocks.buzzers.start :],
        ]
        return replace(self, blocks=replace(self.blocks, n_sessions=n_sessions), shared=np.concatenate(shared))

    def with_latencies(self, n_latencies: int) -> Unknowns:
        """Return the values with latencies of buzzers, all 0."""
        blocks = replace(self.blocks, n_latencies=n_latencies)
        return replace(self, blocks=blocks, shared=np.append(self.shared, np.zeros(n_latencies)))

    def of_session(self, number: int) -> Unknowns:
        """Return the unknowns as those of one session; all poses stay."""
        return replace(
            self, blocks=replace(self.blocks, n_sessions=1), shared=self.shared[self.blocks.of_session(number)]
        )

    def only(self, poses: NDArray[np.bool_]) -> Unknowns:
        """Return the unknowns with some of the poses (n_poses,) only."""
        return replace(self, rotations=self.rotations[poses], translations_m=self.translations_m[poses])


def cross_matrices(vectors: FloatArray) -> FloatArray:
    """Return the matrices (..., 3, 3) that multiply like `vectors` (..., 3) crossed with."""
    out = np.zeros((*vectors.shape, 3))
    x, y, z = np.moveaxis(vectors, -1, 0)
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -z, y, -x
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = z, -y, x
    return out


def rotation_matrices(vectors_rad: FloatArray) -> FloatArray:
    """Turn rotation vectors (n, 3) into matrices (n, 3, 3) by Rodrigues' formula."""
    angle = np.linalg.norm(vectors_rad, axis=1)[:, None, None]
    cross = cross_matrices(vectors_rad)
    half = np.sinc(angle / (2 * np.pi))  # sin(a/2) / (a/2), fine at 0
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * half**2 * cross @ cross)
