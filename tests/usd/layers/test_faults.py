"""Values of USD attributes with another type than their schema's."""

from __future__ import annotations

from typing import Any

import pytest
from pxr import Sdf, Usd, Vt

from animtool.usd.layers.faults import token_array


@pytest.mark.parametrize(
    ("type_name", "value", "tokens"),
    [
        ("token[]", Vt.TokenArray(["a", "b"]), ["a", "b"]),
        ("string[]", Vt.StringArray(["a"]), ["a"]),
        ("float", 1.0, []),
        ("token", "ab", []),
        ("int[]", Vt.IntArray([1]), []),
        ("token[]", None, []),
    ],
)
def test_only_names_are_tokens(type_name: str, value: Any, tokens: list[str]) -> None:
    stage = Usd.Stage.CreateInMemory()
    prim = stage.DefinePrim("/A")
    attribute = prim.CreateAttribute("joints", Sdf.ValueTypeNames.Find(type_name))
    if value is not None:
        attribute.Set(value)
    assert token_array(attribute) == tokens
