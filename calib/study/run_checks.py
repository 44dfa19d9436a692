"""Whether a study's runs can be tried: they name what is there, once each, and ask for what is possible."""

from __future__ import annotations

import difflib
from itertools import product

from calib.study.description import (
    WITH_KNOWN,
    DrawnPoses,
    MeasuredNoise,
    PoseSet,
    PublishedPoses,
    RulerArray,
    Run,
    StudyDescription,
)


def check_runs(study: StudyDescription) -> None:
    """Refuse runs that cannot be tried.

    Raises
    ------
    ValueError
    """
    seen: set[tuple[object, ...]] = set()
    for number, run in enumerate(study.runs):
        where = f"runs[{number}]"
        for section in ("arrays", "boards", "pose_sets", "noises"):
            for name in getattr(run, section):
                _check_known(f"{where}.{section}", name, getattr(study, section))
        _check_methods(where, run, study)
        _check_sizes(where, run, study)
        _check_once(where, run, study, seen)


def _check_known(where: str, name: str, known: dict[str, object]) -> None:
    if name in known:
        return
    near = difflib.get_close_matches(name, known, n=1)
    remedy = f"did you mean {near[0]!r}?" if near else f"known here: {', '.join(known)}"
    raise ValueError(f"{where}: there is no {name!r}: {remedy}")


def _check_methods(where: str, run: Run, study: StudyDescription) -> None:
    needing = [method for method in run.methods if method in WITH_KNOWN]
    if needing and study.known_microphone is None:
        raise ValueError(f"{where}: {needing[0]} needs a known_microphone: add one, or leave the method out")
    measured = any(isinstance(study.noises[name], MeasuredNoise) for name in run.noises)
    fits = all(isinstance(study.arrays[name], RulerArray) for name in run.arrays) and all(
        isinstance(study.pose_sets[name], PublishedPoses) for name in run.pose_sets
    )
    if measured and not fits:
        raise ValueError(f"{where}: measured TDOAs go with the array kind ruler and published poses only")


def _check_sizes(where: str, run: Run, study: StudyDescription) -> None:
    """Refuse subsets larger than their set, and fewer TDOAs than coordinates."""
    for name in run.pose_sets:
        there = _n_poses(study.pose_sets[name])
        if run.n_poses and max(run.n_poses) > there:
            raise ValueError(
                f"{where}.n_poses: {max(run.n_poses)} is more than pose set {name!r} has ({there}): at most {there}"
            )
    for array, board, poses, method in product(run.arrays, run.boards, run.pose_sets, run.methods):
        n_mics, n_buzzers = len(study.arrays[array].places_m()), len(study.boards[board].places_m())
        n_poses = min(run.n_poses, default=_n_poses(study.pose_sets[poses]))
        per_pose = n_buzzers * (n_mics if method in WITH_KNOWN else n_mics - 1)  # those that tell something new
        if n_poses * per_pose < 3 * n_mics:
            needed = -(-3 * n_mics // per_pose)
            raise ValueError(
                f"{where}: array {array!r} with board {board!r} is impossible: {n_poses * per_pose} independent TDOAs "
                f"for {3 * n_mics} coordinates: give at least {needed} poses, or more buzzers"
            )


def _n_poses(poses: PoseSet) -> int:
    from rigs.session.aislab_files import N_POSES  # noqa: PLC0415 (heavy)

    return poses.n_poses if isinstance(poses, DrawnPoses) else N_POSES


def _check_once(where: str, run: Run, study: StudyDescription, seen: set[tuple[object, ...]]) -> None:
    """Refuse what would stand twice in the same cell of a table."""
    starts = run.starts or study.start.drawn
    for tried in product(run.arrays, run.boards, run.pose_sets, run.noises, run.methods, run.n_poses or (None,)):
        if (*tried, starts) in seen:
            shown = ", ".join(str(word) for word in tried if word is not None)
            raise ValueError(f"{where}: {shown} comes twice: give it once")
        seen.add((*tried, starts))
