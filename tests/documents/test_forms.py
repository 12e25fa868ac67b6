"""The right form of a value: made of what was written, where that is clear."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import BaseModel, Field

from animtool.documents.forms import form_hint


class Shown(BaseModel):
    gravity: list[float] = Field(examples=[[0, -1.62, 0]])
    keys: list[dict[str, int]] = Field(examples=[[{"t": 1, "v": 0}]])
    joints: list[dict[str, str]] = Field(examples=[[{"name": "hips", "type": "free"}]])
    passes: list[dict[str, int]] = Field(examples=[[{"mirror": 0}, {"loop": 1}]])
    range: list[int] = Field(examples=[[1, 48]])
    spans: list[list[int]] = Field(examples=[[[12, 30], [48, 60]]])


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
        ("keys", {"a": "b"}, "write keys: [{t: a, v: b}]"),
        ("joints", {"a": {"type": "pin"}}, "write joints: [{name: a, type: pin}]"),
        ("passes", {"trim": {}, "loop": {}}, "write passes: [{trim: {}}, {loop: {}}]"),
        ("passes", [{"trim": 1, "loop": 2}], "write passes: [{trim: 1}, {loop: 2}]"),
        ("gravity", "0 -9.81 0", "write gravity: [0, -9.81, 0]"),
        ("spans", [1, 40], "write spans: [[1, 40]]"),
    ],
)
def test_a_hint_is_made_of_what_was_written(key: str, given: Any, hint: str) -> None:
    assert form_hint(Shown, {key: given}, (key,), expects_list=True) == hint
