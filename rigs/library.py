"""The library of rigs: finds the description that is meant, reads it, and says in one line each what is wrong."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

import platformdirs
import yaml
from pydantic import BaseModel, ValidationError

from rigs.description import RigDescription
from rigs.errors import DescriptionError
from rigs.remedies import remedies

try:
    from yaml import CSafeLoader
except ImportError:  # PyYAML was built without libyaml: slower
    from yaml import SafeLoader as CSafeLoader  # type: ignore[assignment]

MAX_BYTES = 1_000_000
DEFAULT_RIG = "simulated"
_MAX_LINES = 8
_MAX_DEPTH = 100
Document = TypeVar("Document", bound=BaseModel)


@dataclass(frozen=True)
class FoundDescription:
    """A rig description, and how it was found.

    Parameters
    ----------
    text : str
        The YAML word for word.
    description : RigDescription
    where : str
        Its file, for messages.
    how : str
        Which rule found it: "--rig", "RIG", "./rig.yaml", "user's config folder" or "default".
    """

    text: str
    description: RigDescription
    where: str
    how: str


def find_description(rig: str | None, named_by: str = "--rig") -> FoundDescription:
    """Find the description that is meant, read it and check it.

    Looked up from `rig`, then the environment's RIG, then ./rig.yaml, then the user's config folder; else the shipped
    simulated rig.

    Parameters
    ----------
    rig : str or None
        A path, or the bare name of a shipped rig such as "kinect8".
    named_by : str
        What gave `rig`, for messages.

    Raises
    ------
    DescriptionError
        There is no such file, it cannot be read, or it is not a valid description.
    """
    named = [(named_by, rig), ("RIG", os.environ.get("RIG"))]
    for how, name in named:
        if name:
            return _open(name, how)
    for how, path in (("./rig.yaml", Path("rig.yaml")), ("user's config folder", user_description_path())):
        if path.exists():
            return _found(read_document(path, "rig"), str(path), how)
    return _open(DEFAULT_RIG, "default")


def parse_description(text: str, where: str) -> RigDescription:
    """Read a description from YAML text.

    Parameters
    ----------
    text : str
    where : str
        Its file, for messages.

    Raises
    ------
    DescriptionError
        Not YAML, not a mapping, or not valid: one line per problem, each with file, key and remedy.
    """
    return parse_document(text, where, RigDescription, "rig")


def parse_document(text: str, where: str, model: type[Document], what: str) -> Document:
    """Read any description of the project from YAML text; `what` it describes is for messages.

    Raises
    ------
    DescriptionError
        Not YAML, not a mapping, or not valid: one line per problem, each with file, key and remedy.
    """
    document = load_yaml(text, where)
    if not isinstance(document, dict):
        raise DescriptionError(f"{where}: not a {what} description: give keys and values, as in `name: my {what}`")
    try:
        return model.model_validate(document)
    except ValidationError as error:
        lines = remedies(error, model)
        shown = [f"{where}: {line}" for line in lines[:_MAX_LINES]]
        if len(lines) > _MAX_LINES:
            shown.append(f"{where}: and {len(lines) - _MAX_LINES} more problems")
        raise DescriptionError("\n".join(shown)) from error


def shipped_rigs() -> dict[str, str]:
    """Return the YAML text of every rig that ships with the project, by its bare name."""
    found = sorted((entry for entry in files("rigs").iterdir() if entry.name.endswith(".yaml")), key=lambda e: e.name)
    return {entry.name.removesuffix(".yaml"): entry.read_text(encoding="utf-8") for entry in found}


def user_description_path() -> Path:
    """Return where the user's own description is looked for."""
    return platformdirs.user_config_path("acoustic-camera-rig", appauthor=False) / "rig.yaml"


def schema() -> dict[str, Any]:
    """Return the JSON Schema of a rig description."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **RigDescription.model_json_schema()}


def schema_text() -> str:
    """Return the schema as it stands in rigs/rig.schema.json, for editors."""
    return json.dumps(schema(), indent=1, ensure_ascii=False) + "\n"


def _open(name: str, how: str) -> FoundDescription:
    shipped = shipped_rigs()
    if name in shipped:  # a file of that name is meant by ./name
        return _found(shipped[name], f"{name}.yaml (shipped)", how)
    path = Path(name)
    if not path.exists():
        raise DescriptionError(
            f"{name}: no such rig description (named by {how}): give a path, or a shipped rig: {', '.join(shipped)}"
        )
    return _found(read_document(path, "rig"), name, how)


def _found(text: str, where: str, how: str) -> FoundDescription:
    return FoundDescription(text, parse_description(text, where), where, how)


def read_document(path: Path, what: str) -> str:
    """Read the text of a description; `what` it describes is for messages.

    Raises
    ------
    DescriptionError
        It cannot be read, or is no such text.
    """
    try:
        with path.open("rb") as stream:
            content = stream.read(MAX_BYTES + 1)
        if len(content) > MAX_BYTES:
            raise DescriptionError(
                f"{path}: larger than 1 MB, so not a {what} description: name the YAML file of your {what}"
            )
        return content.decode("utf-8-sig")
    except OSError as error:
        remedy = f"name the YAML file of your {what}"
        raise DescriptionError(f"{path}: cannot be read ({error.strerror}): {remedy}") from error
    except UnicodeDecodeError as error:
        raise DescriptionError(f"{path}: not UTF-8 text: save it as UTF-8 in your editor") from error


def _yaml_remedy(error: yaml.MarkedYAMLError) -> str:
    problem = error.problem or error.context or "not YAML"
    if "'\\t'" in problem:
        return "a tab: indent with spaces"
    if type(error) is yaml.MarkedYAMLError:  # this module's own words
        return problem
    return f"{problem}: check here and on the lines above that each key is followed by ': ' and lines up with its group"


class _NoKeyTwice:
    """A constructor without PyYAML's silent trap: of a key that is given twice it takes the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if str(key.value) in seen:
                problem = f"key {key.value!r} is given twice: keep one"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=key.start_mark)
            seen.add(str(key.value))
        return super().construct_mapping(node, deep)  # type: ignore[misc,no-any-return]


class _StrictLoader(_NoKeyTwice, yaml.SafeLoader):
    """PyYAML's safe loader without its two silent traps: keys given twice, and aliases that multiply."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
            raise yaml.MarkedYAMLError(problem="aliases (*name) are not known here: write the value", problem_mark=mark)
        return super().compose_node(parent, index)


class _FastLoader(_NoKeyTwice, CSafeLoader):
    """The same by libyaml, for text that `_is_flat`: five times as fast, but it knows less well what is wrong."""


def _is_flat(text: str) -> bool:
    """Tell whether a text is YAML without aliases, and not nested so deeply that libyaml would run out of stack."""
    depth = 0
    for event in yaml.parse(text, Loader=CSafeLoader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _MAX_DEPTH or isinstance(event, yaml.AliasEvent):
            return False
    return True


def _parsed(text: str, *, fast: bool) -> Any:
    with suppress(yaml.YAMLError, ValueError):  # said below, and better
        if fast and _is_flat(text):
            return yaml.load(text, Loader=_FastLoader)  # noqa: S506 (a SafeLoader)
    return yaml.load(text, Loader=_StrictLoader)  # noqa: S506 (a SafeLoader)


def load_yaml(text: str, where: str, *, fast: bool = False) -> Any:
    """Read YAML strictly: no key twice, no aliases.

    Parameters
    ----------
    text : str
    where : str
        Its file, for messages.
    fast : bool
        For large files that software wrote: by libyaml, which lets some slips of a hand pass, as a tab between words.

    Raises
    ------
    DescriptionError
        Not such YAML; says where and what to do.
    """
    try:
        return _parsed(text, fast=fast)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"{where}, line {mark.line + 1}, column {mark.column + 1}" if mark else where
        raise DescriptionError(f"{place}: {_yaml_remedy(error)}") from error
    except RecursionError as error:
        raise DescriptionError(f"{where}: not YAML: nested too deeply") from error
    except (yaml.YAMLError, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise DescriptionError(f"{where}: not YAML: {reason}") from error
