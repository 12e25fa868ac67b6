"""The right form of a value: made of what was written, where that is clear."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import BaseModel, Field

from animtool.documents.forms import form_hint


class Shown(BaseModel):
    gravity: list[float] = Field(examples=[[0, -1.62, 0]])
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
        ("spans", [1, 40], "write spans: [[1, 40]]"),
    ],
)
def test_a_hint_is_made_of_what_was_written(key: str, given: Any, hint: str) -> None:
    assert form_hint(Shown, {key: given}, (key,), expects_list=True) == hint
