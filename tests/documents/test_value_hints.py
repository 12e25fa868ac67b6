"""The right form of a value: made of what was written, where that is clear."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import BaseModel, Field

from animtool.documents.value_hints import example_hint, syntax_hint


class Shown(BaseModel):
    gravity: list[float] = Field(examples=[[0, -1.62, 0]])
    keys: list[dict[str, int]] = Field(examples=[[{"t": 1, "v": 0}]])
    passes: list[dict[str, int]] = Field(examples=[[{"mirror": 0}, {"loop": 1}]])
    range: list[int] = Field(examples=[[1, 48]])
    spans: list[list[int]] = Field(examples=[[[12, 30], [48, 60]]])
    pins: list[dict[str, list[str]]] = Field(examples=[[{"particles": ["start"]}]])
    t: float = Field(examples=[12.5])


@pytest.mark.parametrize(
    ("key", "given", "hint"),
    [
        ("gravity", -9.81, "write gravity: [0, -9.81, 0]"),
        # Gravity points to the side of the example.
        ("gravity", 9.81, "write gravity: [0, -9.81, 0]"),
        ("gravity", "down", "for example gravity: [0, -1.62, 0]"),
        ("range", "3-9", "write range: [3, 9]"),
        ("range", "-4 - 12", "write range: [-4, 12]"),
        ("range", "3", "for example range: [1, 48]"),
        ("range", [1, 25, 2], "write range: [1, 25]"),
        ("keys", [[1, 0], [5, 2]], "write keys: [{t: 1, v: 0}, {t: 5, v: 2}]"),
        ("passes", {"trim": {}, "loop": {}}, "write passes: [{trim: {}}, {loop: {}}]"),
        ("passes", [{"trim": 1, "loop": 2}], "write passes: [{trim: 1}, {loop: 2}]"),
        ("gravity", "0 -9.81 0", "write gravity: [0, -9.81, 0]"),
        ("spans", [1, 40], "write spans: [[1, 40]]"),
    ],
)
def test_a_hint_is_made_of_what_was_written(key: str, given: Any, hint: str) -> None:
    assert syntax_hint(Shown, {key: given}, (key,), expects_list=True) == hint


class Pair(BaseModel):
    source: str
    target: str
    role: str = ""


class Named(BaseModel):
    name: str
    size: float = 1.0


class Lists(BaseModel):
    pairs: list[Pair] = Field(examples=[[{"source": "a", "target": "b"}]])
    parts: list[Named] = Field(examples=[[{"name": "a"}]])


@pytest.mark.parametrize(
    ("key", "given", "hint"),
    [
        ("pairs", {"Hips": "hips"}, "write pairs: [{source: Hips, target: hips}]"),
        (
            "pairs",
            {"source": "a", "target": "b"},
            "write pairs: [{source: a, target: b}]",
        ),
        ("parts", {"leg": {"size": 2}}, "write parts: [{name: leg, size: 2}]"),
        (
            "pairs",
            {f"bone{i}": "x" * 20 for i in range(9)},
            f"for example pairs: [{{source: bone0, target: {'x' * 20}}}]",
        ),
        ("pairs", {"Hips": 3}, "for example pairs: [{source: a, target: b}]"),
    ],
)
def test_a_mapping_becomes_the_entries_of_a_list(
    key: str, given: Any, hint: str
) -> None:
    assert syntax_hint(Lists, {key: given}, (key,), expects_list=True) == hint


def test_names_in_place_of_a_group() -> None:
    for names, hint in (
        (["left", "right"], "write pins: [{particles: [left, right]}]"),
        (["left", 3], None),
    ):
        location = ("pins", 0)
        assert syntax_hint(Shown, {"pins": names}, location, expects_list=False) == hint


def test_a_time_code_in_place_of_a_frame() -> None:
    hint = example_hint(Shown, {"t": "00:00:01:00"}, ("t",))
    assert hint == "times are frame numbers, for example t: 12.5"
    assert example_hint(Shown, {"t": "soon"}, ("t",)) == "for example t: 12.5"
