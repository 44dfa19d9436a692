"""One case of a study in numbers: what is true, and how it is measured. Small enough to be sent to a worker."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from calib.study.description import (
    DrawnPoses,
    KnownMicrophone,
    MeasuredNoise,
    MethodName,
    Noise,
    Start,
    StudyDescription,
)
from calib.study.errors import StudyError
from calib.study.published import Published, drawn_poses
from rigs.geometry import Pose

FloatArray = NDArray[np.float64]
N_TDOAS = {"ours-1": 7, "ours-2": 28, "joint": 28}  # of the published measurements; the others take 8


@dataclass(frozen=True)
class Case:
    """One cell of a study, by name.

    Parameters
    ----------
    number : int
        Counted from 0 in the order of the description.
    situation : int
        Cases that differ in board and method only share it, and so their draws.
    array, board, pose_set, noise : str
    n_poses : int or None
        Size of random subsets; None: all poses.
    method : str
    n_repetitions : int
    starts : str
        When first guesses are drawn: "once" or "each repetition".
    """

    number: int
    situation: int
    array: str
    board: str
    pose_set: str
    n_poses: int | None
    noise: str
    method: MethodName
    n_repetitions: int
    starts: str


@dataclass(frozen=True)
class Scene:
    """A case in numbers.

    Parameters
    ----------
    seed, situation : int
        What the draws come from.
    method : str
    microphones_m : (n_mics, 3) array
        True places, camera frame.
    buzzers_m : (n_buzzers, 3) array
        Where the board has them.
    rotations, translations_m : (n_poses, 3, 3) and (n_poses, 3) arrays
        Of `board_to_camera`.
    known_m : (1, 3) array or None
    speed_m_s : float
    noise : Noise
    measured_s : (n_emissions, n_tdoas) array or None
        TDOAs where they are not simulated.
    n_subset : int or None
        Poses in a random subset, drawn for each repetition.
    start : Start
    search_judged_in : str
    """

    seed: int
    situation: int
    method: MethodName
    microphones_m: FloatArray
    buzzers_m: FloatArray
    rotations: FloatArray
    translations_m: FloatArray
    known_m: FloatArray | None
    speed_m_s: float
    noise: Noise
    measured_s: FloatArray | None
    n_subset: int | None
    start: Start
    search_judged_in: str

    @property
    def n_emissions(self) -> int:
        """Emissions of one repetition."""
        n_poses = len(self.rotations) if self.n_subset is None else self.n_subset
        return n_poses * len(self.buzzers_m)


def cases(study: StudyDescription) -> list[Case]:
    """Return all cases of a study, in order."""
    found: list[Case] = []
    situations: dict[tuple[str, str, int | None, str], int] = {}
    for run in study.runs:
        sizes: tuple[int | None, ...] = run.n_poses or (None,)
        for array, board, poses, n_poses, noise, method in product(
            run.arrays, run.boards, run.pose_sets, sizes, run.noises, run.methods
        ):
            situation = situations.setdefault((array, poses, n_poses, noise), len(situations))
            n = run.repetitions or study.repetitions
            starts = run.starts or study.start.drawn
            found.append(Case(len(found), situation, array, board, poses, n_poses, noise, method, n, starts))
    return found


def make_scene(study: StudyDescription, case: Case, published: Published) -> Scene:
    """Put a case into numbers.

    Raises
    ------
    StudyError
        It needs what is not there.
    """
    wanted = study.pose_sets[case.pose_set]
    poses = drawn_poses(wanted) if isinstance(wanted, DrawnPoses) else published.poses
    noise = study.noises[case.noise]
    measured_s = None
    if isinstance(noise, MeasuredNoise):
        if published.stand_in:
            raise StudyError(f"{study.name} needs the published measurements: give their folder with --published")
        measured_s = published.tdoa_s[N_TDOAS.get(case.method, 8)]
    return Scene(
        seed=study.seed,
        situation=case.situation,
        method=case.method,
        microphones_m=np.array(study.arrays[case.array].places_m()),
        buzzers_m=np.array(study.boards[case.board].places_m()),
        rotations=np.array([pose.rotation for pose in poses]),
        translations_m=np.array([pose.translation_m for pose in poses]),
        known_m=_known_place(study.known_microphone, poses[0]),
        speed_m_s=study.speed_of_sound_m_s,
        noise=noise,
        measured_s=measured_s,
        n_subset=case.n_poses,
        start=study.start.model_copy(update={"drawn": case.starts}),
        search_judged_in=study.search_judged_in,
    )


def _known_place(known: KnownMicrophone | None, first_pose: Pose) -> FloatArray | None:
    if known is None:
        return None
    if known.position_m is not None:
        return np.array([known.position_m])
    return first_pose.apply(np.array([known.on_board_m]))
