"""A remedy for each thing that can be wrong with a rig description: one line with its key and what to write instead."""

from __future__ import annotations

import difflib
import re
import reprlib
from collections.abc import Iterator, Sequence
from typing import Any, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

Models = Sequence[type[BaseModel]]

# By the ending of a key, longest first.
_UNITS = {
    "_dbfs": "decibels of full scale",
    "_m_s": "metres per second",
    "_db": "decibels",
    "_hz": "hertz",
    "_px": "pixels",
    "_m": "metres",
    "_s": "seconds",
    "_c": "degrees Celsius",
}
_OFTEN_MEANT = {"metres": ("mm", 0.001), "seconds": ("ms", 0.001), "hertz": ("kHz", 1000.0)}
_LIMITS = {
    "greater_than": ("gt", "is not more than", "more than"),
    "greater_than_equal": ("ge", "is less than", "at least"),
    "less_than": ("lt", "is not less than", "less than"),
    "less_than_equal": ("le", "is more than", "at most"),
}
_WANTED = {
    "int": "is not a whole number: give a plain whole number",
    "float": "is not a number: give a plain number",
    "finite": "is not a finite number: give a plain number",
    "string": "is not text: put it in quotes",
    "bool": "is neither true nor false: give one of them",
    "tuple": "is not a list: give one, as in [1, 2]",
}


def remedies(error: ValidationError, model: type[BaseModel]) -> list[str]:
    """Return one line per key that is wrong, `key.path: what is wrong: what to do`.

    Parameters
    ----------
    error : pydantic.ValidationError
        What `model` said.
    model : type
        The model of the whole document.
    """
    details = error.errors(include_url=False)
    details.sort(key=lambda detail: detail["type"] == "missing")  # a misspelt key says more than that one is missing
    misspelt = {_meant_path(detail, model) for detail in details if detail["type"] == "extra_forbidden"}
    lines: dict[str, str] = {}
    for detail in details:
        path, line = _remedy(detail, model)
        misspelt_elsewhere = detail["type"] == "missing" and path in misspelt
        entries_named = detail["type"] == "too_short" and any(known.startswith(f"{path}[") for known in lines)
        if not misspelt_elsewhere and not entries_named:  # one slip, one line
            lines.setdefault(path, line)
    return [f"{path}: {line}" if path else line for path, line in lines.items()]


def _meant_path(detail: ErrorDetails, model: type[BaseModel]) -> str:
    path, models = _follow(detail["loc"][:-1], model)
    return _join(path, _meant_key(str(detail["loc"][-1]), models))


def _remedy(detail: ErrorDetails, model: type[BaseModel]) -> tuple[str, str]:
    kind, location, context = detail["type"], detail["loc"], detail.get("ctx", {})
    if kind in ("extra_forbidden", "missing", "invalid_key"):
        path, models = _follow(location[:-1], model)
        key = location[-1]
        if kind == "missing":
            return _join(path, key), _add(key, models)
        return _join(path, str(key)), _unknown_key(str(key), models)
    path, models = _follow(location, model)
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        return _join(path, context["discriminator"].strip("'")), _unknown_branch(context, models)
    return path, _wrong_value(detail, path, models)


def _follow(location: tuple[int | str, ...], model: type[BaseModel]) -> tuple[str, Models]:
    """Turn pydantic's location into the user's key path, and the models that describe what stands there.

    Between the keys pydantic puts which branch of a union it took; the user never wrote that.
    """
    path, models, named = "", [model], False  # named: what follows is an entry's own name
    for part in location:
        holders = [candidate for candidate in models if part in candidate.model_fields]
        branches = [candidate for candidate in models if _is_branch(candidate, part)] if len(models) > 1 else []
        if isinstance(part, int) or named:
            path, named = _join(path, part), False
        elif branches:  # before keys: a branch may have a key of its own name
            models = branches
        elif holders:
            annotations = [holder.model_fields[part].annotation for holder in holders]
            path, named = _join(path, part), any(get_origin(annotation) is dict for annotation in annotations)
            models = [inner for annotation in annotations for inner in _models_in(annotation)]
    return path, models


def _join(path: str, part: int | str) -> str:
    return f"{path}[{part}]" if isinstance(part, int) else f"{path}.{part}".lstrip(".")


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _models_in(inner)


def _is_branch(model: type[BaseModel], tag: int | str) -> bool:
    return any(get_args(field.annotation) == (tag,) for field in model.model_fields.values())


def _unit(key: str) -> tuple[str, str]:
    """Split a key into its stem and its unit's name, empty where it has none."""
    ending = next((ending for ending in _UNITS if key.endswith(ending)), "")
    return key.removesuffix(ending), _UNITS.get(ending, "")


def _add(key: int | str, models: Models) -> str:
    if isinstance(key, int):
        return f"missing: the list needs at least {key + 1} values"
    field = next(model.model_fields[key] for model in models if key in model.model_fields)
    notes = [f"in {_unit(key)[1]}" if _unit(key)[1] else "", field.description or ""]
    note = "; ".join(filter(None, notes))
    return f"missing: add '{key}: ...'" + (f" ({note})" if note else "")


def _unknown_key(key: str, models: Models) -> str:
    meant = _meant_key(key, models)
    if not meant:
        return f"unknown key; known here: {', '.join(_known_keys(models))}"
    unit = _unit(meant)[1]
    return f"unknown key; did you mean {meant}{f' (in {unit})' if unit else ''}?"


def _meant_key(key: str, models: Models) -> str:
    """Return the known key that a misspelt one stands for, empty where none is near."""
    known = _known_keys(models)
    stems = sorted((name for name in known if _has_stem(key, _unit(name)[0])), key=lambda name: len(_unit(name)[0]))
    return next(iter(stems[-1:] or difflib.get_close_matches(key, known, n=1)), "")


def _known_keys(models: Models) -> list[str]:
    return sorted({name for model in models for name in model.model_fields})


def _unknown_branch(context: dict[str, Any], models: Models) -> str:
    key = context["discriminator"].strip("'")
    fields = (model.model_fields[key] for model in models if key in model.model_fields)
    known = (
        f"give one of {', '.join(dict.fromkeys(str(tag) for field in fields for tag in get_args(field.annotation)))}"
    )
    return f"{context['tag']!r} is not known: {known}" if "tag" in context else f"missing: {known}"


def _has_stem(key: str, stem: str) -> bool:
    """Tell whether a key is a stem with another unit, or with none."""
    return key == stem or re.fullmatch(rf"{re.escape(stem)}_[a-z]{{1,7}}", key) is not None


def _wrong_value(detail: ErrorDetails, path: str, models: Models) -> str:
    kind, value, context = detail["type"], detail["input"], detail.get("ctx", {})
    shown = "nothing" if value is None else reprlib.repr(value)
    unit = _unit(re.sub(r"\[\d+\]$", "", path))[1]
    if kind in _LIMITS:
        return _out_of_limits(kind, value, context, unit)
    if kind == "value_error":
        return str(context["error"])
    if kind in ("too_short", "too_long"):
        limit = f"at least {context['min_length']}" if kind == "too_short" else f"at most {context['max_length']}"
        return f"{context['actual_length']} entries: give {limit}"
    if kind.startswith(("model", "dict")):
        return f"{shown} stands where keys should: give {', '.join(_known_keys(models))} below it"
    return shown + _wrong_type(kind, detail["msg"], context, unit)


def _wrong_type(kind: str, pydantic_says: str, context: dict[str, Any], unit: str) -> str:
    if kind == "literal_error":
        return f" is not known: give {context['expected']}"
    wanted = _WANTED.get(kind.split("_", maxsplit=1)[0])
    if wanted is None or kind in ("string_too_short", "string_too_long", "string_pattern_mismatch"):
        return f" is not possible: {pydantic_says[:1].lower()}{pydantic_says[1:]}"
    return f" {wanted}{f', in {unit}' if unit else ''}"


def _out_of_limits(kind: str, value: float, context: dict[str, Any], unit: str) -> str:
    name, problem, allowed = _LIMITS[kind]
    limit = context[name]
    remedy = f"give {unit}, {allowed} {limit:g}" if unit else f"give {allowed} {limit:g}"
    if unit in _OFTEN_MEANT:
        other_unit, factor = _OFTEN_MEANT[unit]
        converted = value * factor
        if (abs(converted) < abs(limit) and abs(value) >= 5 * abs(limit)) or (0 < value < limit <= converted):
            remedy = f"give {unit}, e.g. {converted:g} for {value:g} {other_unit}"
    return f"{value:g} {problem} {limit:g}: {remedy}"
