"""The order of the channels: whether each hears the buzzers as a microphone at its expected place would."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from acquire.doctor.hearing import Hearing
from acquire.doctor.row import Part, Row, State
from rigs.description import RigDescription
from rigs.geometry import Pose

FloatArray = NDArray[np.float64]
_FEWEST = 3
_BETTER = 0.7
_NEAR_S = 0.0003  # 10 cm: a place measured by eye, a guessed focal length and a coarse onset


def judge_order(hearing: Hearing, description: RigDescription, board_to_camera: Pose | None) -> Iterator[Row]:
    """Name channels that hear as if they were at another one's place; silent where no places are expected.

    Parameters
    ----------
    hearing : Hearing
    description : RigDescription
        With `audio.expected_positions_m`, or there is nothing to tell: at one place of the board, any order of the
        channels is the right one for some array.
    board_to_camera : Pose or None
        Where the board was.
    """
    if description.audio.expected_positions_m is None or board_to_camera is None:
        return
    columns = [k for k in range(len(description.audio.channels)) if hearing.heard()[k].all()]
    if len(columns) < _FEWEST:
        return
    misfit_s = _misfit_s(hearing.onset_s[columns], columns, description, board_to_camera)
    _, best = linear_sum_assignment(misfit_s**2)
    rows = np.arange(len(columns))
    as_said_s, at_best_s = (float(np.sqrt(np.mean(misfit_s[rows, order] ** 2))) for order in (rows, best))
    moved = [hearing.channels[columns[k]] for k in rows[best != rows]]
    yield _verdict(moved, as_said_s, at_best_s, description.medium.speed_m_s())


def _misfit_s(
    onset_s: FloatArray, columns: list[int], description: RigDescription, board_to_camera: Pose
) -> FloatArray:
    """Return how badly (n, n) each channel's onsets (n, n_buzzers) fit each expected place: median over the buzzers.

    When an emission really began does not matter: all times are taken from their mean over the channels.
    """
    places_m = np.array(description.audio.expected_positions_m)[columns]
    buzzers_m = board_to_camera.apply(np.array([buzzer.position_m for buzzer in description.board.buzzers]))
    distance_m = np.linalg.norm(places_m[:, None] - buzzers_m, axis=2)
    expected_s = (distance_m - distance_m.mean(axis=0)) / description.medium.speed_m_s()
    heard_s = onset_s - onset_s.mean(axis=0)
    return np.asarray(np.median(np.abs(heard_s[:, None] - expected_s), axis=2))


def _verdict(moved: list[int], as_said_s: float, at_best_s: float, speed_m_s: float) -> Row:
    off_cm = 100 * speed_m_s * as_said_s
    figures = {"misfit_s": as_said_s, "best_misfit_s": at_best_s}
    if moved and at_best_s < _BETTER * as_said_s:
        finding = f"channels {', '.join(map(str, moved))} hear as if swapped among their expected places"
        remedy = "swap their cables, or correct audio.channels or audio.expected_positions_m"
        return Row(Part.SOUND, "order", State.BAD, finding, remedy, figures)
    if as_said_s > _NEAR_S:
        finding = f"the sound arrives as if the microphones were {off_cm:.0f} cm from their expected places"
        remedy = "check audio.expected_positions_m, and the order and places of the buzzers"
        return Row(Part.SOUND, "order", State.LOOK, finding, remedy, figures)
    finding = f"the channels hear as at their expected places, within {off_cm:.0f} cm"
    return Row(Part.SOUND, "order", State.OK, finding, figures=figures)
