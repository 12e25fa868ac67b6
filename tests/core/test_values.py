"""Records as plain values."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool.core.errors import Fault, Severity
from animtool.core.values import plain_value, template_values


@dataclass(frozen=True)
class Part:
    path: Path
    level: Severity
    sizes: object


def test_a_record_is_its_fields() -> None:
    part = Part(Path("a.usda"), Severity.NOTE, np.array([1.0, math.nan]))
    values = {"path": "a.usda", "level": "note", "sizes": [1.0, None]}
    assert plain_value([part]) == [values]
    assert plain_value(Fault("IO001", "no"))["code"] == "IO001"


def test_fields_are_picked_in_order_by_path() -> None:
    part = Part(Path("a"), Severity.ERROR, {"x": Fraction(1, 2)})
    found = template_values(part, "sizes name=path.name level")
    assert [*found] == ["sizes", "name", "level"]
    assert found == {"sizes": {"x": 0.5}, "name": "a", "level": "error"}
    assert type(found["level"]) is str
