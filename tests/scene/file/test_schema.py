"""Models of scenes: with the kinds of systems that one has, and with all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from animtool.core.errors import FormatError
from animtool.documents.check import validate_document
from animtool.documents.document import parse_document
from animtool.scene.file.schema import SystemModel, full_model, model_for
from animtool.systems.framework.kinds import SYSTEM_KINDS

ROPE = "{rope: {from: [0, 2, 0], to: [1, 2, 0], count: 5, mass: 1}}"
# What systems may be given as; keys before are those of a scene.
ENTRIES = [
    "systems: []",
    "systems:",
    "systems: 3",
    "systems: {rope: 1}",
    f"systems: [{ROPE}]",
    f"system: [{ROPE}]",
    f"SYSTEMS: [{ROPE}]",
    f"systems: [{ROPE}, 3, [], null]",
    f"systems: [{ROPE}, {{}}]",
    "systems: [{rope: null}]",
    "systems: [{ropes: {count: 3}}]",
    "systems: [{rope: {counts: 3}, cloth: {}}]",
    "systems: [{rope: {count: many}}, {particles: {emitters: 3}}]",
    "systems: [{'1': 2}]",
    "systems: [{rope: {}}, {${kind}: {}}]",
    "systems: [{nbody: {galaxies: [{name: 3}]}}]\nfluids: 1",
    "systems: [particles]",
]


def reading(text: str, model: Any) -> tuple[Any, list[str]]:
    """Return a document as read, and what was found."""
    document = parse_document(text, Path("it.scene.yaml"))
    try:
        read = validate_document(document, model(document.value)).model_dump()
        document.check()
    except FormatError as error:
        return None, [str(fault) for fault in error.faults]
    return read, [str(notice) for notice in document.notices]


@pytest.mark.parametrize("entries", ENTRIES)
def test_a_scene_is_read_as_with_all_kinds(entries: str) -> None:
    text = f"scene: animtool/1\nrange: [1, 2]\n{entries}\n"
    whole = reading(text, lambda _: full_model())
    assert reading(text, model_for) == whole


def test_the_kinds_of_a_scene_are_those_it_names() -> None:
    assert kinds({"systems": [{"rope": {}}, {"cloth": {}, "rope": {}}]}) == {
        "rope",
        "cloth",
    }
    assert kinds({"systems": [{}]}) == kinds({}) == set()
    assert kinds({"systems": [{"ropes": {}}]}) == set(SYSTEM_KINDS)
    assert kinds({"sistems": [{"rope": {}}]}) == set(SYSTEM_KINDS)
    assert kinds(None) == set(SYSTEM_KINDS)


def kinds(written: Any) -> set[str]:
    """Return the kinds that the model of a scene knows."""
    systems = model_for(written).model_fields["systems"]
    (system,) = systems.annotation.__args__  # type: ignore[union-attr]
    assert issubclass(system, SystemModel)
    return set(system.model_fields)


@pytest.mark.parametrize("model", [model_for({}), full_model()])
def test_a_scene_has_a_thousand_systems_at_most(model: Any) -> None:
    schema = model.model_json_schema()["properties"]["systems"]
    assert schema["maxItems"] == 1000
