"""What is suspected, in words, with what to do about it."""

from __future__ import annotations

import numpy as np

from calib.joint.assemble import nodes
from calib.joint.robust import JointSolution
from calib.joint.suspects import Suspect
from rigs.description import RigDescription


def suspect_doubts(
    suspects: list[Suspect], solution: JointSolution, description: RigDescription, channels: tuple[int, ...]
) -> list[str]:
    """Say of each suspect what the measurements make of it."""
    return [
        *_swapped_buzzers(suspects, solution, description),
        *(_sentence(suspect, solution, description, channels) for suspect in suspects),
    ]


def _sentence(suspect: Suspect, solution: JointSolution, description: RigDescription, channels: tuple[int, ...]) -> str:
    value = solution.at.shared[suspect.where]
    moved = value - solution.problem.priors.mean[suspect.where]
    if suspect.kind == "buzzer":
        place = ", ".join(f"{coordinate:.4f}" for coordinate in value)
        return (
            f"buzzer {description.board.buzzers[suspect.number].id} sounds {1e3 * np.linalg.norm(moved):.1f} mm from "
            f"where board.buzzers has it: the measurements put it at [{place}]; check its place and its wire"
        )
    if suspect.kind == "delay":
        session, number = divmod(suspect.number, solution.at.blocks.n_mics)
        channel, late = nodes(description, channels)[number], "late" if value[0] > 0 else "early"
        return (
            f"channel {channel}{_of_session(solution, session)} is {abs(value[0]) * 1e3:.3f} ms {late}: check that all "
            "channels are sampled together and pass the same filters"
        )
    if suspect.kind == "scale":
        size_mm = 1e3 * description.board.square_size_m * value[0]
        return (
            f"the squares are {size_mm:.3f} mm by the sound, {100 * (value[0] - 1):+.1f} % off board.square_size_m: "
            "was the board printed to scale? Measure over many squares"
        )
    return (
        f"the speed of sound{_of_session(solution, suspect.number)} is {value[0]:.1f} m/s by the measurements, "
        f"{moved[0]:+.1f} m/s from the rig's: check medium in the rig description"
    )


def _of_session(solution: JointSolution, number: int) -> str:
    """Return words for one of several sessions, none for the only one."""
    return f" of session {number + 1}" if solution.at.blocks.n_sessions > 1 else ""


def _swapped_buzzers(suspects: list[Suspect], solution: JointSolution, description: RigDescription) -> list[str]:
    """Say when two buzzers sound from each other's places."""
    buzzers = [suspect for suspect in suspects if suspect.kind == "buzzer"]
    described_m = solution.problem.priors.mean[solution.at.blocks.buzzers].reshape(-1, 3)
    found_m, name = solution.at.buzzers_m, [buzzer.id for buzzer in description.board.buzzers]
    doubts = []
    for row, first in enumerate(buzzers):
        for second in buzzers[row + 1 :]:
            i, j = first.number, second.number
            crossed = max(np.linalg.norm(found_m[i] - described_m[j]), np.linalg.norm(found_m[j] - described_m[i]))
            if crossed < 0.1 * np.linalg.norm(described_m[i] - described_m[j]):
                doubts.append(f"buzzer {name[i]} and {name[j]} look swapped: exchange their places in board.buzzers")
    return doubts
