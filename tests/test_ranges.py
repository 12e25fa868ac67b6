"""Ranges of numbers that records declare."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import pytest

from animtool.core.options import (
    ENTRY_RANGE_MESSAGE,
    Range,
    above,
    at_least,
    or_more,
    range_faults,
)
from animtool.systems.springs.spec import RopeModel

RANGES = {
    "above": (above(1, "SIM004"), [1.5, math.inf, None], [1, 0, -math.inf, math.nan]),
    "or more": (or_more(1, "SIM004"), [1, math.inf, None], [0.5, math.nan]),
    "at least": (at_least(1, "SIM004"), [1, math.inf, None], [0.5, math.nan]),
    "finite": (or_more(0, "SIM004", finite=True), [0, 1e300], [math.inf, math.nan]),
    "most": (Range("0 to 1", "SIM004", 0, 1), [0, 0.5, 1], [-0.1, 1.1, math.nan]),
    "vector": (
        Range("two numbers of 0 or more", "SIM004", 0, finite=True, count=2),
        [(0, 1), [2.0, 0.5], None],
        [(0, -1), (math.nan, 1), (1, math.inf), (1,), (1, 2, 3)],
    ),
}


@pytest.mark.parametrize("name", RANGES)
def test_what_is_in_range(name: str) -> None:
    allowed, inside, outside = RANGES[name]
    assert all(allowed.holds(value) for value in inside)
    assert not any(allowed.holds(value) for value in outside)


@dataclass(frozen=True)
class Rope:
    length: Annotated[float, above(0, "SIM004", finite=True)]
    tear: Annotated[float | None, at_least(2, "SIM042")] = None
    name: str = ""


def test_every_number_is_checked_by_its_own_range() -> None:
    assert range_faults(Rope(length=1.0)) == []
    faults = range_faults(Rope(length=-1.0, tear=1.0))
    assert [(fault.code, fault.where, fault.message) for fault in faults] == [
        ("SIM004", "length", "length must be finite and above 0, not -1"),
        ("SIM042", "tear", "tear must be at least 2, not 1"),
    ]


def test_models_of_files_declare_ranges_too() -> None:
    keys = {"from": [0, 1, 0], "to": [1, 1, 0], "count": 3, "mass": 1.0, "springs": {}}
    assert range_faults(RopeModel(**keys)) == []
    faults = range_faults(
        RopeModel(**keys, drag=-1.0, speed_limit=0.0), ENTRY_RANGE_MESSAGE
    )
    assert [(fault.code, fault.where, fault.message) for fault in faults] == [
        ("SIM050", "drag", "its drag must be 0 or more, not -1"),
        ("SIM050", "speed_limit", "its speed_limit must be above 0, not 0"),
    ]
