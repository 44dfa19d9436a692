"""A study from its description to its tables, on one screen."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from calib.study.description import PublishedPoses, StudyDescription
from calib.study.errors import EndedError
from calib.study.folder import StudyFolder
from calib.study.part import Part, parts_of, solve_part
from calib.study.published import Published
from calib.study.scene import Scene, cases, make_scene
from calib.study.summary import CaseSummary, summarise, summary_csv
from calib.study.workers import Workers, compute, ended_by_sigterm

QUICK_REPETITIONS = 1


@dataclass(frozen=True)
class FinishedStudy:
    """A study with its results.

    Parameters
    ----------
    folder : StudyFolder
    scenes : dict of int to Scene
        By the number of the case.
    summaries : list of CaseSummary
    quick : bool
        As `quickened`.
    stand_in : bool
        It takes stand-ins for the published poses.
    """

    folder: StudyFolder
    scenes: dict[int, Scene]
    summaries: list[CaseSummary]
    quick: bool
    stand_in: bool


def run_study(
    study: StudyDescription,
    path: Path,
    published: Published,
    workers: Workers,
    console: Console,
    *,
    quick: bool = False,
) -> FinishedStudy:
    """Compute what is not there yet, and put the tables together; `quick`: as `quickened`.

    Raises
    ------
    StudyError, FolderError, DiskError, ClusterError, EndedError
    """
    study = quickened(study) if quick else study
    scenes = [(case, make_scene(study, case, published)) for case in cases(study)]
    parts = parts_of(scenes)
    folder = StudyFolder.open(path, study, scenes, parts)
    by_case = {case.number: scene for case, scene in scenes}
    finished = folder.finished()
    missing = [part for part in parts if part.number not in finished]
    if missing:
        _compute_missing(folder, missing, by_case, workers, console)
    if missing or not (path / "results.csv").exists():
        folder.write_results()
    summaries = summarise(folder)
    folder.write_text("summary.csv", summary_csv(summaries))
    published_poses = any(isinstance(poses, PublishedPoses) for poses in study.pose_sets.values())
    return FinishedStudy(folder, by_case, summaries, quick, published.stand_in and published_poses)


def quickened(study: StudyDescription) -> StudyDescription:
    """Return a study that is over in seconds: one repetition, and three numbers of poses at most."""
    runs = tuple(
        run.model_copy(
            update={
                "n_poses": _some(run.n_poses),
                "repetitions": min(run.repetitions or study.repetitions, QUICK_REPETITIONS),
            }
        )
        for run in study.runs
    )
    return study.model_copy(update={"repetitions": min(study.repetitions, QUICK_REPETITIONS), "runs": runs})


def _some(sizes: tuple[int, ...]) -> tuple[int, ...]:
    """Return the smallest, the largest and one between, in the order given."""
    ordered = sorted(sizes)
    chosen = {ordered[0], ordered[len(ordered) // 2], ordered[-1]} if sizes else set()
    return tuple(size for size in sizes if size in chosen)


def _compute_missing(
    folder: StudyFolder, missing: list[Part], scenes: dict[int, Scene], workers: Workers, console: Console
) -> None:
    total = sum(len(part.repetitions) for part in folder.parts)
    left = sum(len(part.repetitions) for part in missing)
    if left < total:
        console.print(f"Going on: {total - left} of {total} repetitions are there.")
    with _progress(console) as progress:
        bar = progress.add_task(folder.study.name, total=total, completed=total - left)

        def done(index: int, columns: object) -> None:
            folder.write_part(missing[index], columns)  # type: ignore[arg-type]
            progress.advance(bar, len(missing[index].repetitions))

        arguments = [(scenes[part.case.number], part.repetitions) for part in missing]
        try:
            with ended_by_sigterm():
                compute(solve_part, arguments, workers, done)
        except KeyboardInterrupt as error:
            raise EndedError("interrupted: run the same command again to go on; finished parts are kept") from error


def _progress(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("repetitions,"),
        TimeRemainingColumn(),
        TextColumn("left"),
        console=console,
    )
