"""Every number of a file has bounds, by its type."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import pytest
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from support.cli import animtool

from animtool.batch.schema import BatchModel
from animtool.clip.schema import ClipModel
from animtool.documents.check import FileModel
from animtool.documents.fields import MAX_INTEGER, MAX_NUMBER, check_numbers
from animtool.ik.schema import TargetsModel
from animtool.rig.schema import RigModel
from animtool.scene.file.schema import full_model

MODELS = [BatchModel, ClipModel, RigModel, full_model(), TargetsModel]


def unbounded(
    annotation: Any, notes: tuple[Any, ...], seen: set[type]
) -> Iterator[str]:
    """Yield the types within a type that hold numbers without bounds."""
    origin = get_origin(annotation)
    if origin is Annotated:
        inner, *more = get_args(annotation)
        yield from unbounded(inner, (*notes, *more), seen)
    elif origin in {Union, UnionType, list, dict, tuple}:
        # A bound of a list is not one of its items; what checks all of it is.
        checked = tuple(n for n in notes if getattr(n, "func", None) is check_numbers)
        kept = notes if origin in {Union, UnionType} else checked
        for part in get_args(annotation):
            yield from unbounded(part, kept, seen)
        if Any in get_args(annotation) and not checked:
            yield "any"
    elif isinstance(annotation, type) and issubclass(annotation, BaseModel):
        if annotation not in seen:
            seen.add(annotation)
            for name, field in annotation.model_fields.items():
                for found in unbounded(field.annotation, tuple(field.metadata), seen):
                    yield f"{annotation.__name__}.{name}: {found}"
    elif annotation in {float, int}:
        low, high = bounds(notes)
        most = MAX_NUMBER if annotation is float else MAX_INTEGER
        if not (-most <= low and high <= most):
            yield f"{annotation.__name__} from {low} to {high}"


def bounds(notes: tuple[Any, ...]) -> tuple[float, float]:
    low, high = -math.inf, math.inf
    for note in notes:
        parts = note.metadata if isinstance(note, FieldInfo) else [note]
        for part in parts:
            for key in ("ge", "gt"):
                low = max(low, getattr(part, key, low))
            for key in ("le", "lt"):
                high = min(high, getattr(part, key, high))
    return low, high


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
def test_every_number_has_bounds(model: type[FileModel]) -> None:
    seen: set[type] = set()
    assert list(unbounded(model, (), seen)) == []
    assert len(seen) > 1


def test_a_number_without_bounds_would_be_found() -> None:
    class Model(FileModel):
        a: list[float]
        b: Annotated[int, "note"] | None = None
        c: dict[str, Any]

    found = list(unbounded(Model, (), set()))
    assert [text.partition(":")[0] for text in found] == [
        "Model.a",
        "Model.b",
        "Model.c",
    ]


RIG = (
    "rig: animtool/1\nname: a\njoints: [{name: b, type: free, translate: [0, X, 0]}]\n"
)
SCENE = (
    "scene: animtool/1\nrange: [1, 2]\nsystems:\n- particles:\n"
    "    emitters: [{rate: 1}]\n    forces: [{drag: {linear: X}}]\n"
)


@pytest.mark.parametrize(
    ("kind", "text", "number", "said"),
    [
        ("rig", RIG, "1.0e39", "3:47: DOC022 joints[0].translate[1]: 1e+39 is beyond"),
        ("rig", RIG, "-1.0e39", "-1e+39 is beyond -1e+18"),
        ("rig", RIG, "1.0e999", "inf is not a finite number"),
        ("rig", RIG, "-.inf", "-inf is not a finite number"),
        ("rig", RIG, ".nan", "nan is not a finite number"),
        ("rig", RIG, "9" * 300, "is beyond 1e+18"),
        ("scene", SCENE, "1.0e39", "drag.linear is 1e+39, not a finite number up to"),
        ("scene", SCENE, ".nan", "drag.linear is nan"),
        ("scene", SCENE, "9" * 300, "drag.linear is 0x"),
    ],
)
def test_a_number_beyond_is_refused_at_its_place(
    tmp_path: Path, kind: str, text: str, number: str, said: str
) -> None:
    path = tmp_path / f"a.{kind}.yaml"
    path.write_text(text.replace("X", number))
    done = animtool("validate", path)
    assert done.code == 1
    assert said in done.stdout
    assert f"{path}:" in done.stdout
