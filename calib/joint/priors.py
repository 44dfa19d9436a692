"""What is known before anything is measured: how far each shared unknown may be from what the rig description says."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.joint.problem import Priors
from calib.joint.unknowns import Blocks, Unknowns
from rigs.description import Board, Camera, Intrinsics, Medium, RigDescription

FloatArray = NDArray[np.float64]

LATENCY_STD_S = 5e-3  # of a buzzer after the sync output, its filter's delay included
DELAY_STD_S = 1e-3  # where delays are to be found
# Of intrinsics that the rig description gives: lenses move with focus, temperature and every new calibration.
GIVEN_FOCAL_SHARE, GIVEN_PRINCIPAL_SHARE, GIVEN_RADIAL = 0.02, 0.02, 0.1
# Of intrinsics found from the session: hardly a prior, but it keeps what nothing else tells from running away.
FOUND_FOCAL_SHARE, FOUND_PRINCIPAL_SHARE, FOUND_RADIAL = 0.5, 0.2, 1.0
TANGENTIAL = 0.005  # of any lens: its elements are centred to a few hundredths of a millimetre


def described_priors(
    start: Unknowns, description: RigDescription, media: tuple[Medium, ...] = (), *, find_delays: bool = False
) -> Priors:
    """Return what the rig description says of every shared unknown.

    Parameters
    ----------
    start : Unknowns
        What is expected; its last microphone is the one at a known place, where the rig has one.
    description : RigDescription
    media : tuple of Medium
        The air of each session, where there are several.
    find_delays : bool
        Channels may be late after the first one, each by a constant time.
    """
    board, blocks, reference = description.board, start.blocks, description.audio.reference_microphone
    std = np.full(blocks.size, np.inf)
    std[blocks.speed] = [medium.speed_std_m_s() for medium in media or (description.medium,)]
    std[blocks.buzzers] = board.buzzer_std_m
    std[blocks.scale] = board.square_size_std_m / board.square_size_m
    std[blocks.camera] = camera_std(description.camera)
    std[blocks.corners] = np.tile(corner_std_m(board), blocks.n_corners)
    std[blocks.latencies] = LATENCY_STD_S
    std[blocks.delays] = DELAY_STD_S if find_delays else 0.0
    std[blocks.delays][:: blocks.n_mics] = 0.0  # of each session's first channel: only differences can be told
    if reference is not None:
        std[blocks.microphone(blocks.n_mics - 1)] = reference.position_std_m
    return Priors(start.shared, std)


def with_held(priors: Priors, blocks: Blocks, *, hold: tuple[str, ...], exact: tuple[str, ...]) -> Priors:
    """Return the priors with some blocks held at their means, of which the exact ones are without error."""
    held, std = np.zeros(blocks.size, dtype=bool), priors.std.copy()
    for name in {*hold, *exact} - {"poses"}:
        held[_named(blocks, name)] = True
    for name in set(exact) - {"poses"}:
        std[_named(blocks, name)] = 0.0
    return replace(priors, std=std, poses_held="poses" in {*hold, *exact}, held=held)


def n_corners(board: Board) -> int:
    """Return how many corners may be elsewhere than on a perfect board."""
    return math.prod(board.corners) if corner_std_m(board).any() else 0


def corner_std_m(board: Board) -> FloatArray:
    """Return how far corners may be from their places on a perfect board: standard deviations (3,), board frame."""
    return np.array([board.print_std_m, board.print_std_m, board.flatness_std_m])


def camera_std(camera: Camera) -> FloatArray:
    """Return how well intrinsics (9,) are known beforehand."""
    width = camera.size_px[0]
    if isinstance(camera.intrinsics, Intrinsics):
        focal_px = GIVEN_FOCAL_SHARE * np.array(camera.intrinsics.focal_px)
        principal_px, radial = GIVEN_PRINCIPAL_SHARE * width, GIVEN_RADIAL
    else:
        focal_px = np.full(2, FOUND_FOCAL_SHARE * width)
        principal_px, radial = FOUND_PRINCIPAL_SHARE * width, FOUND_RADIAL
    return np.array([*focal_px, *[principal_px] * 2, *[radial] * 2, *[TANGENTIAL] * 2, 0.0])


def _named(blocks: Blocks, name: str) -> slice:
    return {
        "speed": blocks.speed,
        "buzzers": blocks.buzzers,
        "scale": blocks.scale,
        "intrinsics": blocks.camera,
        "corners": blocks.corners,
    }[name]
