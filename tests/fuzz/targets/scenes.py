"""Scenes of every kind of system, made from the JSON Schema, with bounds as numbers."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from animtool.core.errors import AnimtoolError
from animtool.scene.file.read import load_scene
from animtool.scene.file.schema import full_model
from fuzz.targets.springs import FPS, FRAMES, simulated, strands

ABOUT = (
    "scenes of each kind of system, made from the JSON Schema with bounds as numbers"
)

# What is at no bound, and still at the end of a range.
_NUMBERS = (0, -0.0, 1, -1, 0.5, 5e-324, 1e-300, 1e-18, 1e-6, 1e6, 1e12, 1e17, 1e150)
# More of anything is no fault, and takes its time: such a scene is only loaded.
MAX_SIMULATED = 200
DEEPEST = 7
# What examples have too finely for a case of a second, by kind.
_COARSE = {"fluid": {"spacing": 0.1}}


@dataclass(frozen=True, slots=True)
class _Maker:
    """Makes values that a schema describes."""

    definitions: dict[str, Any]  # by name
    rng: np.random.Generator

    def value(self, schema: dict[str, Any], depth: int = 0) -> Any:
        """Return a value of a schema: an example, or one at its bounds."""
        examples = [*schema.get("examples", ()), *_default(schema)]
        if examples and (depth > DEEPEST or self.rng.random() < 0.4):
            return copy.deepcopy(self._one(examples))
        schema = self._resolved(schema)
        if "const" in schema or "enum" in schema:
            return self._one(schema.get("enum") or [schema["const"]])
        makers: dict[str, Callable[[], Any]] = {
            "number": lambda: self._number(schema),
            "integer": lambda: self._number(schema),
            "boolean": lambda: bool(self.rng.integers(2)),
            "array": lambda: self._list(schema, depth),
            "object": lambda: self._object(schema, depth),
            "string": lambda: "a",
        }
        return makers.get(schema.get("type", ""), lambda: None)()

    def changed(self, value: Any, schema: dict[str, Any], depth: int = 0) -> Any:
        """Return a valid value with one part made anew."""
        schema = self._resolved(schema, value)
        if isinstance(value, dict) and schema.get("properties") and depth < DEEPEST:
            inside = [k for k in value if k in schema["properties"]]
            deeper = inside and self.rng.random() < 0.6
            key = self._one(inside if deeper else sorted(schema["properties"]))
            part = schema["properties"][key]
            made = self.value(part, depth)
            if deeper:
                made = self.changed(value[key], part, depth + 1)
            return {**value, key: made}
        if isinstance(value, list) and value and isinstance(schema.get("items"), dict):
            i = int(self.rng.integers(len(value)))
            made = self.changed(value[i], schema["items"], depth + 1)
            return [*value[:i], made, *value[i + 1 :]]
        return self.value(schema, depth)

    def _resolved(self, schema: dict[str, Any], value: Any = None) -> dict[str, Any]:
        """Return a schema without references and alternatives; that of a value."""
        while True:
            if "$ref" in schema:
                schema = self.definitions[schema["$ref"].rpartition("/")[2]]
                continue
            ways = schema.get("anyOf") or schema.get("oneOf")
            if not ways:
                return schema
            # A name of a variable stands in place of any number.
            ways = [way for way in ways if "$" not in way.get("pattern", "")]
            kinds = {dict: "object", list: "array", str: "string"}
            fit = [w for w in ways if w.get("type") == kinds.get(type(value), "")]
            fit += [w for w in ways if "$ref" in w and isinstance(value, dict)]
            schema = self._one(fit or ways)

    def _number(self, schema: dict[str, Any]) -> Any:
        found: list[Any] = [1]
        for key, sign in (("minimum", 1), ("maximum", -1)):
            for name in (key, f"exclusive{key.title()}"):
                if name in schema:
                    bound = schema[name]
                    found += [bound, bound + sign, bound - sign]
                    found.append(float(np.nextafter(bound, sign * np.inf)))
        if schema["type"] == "integer":
            found = [int(number) for number in found] + [0, 2, 3]
        else:
            found += _NUMBERS
        return self._one(found)

    def _list(self, schema: dict[str, Any], depth: int) -> list[Any]:
        least = int(schema.get("minItems", 0))
        most = int(min(schema.get("maxItems", least + 2), least + 2))
        count = int(self.rng.integers(least, most + 1))
        items = schema.get("items") or {"type": "number"}
        return [self.value(items, depth + 1) for _ in range(count)]

    def _object(self, schema: dict[str, Any], depth: int) -> dict[str, Any]:
        needed = set(schema.get("required", ()))
        chance = 0.15 if depth < DEEPEST else 0.0
        return {
            name: self.value(part, depth + 1)
            for name, part in schema.get("properties", {}).items()
            if name in needed or self.rng.random() < chance
        }

    def _one(self, values: Any) -> Any:
        return values[int(self.rng.integers(len(values)))]


def _default(schema: dict[str, Any]) -> list[Any]:
    return [schema["default"]] if schema.get("default") is not None else []


def system_kinds() -> list[str]:
    """Return the kinds of systems that the schema has."""
    return sorted(_schema()["$defs"]["SystemModel"]["properties"])


def _schema() -> dict[str, Any]:
    return full_model().model_json_schema(by_alias=True)


def make(
    folder: Path, kinds: tuple[str, ...] = ()
) -> Callable[[np.random.Generator], str]:
    """Return what runs a case in a folder, of some kinds; empty is all."""
    schema, path = _schema(), folder / "shot.scene.yaml"
    systems = schema["$defs"]["SystemModel"]["properties"]
    strands(folder)
    chosen, counts = kinds or tuple(sorted(systems)), _counts(schema)

    def run(rng: np.random.Generator) -> str:
        maker = _Maker(schema["$defs"], rng)
        kind = chosen[int(rng.integers(len(chosen)))]
        entry = copy.deepcopy(systems[kind]["examples"][0]) | _COARSE.get(kind, {})
        for _ in range(int(rng.geometric(0.4))):
            entry = maker.changed(entry, systems[kind])
        entry = _few(entry)
        if kind == "particles":
            # However many are born, these are made.
            entry.setdefault("max_particles", MAX_SIMULATED)
        scene = {
            "scene": "animtool/1",
            "fps": FPS,
            "range": [1, FRAMES],
            "systems": [{kind: entry}],
            "output": {"file": "shot.usdc"},
        }
        path.write_text(json.dumps(scene), "utf-8")
        try:
            # A bake refuses what takes hours; a rest and trials take seconds at most.
            long = 0 < (entry.get("step") or 1) <= 1e-5
            long |= bool(entry.get("settle") and entry.get("error"))
            if long or _largest(entry, counts) > MAX_SIMULATED:
                load_scene(path)
                return f"{kind} loaded"
            simulated(path, kind)
        except AnimtoolError as error:
            return f"{kind} {error.code[:3]}"
        return f"{kind} simulated"

    return run


def _few(value: Any) -> Any:
    """Return an entry whose counts, where examples have many, are few."""
    if isinstance(value, dict):
        return {
            key: 20
            if key == "count" and isinstance(inner, int) and 20 < inner < 10_000
            else _few(inner)
            for key, inner in value.items()
        }
    return [_few(inner) for inner in value] if isinstance(value, list) else value


def _counts(schema: dict[str, Any]) -> set[str]:
    """Return the names of what is a whole number, or a list of them."""
    return {
        name
        for model in schema["$defs"].values()
        for name, part in model.get("properties", {}).items()
        if '"integer"' in json.dumps(part)
    }


def _largest(value: Any, counts: set[str], name: str = "") -> float:
    """Return the largest number that says how many there are of something."""
    if isinstance(value, dict):
        found = [_largest(inner, counts, key) for key, inner in value.items()]
    elif isinstance(value, list):
        found = [_largest(inner, counts, name) for inner in value]
    else:
        is_count = isinstance(value, int | float) and name in counts
        found = [float(value)] if is_count else []
    return max(found, default=0.0)
