"""The paper's tables and figures: which studies they are made of, and the pages that show them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.markdown import Markdown
from rich.markup import escape

from calib.study.errors import StudyError
from calib.study.library import find_study
from calib.study.pages import parameters_page, study_page, terminal_page
from calib.study.plots import draw_study
from calib.study.published import Published
from calib.study.run import FinishedStudy, quickened, run_study
from calib.study.workers import Workers

STUDY_OF = {"table1": "table2", "table2": "table2", "table3": "table3", "fig3": "table3", "fig4": "fig4"}
MEASURED = ("table3", "fig3", "fig4")  # made of the published measurements, so not without them
STAND_IN = "! without --published the paper's 69 poses are stand-ins, drawn at random: figures differ from the paper's"
LEFT_OUT = (
    "! table3, fig3 and fig4 are left out: they need the published measurements, give their folder with --published"
)


def make_items(
    items: Sequence[str],
    protocols: Sequence[str],
    output: Path,
    quick: bool,
    published: Published,
    workers: Workers,
    console: Console,
    *,
    all_of_them: bool,
) -> None:
    """Run the studies of some of the paper's items, and write their pages.

    Raises
    ------
    StudyError, FolderError, DiskError, ClusterError
    """
    if published.stand_in and list(items) != ["table1"]:
        items = _without_measurements(items, console, all_of_them)
    done: dict[str, FinishedStudy] = {}
    pages: list[str] = []
    for item in items:
        names = [f"{STUDY_OF[item]}-{protocol}" for protocol in protocols]
        if item == "table1":
            pages.append(parameters_page([find_study(name) for name in names]))
            continue
        for name in names:
            if name in done:
                continue
            study = quickened(find_study(name)) if quick else find_study(name)
            done[name] = run_study(study, output / name, published, workers, console)
            pages.append(finish(done[name], console, STUDY_OF[item]))
    output.mkdir(parents=True, exist_ok=True)
    page = output / ("report.md" if all_of_them else f"{items[0]}.md")
    page.write_text("\n".join(pages), encoding="utf-8")
    if items[0] == "table1" and not all_of_them:
        console.print(Markdown(pages[0]))
    console.print(f"[bold]Written:[/bold] {escape(str(page))}", soft_wrap=True)


def finish(finished: FinishedStudy, console: Console, item: str | None = None) -> str:
    """Write and print the page of a study, and draw its figures; return the page."""
    page = study_page(finished, item)
    figures = draw_study(finished, item)
    page += "\n".join(f"![{path.stem}]({finished.folder.path.name}/{path.name})" for path in figures) + "\n"
    finished.folder.write_text("page.md", page.replace(f"({finished.folder.path.name}/", "("))
    console.print(Markdown(terminal_page(finished, item)))
    console.print(f"[bold]Written:[/bold] {escape(str(finished.folder.path))}", soft_wrap=True)
    return page


def _without_measurements(items: Sequence[str], console: Console, all_of_them: bool) -> Sequence[str]:
    if not all_of_them and items[0] in MEASURED:
        raise StudyError(
            f"{items[0]} is made of the paper's measurements: give the folder of the published files with --published"
        )
    console.print(STAND_IN)
    if all_of_them:
        console.print(LEFT_OUT)
    return [item for item in items if item not in MEASURED]
