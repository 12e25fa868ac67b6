"""Values of any type in any place end in findings, not in a traceback."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pxr import Gf, Sdf, Usd, Vt
from support.suite import every_other, some_quick

from animtool.usd.checks.run import check_stage
from animtool.usd.layers.stderr import without_usd_warnings

LAYER = Path(__file__).with_name("pages.usda")
TYPES = Sdf.ValueTypeNames
VALUES = {
    TYPES.String: "text",
    TYPES.Int: 3,
    TYPES.FloatArray: Vt.FloatArray([1.0, 2.0]),
    TYPES.TokenArray: Vt.TokenArray(["a", "b", "c"]),
    TYPES.Matrix4dArray: Vt.Matrix4dArray([Gf.Matrix4d(1)] * 3),
    TYPES.QuatfArray: Vt.QuatfArray([Gf.Quatf(1)]),
    TYPES.Bool: True,
}


def attributes() -> list[str]:
    """Return the paths of the attributes of the layer."""
    found: list[str] = []
    layer = Sdf.Layer.FindOrOpen(str(LAYER))

    def look(path: Sdf.Path) -> None:
        if path.IsPropertyPath() and layer.GetAttributeAtPath(path):
            found.append(str(path))

    layer.Traverse(Sdf.Path.absoluteRootPath, look)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("kind", some_quick(VALUES, 6), ids=str)
@pytest.mark.parametrize("place", ["default", "sample"])
def test_a_value_of_another_type_is_no_traceback(kind: Any, place: str) -> None:
    whole = Sdf.Layer.FindOrOpen(str(LAYER))
    # In each place half of them, the others in the other; all in the full profile.
    names, turn = attributes(), (place == "sample") ^ (list(VALUES).index(kind) % 2)
    for name in every_other(names, turn):
        layer = Sdf.Layer.CreateAnonymous(".usda")
        layer.TransferContent(whole)
        old = layer.GetAttributeAtPath(name)
        owner, leaf = old.owner, old.name
        if old.typeName == kind:
            continue
        owner.RemoveProperty(old)
        made = Sdf.AttributeSpec(owner, leaf, kind)
        if place == "default":
            made.default = VALUES[kind]
        else:
            layer.SetTimeSample(made.path, 2.0, VALUES[kind])
        with without_usd_warnings():
            assert check_stage(Usd.Stage.Open(layer))
