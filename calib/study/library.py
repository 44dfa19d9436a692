"""The library of studies: finds the description that is meant, and reads it."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import yaml

from calib.study.description import StudyDescription
from calib.study.errors import StudyError
from rigs.library import parse_document, read_document


def find_study(name: str, also: Sequence[str] = ()) -> StudyDescription:
    """Find a study by the bare name of a shipped one, or by the path of a YAML file; `also`: other names, for a remedy.

    Raises
    ------
    StudyError, rigs.errors.DescriptionError
        There is no such file, it cannot be read, or it is not a valid description.
    """
    shipped = shipped_studies()
    if name in shipped:  # a file of that name is meant by ./name
        return parse_study(shipped[name], f"{name}.yaml (shipped)")
    path = Path(name)
    if not path.exists():
        known = [*also, *shipped]
        near = difflib.get_close_matches(name, known, n=1)
        remedy = f"did you mean {near[0]}?" if near else f"give the path of a YAML file, or one of {', '.join(known)}"
        raise StudyError(f"{name}: no such study: {remedy}")
    return parse_study(read_document(path, "study"), name)


def parse_study(text: str, where: str) -> StudyDescription:
    """Read a study from YAML text; `where` it stands is for messages.

    Raises
    ------
    rigs.errors.DescriptionError
    """
    return parse_document(text, where, StudyDescription, "study")


def shipped_studies() -> dict[str, str]:
    """Return the YAML text of every study that ships with the project, by its bare name."""
    folder = files("calib.study") / "studies"
    found = sorted((entry for entry in folder.iterdir() if entry.name.endswith(".yaml")), key=lambda e: e.name)
    return {entry.name.removesuffix(".yaml"): entry.read_text(encoding="utf-8") for entry in found}


def study_text(study: StudyDescription) -> str:
    """Return a study as YAML, every value written out."""
    return yaml.safe_dump(study.model_dump(mode="json"), sort_keys=False, default_flow_style=None, width=120)
