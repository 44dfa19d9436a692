"""Normal equations whose poses can be eliminated: a bordered block-diagonal matrix.

    [ A    B_1 .. B_P ] [ shared ]   [ g ]
    [ B_1' C_1        ] [ pose 1 ] = [ h_1 ]
    [ ..        ..    ] [ ..     ]   [ .. ]
    [ B_P'        C_P ] [ pose P ]   [ h_P ]

The Schur complement A - sum_p B_p C_p^-1 B_p' is as large as the shared unknowns alone, so a step costs time in
proportion to the number of poses. Its inverse is the covariance of the shared unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

LEAST_SHARE = 1e-12  # of an unknown's information: keeps what nothing tells from making equations singular


@dataclass(frozen=True)
class NormalEquations:
    """What some measurements say of the unknowns, linearised; sums add up.

    Parameters
    ----------
    shared : (n_shared, n_shared) array
    border : (n_poses, n_shared, 6) array
    poses : (n_poses, 6, 6) array
    shared_gradient : (n_shared,) array
    pose_gradient : (n_poses, 6) array
    cost : float
        Half the weighted sum of squares.
    """

    shared: FloatArray
    border: FloatArray
    poses: FloatArray
    shared_gradient: FloatArray
    pose_gradient: FloatArray
    cost: float

    def __add__(self, other: NormalEquations) -> NormalEquations:
        return NormalEquations(
            self.shared + other.shared,
            self.border + other.border,
            self.poses + other.poses,
            self.shared_gradient + other.shared_gradient,
            self.pose_gradient + other.pose_gradient,
            self.cost + other.cost,
        )

    def spread(self, places: NDArray[np.intp], n_shared: int) -> NormalEquations:
        """Return the equations with the shared unknowns at some places (n,) among more of them."""
        shared, gradient = np.zeros((n_shared, n_shared)), np.zeros(n_shared)
        border = np.zeros((len(self.border), n_shared, self.border.shape[2]))
        shared[np.ix_(places, places)], gradient[places], border[:, places] = (
            self.shared, self.shared_gradient, self.border,
        )  # fmt: skip
        return replace(self, shared=shared, border=border, shared_gradient=gradient)

    def only(self, free: NDArray[np.bool_], *, poses_free: bool) -> NormalEquations:
        """Return the equations of some of the shared unknowns (n_shared,), with the poses or without."""
        n_poses = len(self.poses) if poses_free else 0
        return replace(
            self,
            shared=self.shared[np.ix_(free, free)],
            border=self.border[:n_poses, free],
            poses=self.poses[:n_poses],
            shared_gradient=self.shared_gradient[free],
            pose_gradient=self.pose_gradient[:n_poses],
        )

    def step(self, damping: float) -> tuple[FloatArray, FloatArray]:
        """Return the damped Gauss-Newton step (n_shared,), (n_poses, 6), with Marquardt's scaling.

        Raises
        ------
        numpy.linalg.LinAlgError
            The equations are singular.
        """
        scaled, shared_scale, pose_scale = self._scaled()
        eye = np.eye(6)
        poses = scaled.poses + damping * eye
        solved = np.linalg.solve(poses, np.concatenate([scaled.border.swapaxes(1, 2), scaled.pose_gradient[..., None]],
                                                       axis=2))  # fmt: skip
        by_shared, alone = solved[..., :-1], solved[..., -1]
        complement = scaled.shared + damping * np.eye(len(shared_scale)) - _contracted(scaled.border, by_shared)
        gradient = scaled.shared_gradient - np.einsum("psk,pk->s", scaled.border, alone)
        shared = np.linalg.solve(complement, gradient)
        return shared / shared_scale, (alone - by_shared @ shared) / pose_scale

    def complement(self) -> FloatArray:
        """Return the information (n_shared, n_shared) about the shared unknowns once the poses are eliminated."""
        by_shared = np.asarray(np.linalg.solve(self.poses, self.border.swapaxes(1, 2)), dtype=float)
        return np.asarray(self.shared - _contracted(self.border, by_shared))

    def shares(self, parts: list[NormalEquations]) -> list[float]:
        """Return how many of the unknowns each of some parts of these equations tells: tr(M^-1 N) of a part N.

        That is the trace over the shared unknowns with the poses eliminated, and that over the poses.
        """
        scaled, shared_scale, pose_scale = self._scaled()
        by_pose = np.linalg.inv(scaled.poses + LEAST_SHARE * np.eye(6))
        followed = by_pose @ scaled.border.swapaxes(1, 2)
        complement = scaled.shared + LEAST_SHARE * np.eye(len(shared_scale)) - _contracted(scaled.border, followed)
        by_shared = np.linalg.inv(complement)
        found = []
        for part in parts:
            own = part._over(shared_scale, pose_scale)
            remaining = own.poses @ followed - 2 * own.border.swapaxes(1, 2)
            shared = own.shared + _contracted(followed.swapaxes(1, 2), remaining)
            found.append(float(np.sum(by_shared * shared) + np.sum(by_pose * own.poses)))
        return found

    def _scaled(self) -> tuple[NormalEquations, FloatArray, FloatArray]:
        """Return the equations with ones on the diagonal, and the square roots of what stood there."""
        shared = np.sqrt(np.maximum(np.diag(self.shared), 1e-300))
        poses = np.sqrt(np.maximum(np.diagonal(self.poses, axis1=1, axis2=2), 1e-300))
        return self._over(shared, poses), shared, poses

    def _over(self, shared: FloatArray, poses: FloatArray) -> NormalEquations:
        """Return the equations of the unknowns in other units, which are 1 / `shared` and 1 / `poses` of these."""
        return NormalEquations(
            self.shared / np.outer(shared, shared),
            self.border / (shared[:, None] * poses[:, None, :]),
            self.poses / (poses[:, :, None] * poses[:, None, :]),
            self.shared_gradient / shared,
            self.pose_gradient / poses,
            self.cost,
        )


def _contracted(border: FloatArray, by_shared: FloatArray) -> FloatArray:
    """Return sum_p B_p X_p of (n_poses, n_shared, 6) and (n_poses, 6, n_shared) as one product."""
    n_poses, n_shared, size = border.shape
    left = border.swapaxes(0, 1).reshape(n_shared, n_poses * size)
    return np.asarray(left @ by_shared.reshape(n_poses * size, n_shared))
