"""Stand-ins: of every type one that fits it, in the place of what does not."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import pytest
from annotated_types import Len
from pydantic import BaseModel, Field, TypeAdapter
from support.key_tables import models_in

from animtool.clip.schema import ClipModel
from animtool.documents.check import FileModel
from animtool.documents.placeholders import (
    UNKNOWN,
    annotation_at,
    annotation_of,
    fields_at,
    fields_of,
    placeholder_of,
    set_value_at,
)
from animtool.rig.joint_schema import JointModel
from animtool.rig.schema import RigModel
from animtool.scene.file.schema import full_model


@pytest.mark.slow
@pytest.mark.parametrize("model", [RigModel, ClipModel, full_model()])
def test_every_key_of_a_file_has_a_stand_in(model: type[BaseModel]) -> None:
    seen = 0
    for inner in models_in(model):
        for field in fields_of(inner).values():
            kind: Any = annotation_of(field)
            TypeAdapter(kind).validate_python(placeholder_of(kind))
            seen += 1
        inner.model_validate(placeholder_of(inner))
    assert seen > 10


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        (str, UNKNOWN),
        (float | list[float], 1.0),
        (Annotated[list[float], Len(3, 3)], [1.0, 1.0, 1.0]),
        (Annotated[list[float], Len(2, 2)] | Literal["locked"] | None, [1.0, 1.0]),
        (dict[str, int], {}),
        (Annotated[dict[str, int], Len(1, 1)], {UNKNOWN: 1}),
        (JointModel, {"name": UNKNOWN, "type": "free"}),
        (Any, None),
    ],
)
def test_stand_ins(kind: Any, expected: object) -> None:
    assert placeholder_of(kind) == expected


class Part(FileModel):
    size: Annotated[float, Field(gt=0)]


class Whole(FileModel):
    parts: list[Part] = Field(default=[])
    named: dict[str, Part] = Field(default={})


def test_the_type_of_a_place() -> None:
    value = {"parts": [{"size": 1}], "named": {"a": {}}}
    assert annotation_at(Whole, value, ("parts", 0)) is Part
    assert annotation_at(Whole, value, ("named", "a")) is Part
    assert annotation_at(Whole, value, ("none", "such")) is None
    assert fields_at(Whole, value, ("parts", 0)) == ["size"]


def test_replacing() -> None:
    value = {"parts": [{"size": "x"}]}
    set_value_at(value, ("parts", 0, "size"), 2)
    assert value == {"parts": [{"size": 2}]}
