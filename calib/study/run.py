"""A study from its description to its tables, on one screen."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from calib.study.description import PublishedPoses, StudyDescription
from calib.study.folder import StudyFolder
from calib.study.part import Part, parts_of, solve_part
from calib.study.published import Published
from calib.study.scene import Scene, cases, make_scene
from calib.study.summary import CaseSummary, summarise, summary_csv
from calib.study.workers import Workers, compute

QUICK_REPETITIONS, QUICK_SIZES = 1, 2


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
        A few repetitions only.
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
    """Compute what is not there yet, and put the tables together; `quick`: with a few repetitions only.

    Raises
    ------
    StudyError, FolderError, DiskError, ClusterError
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
    """Return a study that is over in seconds: a few repetitions, a few numbers of poses."""
    runs = tuple(
        run.model_copy(
            update={
                "n_poses": run.n_poses[:: max(len(run.n_poses) // QUICK_SIZES, 1)],
                "repetitions": min(run.repetitions or study.repetitions, QUICK_REPETITIONS),
            }
        )
        for run in study.runs
    )
    return study.model_copy(update={"repetitions": min(study.repetitions, QUICK_REPETITIONS), "runs": runs})


def _compute_missing(
    folder: StudyFolder, missing: list[Part], scenes: dict[int, Scene], workers: Workers, console: Console
) -> None:
    total = sum(len(part.repetitions) for part in folder.parts)
    left = sum(len(part.repetitions) for part in missing)
    with _progress(console) as progress:
        bar = progress.add_task(folder.study.name, total=total, completed=total - left)

        def done(index: int, columns: object) -> None:
            folder.write_part(missing[index], columns)  # type: ignore[arg-type]
            progress.advance(bar, len(missing[index].repetitions))

        compute(solve_part, [(scenes[part.case.number], part.repetitions) for part in missing], workers, done)


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
