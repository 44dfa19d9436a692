"""What cases of a study are called in tables and figures: by what differs between them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from calib.study.description import MeasuredNoise, Noise
from calib.study.scene import Case

NAMES = {
    "ours-1": "Ours-1 (one reference)",
    "ours-2": "Ours-2 (all pairs)",
    "ours-3": "Ours-3 (known ninth)",
    "search": "Legg, authors' search (known ninth)",
    "legg-2013": "Legg, 2013 method (flight times, known ninth)",
    "joint": "joint",
}
MEASURED = "the TDOAs that the paper's authors measured; repetitions differ in first guess and poses taken only"
FIELDS = ("array", "board", "pose_set", "noise", "n_poses", "starts")


@dataclass(frozen=True)
class Labels:
    """Names of a study's cases.

    Parameters
    ----------
    differing : frozenset of str
        Fields of a case that take several values in the study; `starts` only where they do for the same method.
    """

    differing: frozenset[str]

    @classmethod
    def of(cls, cases: Iterable[Case]) -> Labels:
        """Return the labels of all cases of a study; those of some would leave out what differs among the rest."""
        cases = list(cases)
        several = {name for name in FIELDS if len({getattr(case, name) for case in cases}) > 1}
        if len({(case.method, case.starts) for case in cases}) == len({case.method for case in cases}):
            several.discard("starts")
        return cls(frozenset(several))

    @property
    def along(self) -> str:
        """Return the field that tables run along: the number of poses where it differs, else the noise."""
        return "n_poses" if "n_poses" in self.differing else "noise"

    def column(self, case: Case) -> str:
        """Return the name of a case's column."""
        if self.along == "noise":
            return case.noise
        return "all poses" if case.n_poses is None else f"{case.n_poses} poses"

    def row(self, case: Case, *also: str) -> str:
        """Return the name of a case's row: its method, and what else differs but the column; `also` is added."""
        return ", ".join(filter(None, [NAMES[case.method], self.rest(case, *also)]))

    def rest(self, case: Case, *also: str) -> str:
        """Return what else than the method differs but the column; `also` is added."""
        return ", ".join(filter(None, [*self._words(case), *also]))

    def _words(self, case: Case) -> list[str]:
        told = [name for name in FIELDS if name in self.differing and name != self.along]
        return [
            f"start drawn {case.starts}" if name == "starts" else f"{name.replace('_', ' ')} {getattr(case, name)}"
            for name in told
        ]


def noise_kinds(noises: dict[str, Noise]) -> dict[str, str]:
    """Return what sets each noise apart from the others, its scale left aside; empty words where nothing does."""
    told = {name: _told(noise) for name, noise in noises.items()}
    common = set.intersection(*(set(words) for words in told.values()))
    return {name: ", ".join(word for word in words if word not in common) for name, words in told.items()}


def noise_words(noise: Noise) -> str:
    """Return a noise in words, its scale first."""
    if isinstance(noise, MeasuredNoise):
        return MEASURED
    return f"{1e6 * noise.scale_s:.4g} us " + ", ".join(_told(noise))


def _told(noise: Noise) -> list[str]:
    if isinstance(noise, MeasuredNoise):
        return ["measured"]
    words = [noise.law, f"on {noise.adds_to}"]
    words += [f"grid {1e6 * noise.grid_s:g} us"] if noise.grid_s else []
    words += [f"{100 * noise.outliers:g} % outliers"] if noise.outliers else []
    return words + ([f"buzzers {1e3 * noise.buzzer_std_m:g} mm off"] if noise.buzzer_std_m else [])
