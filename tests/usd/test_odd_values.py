"""Layers that USD reads, whose values have types and targets that make no sense."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pxr import Sdf
from support.broken_usd import ANIM, CACHE, FACE, SKEL, write_good
from support.cli import animtool

TYPES = Sdf.ValueTypeNames


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_good(tmp_path_factory.mktemp("good"))


def retype(layer: Any, path: str, kind: Any, value: Any = None) -> None:
    spec = layer.GetObjectAtPath(path)
    prim, name = spec.owner, spec.name
    prim.RemoveProperty(spec)
    made = Sdf.AttributeSpec(prim, name, kind)
    made.default = kind.defaultValue if value is None else value


def with_vectors(layer: Any) -> None:
    retype(layer, f"{ANIM}.rotations", TYPES.Float3Array, [(0, 0, 0)] * 4)


def with_words(layer: Any) -> None:
    retype(layer, f"{SKEL}.restTransforms", TYPES.StringArray, ["a"] * 4)


def with_a_lost_shape(layer: Any) -> None:
    spec = layer.GetObjectAtPath(f"{FACE}.skel:blendShapeTargets")
    spec.targetPathList.explicitItems = [Sdf.Path("/no")] * 2


def with_data_of_text(layer: Any) -> None:
    layer.GetPrimAtPath(SKEL).customData["animtool"] = "x"


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (with_vectors, "USD200"),
        (with_words, ""),
        (with_a_lost_shape, "USD208"),
        (with_data_of_text, ""),
    ],
)
def test_characters(
    good: Path, tmp_path: Path, change: Callable[[Any], None], code: str
) -> None:
    path = tmp_path / "odd.usda"
    layer = Sdf.Layer.OpenAsAnonymous(str(good))
    change(layer)
    layer.Export(str(path))
    # The one reads the motion, the other all that a rig has.
    done = [animtool("info", path), animtool("convert", path, tmp_path / "o.rig.yaml")]
    assert {one.code for one in done} <= {0, 3}
    faults = [one.stderr for one in done if one.code]
    assert all(code in text for text in faults)
    assert bool(faults) == bool(code)


@pytest.mark.parametrize("name", ["extent", "velocities", "points"])
def test_points_of_another_type(tmp_path: Path, name: str) -> None:
    path = tmp_path / "odd.usda"
    layer = Sdf.Layer.CreateNew(str(path))
    prim = Sdf.CreatePrimInLayer(layer, CACHE)
    prim.specifier, prim.typeName = Sdf.SpecifierDef, "Points"
    points = Sdf.AttributeSpec(prim, "points", TYPES.Point3fArray)
    layer.SetTimeSample(points.path, 1.0, [(0, 0, 0)])
    layer.SetTimeSample(points.path, 2.0, [(0, 1, 0)])
    if name == "points":
        prim.RemoveProperty(points)
    Sdf.AttributeSpec(prim, name, TYPES.Float).default = 1.0
    layer.Save()
    assert animtool("info", path).code in {0, 3}


def test_text_that_is_not_utf_8(tmp_path: Path) -> None:
    path = tmp_path / "odd.usda"
    path.write_bytes(b'#usda 1.0\ndef "a" {\n  float x\xfe = 1\n}\n')
    done = animtool("info", path)
    assert done.code == 3
    assert "USD001" in done.stderr
