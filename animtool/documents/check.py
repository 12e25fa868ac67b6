"""A document against a model: every fault at once, in words, with its place."""

from __future__ import annotations

from difflib import get_close_matches
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError

from animtool.documents.document import Document
from animtool.errors import excerpt

__all__ = ["FileModel", "check_version", "nearest", "validated"]

Model = TypeVar("Model", bound=BaseModel)


class FileModel(BaseModel):
    """A mapping in a file: no unknown keys, no text for numbers, all finite."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


def nearest(name: str, names: list[str]) -> str:
    """Return a hint that names the nearest valid name, or the valid ones.

    >>> nearest("ebow", ["elbow", "hand"])
    "did you mean 'elbow'?"
    """
    near = get_close_matches(name, names, 1)
    if near:
        return f"did you mean {near[0]!r}?"
    if not names:
        return "there is none"
    return f"allowed: {', '.join(names[:12])}" + (" …" if len(names) > 12 else "")


def check_version(document: Document, kind: str) -> None:
    """Raise `FormatError` where a document is not of a kind, or of a later version."""
    stated = document.value.get(kind)
    if stated == "animtool/1":
        return
    known = [
        key for key in ("rig", "clip", "scene", "targets") if key in document.value
    ]
    if kind not in document.value:
        hint = f"the first line of such a file is '{kind}: animtool/1'"
        if known:
            hint = f"it looks like a {known[0]} file"
        document.add("DOC009", [], f"is no {kind} file", hint)
    elif isinstance(stated, str) and stated.startswith("animtool/"):
        message = f"{stated} is a version that this animtool does not know"
        document.add("DOC012", [kind], message, "a newer animtool reads it")
    else:
        message = f"{kind} is {excerpt(str(stated))}"
        document.add("DOC009", [kind], message, "allowed: animtool/1")
    document.check()


def validated(document: Document, model: type[Model]) -> Model:
    """Return a document as a model.

    Raises:
        FormatError: With every fault of its keys, types and values.
    """
    try:
        return model.model_validate(document.value)
    except ValidationError as error:
        _report(document, model, error)
        document.check()
        raise


def _report(document: Document, model: type[BaseModel], error: ValidationError) -> None:
    merged: dict[tuple[tuple[str | int, ...], str], list[Any]] = {}
    for fault in error.errors(include_url=False):
        missing = str(fault["loc"][-1]) if fault["type"] == "missing" else ""
        merged.setdefault((_within(document, fault), missing), []).append(fault)
    for (location, _), faults in merged.items():
        kind = faults[0]["type"]
        if kind == "extra_forbidden":
            names = _field_names(model, document, location[:-1])
            message = f"unknown key {excerpt(str(location[-1]))}"
            hint = nearest(str(location[-1]), names)
            document.add("DOC020", location, message, hint)
        elif kind == "missing":
            name = str(faults[0]["loc"][-1])
            document.add("DOC021", location, f"key {name!r} is missing")
        else:
            texts = dict.fromkeys(_words(fault) for fault in faults)
            document.add("DOC022", location, "; or ".join(texts))


def _within(document: Document, fault: Any) -> tuple[str | int, ...]:
    """Return where a fault is, without the names of variants that were tried."""
    node: Any = document.value
    found: list[str | int] = []
    for step in fault["loc"]:
        try:
            node = node[step]
        except (KeyError, IndexError, TypeError):
            continue
        found.append(step)
    return tuple(found)


def _words(fault: Any) -> str:
    """Return what is wrong, with the value."""
    given, context, kind = fault["input"], fault.get("ctx", {}), fault["type"]
    shown = excerpt(given) if isinstance(given, str) else _shown(given)
    if kind in {"too_short", "too_long"}:
        wanted = context.get("min_length", context.get("max_length"))
        return f"{context['actual_length']} items where {wanted} are wanted"
    if kind == "union_tag_not_found":
        return f"key {context['discriminator']} is missing"
    if kind in {"literal_error", "enum", "union_tag_invalid"}:
        allowed = context.get("expected", context.get("expected_tags"))
        tag = excerpt(str(context["tag"])) if "tag" in context else shown
        return f"{tag} is not one of {allowed}"
    if kind in _KINDS:
        return f"{shown} is not {_KINDS[kind]}"
    return f"{shown}: {fault['msg'][0].lower()}{fault['msg'][1:]}"


_KINDS = {
    "float_type": "a number",
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "string_type": "text",
    "bool_type": "true or false",
    "list_type": "a list",
    "dict_type": "a mapping of keys",
    "model_type": "a mapping of keys",
    "model_attributes_type": "a mapping of keys",
}


def _shown(value: Any) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return str(value).lower()
    return excerpt(str(value)).strip("'")


def _field_names(
    model: Any, document: Document, location: tuple[str | int, ...]
) -> list[str]:
    """Return the keys that a mapping at a location may have."""
    candidates = [model]
    node: Any = document.value
    for step in location:
        node = node[step]
        if isinstance(step, str):
            inside = [
                inner
                for candidate in candidates
                for name, info in candidate.model_fields.items()
                if (info.alias or name) == step
                for inner in _models(info.annotation)
            ]
            # A step that is no field is a key of a mapping of models.
            candidates = inside or candidates
    named = [c for c in candidates if _tagged(c, node)] or candidates
    return sorted(
        {info.alias or name for c in named for name, info in c.model_fields.items()}
    )


def _tagged(model: Any, node: Any) -> bool:
    info = model.model_fields.get("type")
    return info is not None and node.get("type") in get_args(info.annotation)


def _models(annotation: Any) -> list[Any]:
    """Return the models that an annotation is made of."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for inner in get_args(annotation) for m in _models(inner)]
