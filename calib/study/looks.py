"""How a study's cases are drawn: a colour and a sign per method, wherever it comes; dashes or panels for the rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from calib.study.description import MethodName
from calib.study.labels import NAMES, Labels, noise_kinds
from calib.study.run import FinishedStudy
from calib.study.summary import CaseSummary

# Colours that colour-blind readers tell apart (Okabe and Ito), and a sign each, for print without colour.
LOOKS = {
    "ours-1": ("#0072B2", "o"),
    "ours-2": ("#009E73", "s"),
    "ours-3": ("#E69F00", "^"),
    "search": ("#D55E00", "v"),
    "legg-2013": ("#CC79A7", "D"),
    "joint": ("#000000", "P"),
}
STYLE: Any = {
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "svg.hashsalt": "acoustic-camera-rig",  # the same figure is the same file
    "svg.fonttype": "none",
}
COLOURS, SIGNS, DASHES = tuple(colour for colour, _ in LOOKS.values()), "os^vDP", ("-", "--", "-.")
MOST_DASHES = 3  # lines of one method in a panel: more cannot be told apart
MANY_DECADES = 3

Look = dict[str, Any]


@dataclass(frozen=True)
class Line:
    """Cases that are drawn as one line.

    Parameters
    ----------
    method : str
    rest : str
        What else tells it from others, in words.
    cases : list of CaseSummary
    """

    method: MethodName
    rest: str
    cases: list[CaseSummary]

    @property
    def name(self) -> str:
        """Everything that tells it from others."""
        return ", ".join(filter(None, [NAMES[self.method], self.rest]))


@dataclass(frozen=True)
class Panel:
    """Lines that are drawn together, each with its label and look."""

    title: str
    lines: list[tuple[Line, str, Look]]


def lines_of(finished: FinishedStudy, along: str | None) -> list[Line]:
    """Return the lines of what shares all but the field of the case that it runs along."""
    kinds = noise_kinds(finished.folder.study.noises)
    labels = Labels.of(each.case for each in finished.summaries)
    groups: dict[tuple[MethodName, str], list[CaseSummary]] = {}
    for each in finished.summaries:
        also = {"noise": kinds[each.case.noise], None: each.case.noise if "noise" in labels.differing else ""}
        groups.setdefault((each.case.method, labels.rest(each.case, also.get(along, ""))), []).append(each)
    found = [Line(method, rest, cases) for (method, rest), cases in groups.items()]
    return sorted(found, key=lambda line: list(NAMES).index(line.method))


def panels_of(lines: Sequence[Line], *, dashes: bool = True) -> list[Panel]:
    """Return which lines are drawn together; no two in a panel look alike.

    Each method has its colour. Where it comes up more than once, dashes and signs tell its lines apart as long as they
    are few, else each of the rest has a panel of its own. Lines of a single method are told apart by colours.
    """
    rests = list(dict.fromkeys(line.rest for line in lines))
    methods = {line.method for line in lines}
    if len(methods) == len(lines):
        return [Panel("", [(line, line.name, _look(line.method)) for line in lines])]
    if len(methods) == 1 and len(lines) <= len(COLOURS):
        looks = [{"color": colour, "marker": sign, "ls": "-"} for colour, sign in zip(COLOURS, SIGNS, strict=True)]
        return [Panel("", [(line, line.name, looks[rests.index(line.rest)]) for line in lines])]
    if dashes and len(rests) <= MOST_DASHES and len(lines) <= 2 * MOST_DASHES:
        return [Panel("", [(line, line.name, _look(line.method) | _dash(rests.index(line.rest))) for line in lines])]
    return [
        Panel(rest, [(line, NAMES[line.method], _look(line.method)) for line in lines if line.rest == rest])
        for rest in rests
    ]


def legend_of_all(figure: Any, axes: Sequence[Any], *extra: Any) -> None:
    """Put one legend beside all panels: each label once."""
    handles = {label: handle for each in axes for handle, label in zip(*each.get_legend_handles_labels(), strict=True)}
    handles |= {handle.get_label(): handle for handle in extra}
    figure.legend(handles.values(), handles.keys(), fontsize=7.5, loc="upper left", bbox_to_anchor=(0.92, 0.9))


def plain_ticks(*scales: Any) -> None:
    """Label logarithmic scales at 1, 2 and 5 in plain numbers; at 1 alone where they span much."""
    for scale in scales:
        low, high = scale.get_view_interval()
        subs = (1.0, 2.0, 5.0) if high < low * 10**MANY_DECADES else (1.0,)
        scale.set_major_locator(LogLocator(subs=subs))
        scale.set_major_formatter(StrMethodFormatter("{x:g}"))
        scale.set_minor_formatter(NullFormatter())


def title_of(finished: FinishedStudy) -> str:
    """Return the study's title, and what must be known of its figures."""
    told = [words for words, holds in (("--quick", finished.quick), ("stand-in poses", finished.stand_in)) if holds]
    title = finished.folder.study.title or finished.folder.study.name
    return f"{title} ({', '.join(told)})" if told else title


def _look(method: MethodName) -> Look:
    colour, sign = LOOKS[method]
    return {"color": colour, "marker": sign, "ls": "-"}


def _dash(number: int) -> Look:
    return {"ls": DASHES[number], "marker": SIGNS[number]}
