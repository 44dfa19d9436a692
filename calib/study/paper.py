"""The paper's tables and figures: which studies they are made of, and the pages that show them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.markdown import Markdown
from rich.markup import escape

import rigs
from calib.study.errors import StudyError
from calib.study.folder import make_folder, write_whole
from calib.study.library import find_study
from calib.study.pages import QUICK, STAND_IN, printed_beside_ours, study_page, terminal_page
from calib.study.parameters import parameters_page
from calib.study.plots import draw_study
from calib.study.published import Published
from calib.study.run import FinishedStudy, quickened, run_study
from calib.study.workers import Workers

STUDY_OF = {"table1": "table2", "table2": "table2", "table3": "table3", "fig3": "table3", "fig4": "fig4"}
TITLES = {
    "all": "The paper's tables and figures",
    "table1": "Table I: parameters of the simulations",
    "table2": "Table II: simulated measurements",
    "table3": "Table III: the published measurements",
    "fig3": "Figure 3: errors of the microphones on the published measurements, and where they are found in space",
    "fig4": "Figure 4: error against the number of poses",
}
MEASURED = ("table3", "fig3", "fig4")  # made of the published measurements, so not without them
LEFT_OUT = (
    "table3, fig3 and fig4 are left out: they need the published measurements, give their folder with --published"
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
    items, notes = _possible(items, published, all_of_them), _notes(quick, published, all_of_them)
    make_folder(output)
    for note in notes:
        console.print(f"! {note}", soft_wrap=True)
    done: dict[str, FinishedStudy] = {}
    pages: list[str] = []
    for item in items:
        names = [f"{STUDY_OF[item]}-{protocol}" for protocol in protocols]
        if item == "table1":
            studies = [find_study(name) for name in names]
            studies = [quickened(study) for study in studies] if quick else studies
            pages.append(parameters_page(studies, stand_in=published.stand_in))
            continue
        for name in names:
            if name in done:
                continue
            done[name] = run_study(find_study(name), output / name, published, workers, console, quick=quick)
            pages.append(finish(done[name], console, STUDY_OF[item]))
    short = printed_beside_ours([(name, STUDY_OF[name.partition("-")[0]], each) for name, each in done.items()])
    pages.insert(0, "\n".join([_head(TITLES["all" if all_of_them else items[0]], notes), *short]))
    page = output / ("report.md" if all_of_them else f"{items[0]}.md")
    write_whole(page, "\n".join(pages).encode())
    if items[0] == "table1" and not all_of_them:
        console.print(Markdown(pages[1]))
    console.print(f"[bold]Written:[/bold] {escape(str(page))}", soft_wrap=True)


def finish(finished: FinishedStudy, console: Console, item: str | None = None) -> str:
    """Write and print the page of a study, and draw its figures; return the page."""
    page, folder = study_page(finished, item), finished.folder.path.name
    title = finished.folder.study.title or finished.folder.study.name
    for path, caption in draw_study(finished, item):
        page += f"\n![{title}: {path.stem}]({folder}/{path.name})\n\n*{caption}*\n"
    finished.folder.write_text("page.md", page.replace(f"]({folder}/", "]("))
    console.print(Markdown(f"# {title}\n\n{terminal_page(finished, item)}"))
    console.print(f"[bold]Written:[/bold] {escape(str(finished.folder.path))}", soft_wrap=True)
    return page


def _head(title: str, notes: list[str]) -> str:
    lines = [f"# {title}", "", f"Made by rig-study of acoustic-camera-rig {rigs.__version__}.", ""]
    return "\n".join([*lines, *(line for note in notes for line in (f"**Note:** {note}.", ""))])


def _notes(quick: bool, published: Published, all_of_them: bool) -> list[str]:
    notes = [QUICK] if quick else []
    if published.stand_in:
        notes += [STAND_IN, LEFT_OUT] if all_of_them else [STAND_IN]
    return notes


def _possible(items: Sequence[str], published: Published, all_of_them: bool) -> Sequence[str]:
    """Return the items that can be made of what is there."""
    if not published.stand_in:
        return items
    if not all_of_them and items[0] in MEASURED:
        raise StudyError(
            f"{items[0]} is made of the paper's measurements: give the folder of the published files with --published"
        )
    return [item for item in items if item not in MEASURED]
