"""The tables of keys in ``docs/reference``, made of the schemas.

``python tests/support/key_tables.py`` writes them anew into the pages.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from animtool.cli.schema import MODELS, model_of
from animtool.documents.placeholders import annotation_of
from animtool.documents.placeholders import models_of as models_of_type

_FOLDER = Path(__file__).parents[2] / "animtool/docs/reference"
# In the order in which examples of parts add to those before them.
PAGES = [
    _FOLDER / f"{name}.md"
    for name in (
        *("rig-files", "clip-files", "targets-files", "map-files", "capture-files"),
        *("scene-files", "particles-files", "rigid-files", "fluid-files"),
        *("molecules-files", "nbody-files", "flocks-files", "crowds-files"),
        *("springs-files", "batch-files", "files"),
    )
]
_MARK = re.compile(r"(<!-- keys: (\w+) (.+?) -->\n)(?:\n(?:\|.*\n)+)?")
_HEAD = "| key | value | usually | meaning | example |\n|---|---|---|---|---|\n"
# Bounds that all numbers have are not in the tables.
LARGE = 1e9
_WORDS = {
    "string": "text",
    "boolean": "true or false",
    "integer": "whole number",
    "number": "number",
    "object": "keys",
}


@dataclass(frozen=True)
class Key:
    """A key of a file, as its models have it."""

    kind: str
    models: tuple[str, ...]
    name: str
    spec: dict[str, Any]
    required: bool


@cache
def schema_of(kind: str) -> dict[str, Any]:
    """Return the JSON Schema of a kind of file."""
    model = model_of(kind)
    described: dict[str, Any] = model.model_json_schema(by_alias=True)
    described["$defs"] = {**described.get("$defs", {}), model.__name__: described}
    return described


def models_of(kind: str) -> list[str]:
    """Return the names of the models of a kind of file, those of all with the first."""
    shared = () if kind == "rig" else ("IgnoreModel",)
    return [name for name in schema_of(kind)["$defs"] if name not in shared]


def field_of(model: str, key: str) -> FieldInfo:
    """Return a field of a model by its key in the file."""
    return next(
        field
        for name, field in _classes()[model].model_fields.items()
        if key == (field.alias or name)
    )


@cache
def _classes() -> dict[str, type[BaseModel]]:
    """Return every model of the files, by name."""
    return {
        inner.__name__: inner for kind in MODELS for inner in models_in(model_of(kind))
    }


def models_in(model: type[BaseModel]) -> Iterator[type[BaseModel]]:
    """Yield a model and those inside it."""
    yield model
    for field in model.model_fields.values():
        pending = [annotation_of(field)]
        while pending:
            found = pending.pop()
            for inner in models_of_type(found):
                yield from models_in(inner)
            pending += list(getattr(found, "__args__", ()))


def keys_of(kind: str, models: list[str]) -> Iterator[Key]:
    """Yield the keys of models, those that are alike in several as one."""
    defs = schema_of(kind)["$defs"]
    found: dict[tuple[str, str], list[str]] = {}
    for model in models:
        for name, spec in defs[model]["properties"].items():
            shown = {} if "const" in spec and len(models) > 1 else spec
            found.setdefault((name, repr(shown)), []).append(model)
    for (name, _), having in found.items():
        spec = dict(defs[having[0]]["properties"][name])
        if len(having) > 1 and "const" in spec:
            values = [defs[model]["properties"][name]["const"] for model in having]
            spec = {**spec, "enum": values}
            del spec["const"]
        required = name in defs[having[0]].get("required", ())
        yield Key(kind, tuple(having), name, spec, required)


def filled(text: str) -> str:
    """Return a page with the table of each mark ``<!-- keys: KIND MODEL … -->``."""

    def table(mark: re.Match[str]) -> str:
        models = mark[3].split()
        rows = [_row(key, models) for key in keys_of(mark[2], models)]
        return f"{mark[1]}\n{_HEAD}{''.join(rows)}"

    return _MARK.sub(table, text)


def marked(text: str) -> list[tuple[str, str]]:
    """Return the kinds and models that a page has tables of."""
    marks = [(kind, names.split()) for _, kind, names in _MARK.findall(text)]
    return [(kind, name) for kind, names in marks for name in names]


def _row(key: Key, models: list[str]) -> str:
    about = key.spec["description"]
    if len(key.models) < len(models):
        kinds = [
            name.removesuffix("JointModel").removesuffix("Model").lower()
            for name in key.models
        ]
        about = f"({' and '.join(kinds)}) {about}"
    given = (field_of(key.models[0], key.name).examples or [None])[0]
    # As it stands between braces, where commas want quotes.
    example = _flow({key.name: given})[1:-1]
    usual = "required" if key.required else _usual(key.spec)
    cells = [f"`{key.name}`", _value(key.spec), usual, about, f"`{example}`"]
    assert not any("|" in cell for cell in cells), key
    return f"| {' | '.join(cells)} |\n"


def _usual(spec: dict[str, Any]) -> str:
    default = spec.get("default")
    told = default is None or default == [] or isinstance(default, dict)
    return "" if told else f"`{_flow(default)}`"


def _flow(value: Any) -> str:
    text = yaml.safe_dump(
        value, default_flow_style=True, width=10**6, sort_keys=False
    ).removesuffix("...\n")
    return re.sub(r"(?<=\d)\.0\b", "", text.strip())


def _value(spec: dict[str, Any]) -> str:
    several = spec.get("anyOf", spec.get("oneOf"))
    if several is not None:
        kinds = [_value(part) for part in several if part.get("type") != "null"]
        return " or ".join(dict.fromkeys(kinds))
    if "enum" in spec or "const" in spec:
        return ", ".join(f"`{v}`" for v in spec.get("enum", [spec.get("const")]))
    if spec.get("type") == "array":
        return _listed(spec)
    named = spec.get("additionalProperties")
    if isinstance(named, dict) and ("$ref" in named or named.get("type")):
        return f"{_value(named)}, by name"
    word = _WORDS.get(spec.get("type", "object"), "keys")
    if "exclusiveMinimum" in spec:
        word += " above 0"
    elif abs(spec.get("minimum", LARGE)) < LARGE:
        word += f", {spec['minimum']:g} or more"
    return word


def _listed(spec: dict[str, Any]) -> str:
    items = spec["items"]
    inner = _value(items)
    plural = {"number": "numbers", "whole number": "whole numbers"}.get(inner, inner)
    count = spec.get("minItems", 0)
    if count and count == spec.get("maxItems"):
        return f"{count} {plural}" if items.get("type") else f"list of {count}"
    return f"lists of {plural}" if inner[0].isdigit() else f"list of {plural}"


if __name__ == "__main__":
    for page in PAGES:
        page.write_text(filled(page.read_text("utf-8")), "utf-8")
