"""Animations of a stage as takes: what they cost on a stage of many characters."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pxr import Sdf, Usd

from animtool.usd.checks.checked_stage import CheckedStage
from animtool.usd.checks.takes import animation_takes

CHARACTER = """
    def SkelRoot "R{0}"
    {{
        def Skeleton "S" (prepend apiSchemas = ["SkelBindingAPI"])
        {{
            uniform token[] joints = ["a"]
            uniform matrix4d[] restTransforms = [
                ((1,0,0,0), (0,1,0,0), (0,0,1,0), (0,0,0,1))
            ]
            rel skel:animationSource = </R{0}/A>
        }}
        def SkelAnimation "A"
        {{
            uniform token[] joints = ["a"]
            float3[] translations.timeSamples = {{ 1: [(0, 0, 0)], {1}: [(1, 0, 0)] }}
            quatf[] rotations = [(1, 0, 0, 0)]
            half3[] scales = [(1, 1, 1)]
        }}
    }}
"""


def crowd(lasts: list[int]) -> CheckedStage:
    layer = Sdf.Layer.CreateAnonymous(".usda")
    header = "#usda 1.0\n(\n    startTimeCode = 1\n    endTimeCode = 9\n)\n"
    characters = [CHARACTER.format(i, last) for i, last in enumerate(lasts)]
    assert layer.ImportFromString(header + "".join(characters))
    return CheckedStage(Usd.Stage.Open(layer))


def test_a_crowd_costs_no_more_a_character_than_a_few(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[Any] = []
    times = CheckedStage.times
    monkeypatch.setattr(
        CheckedStage,
        "times",
        lambda self, attr: calls.append(attr) or times(self, attr),
    )

    def cost(count: int) -> int:
        calls.clear()
        assert len(animation_takes(crowd([9] * count), Path("crowd.usda"))) == count
        return len(calls)

    assert cost(32) == 4 * cost(8)


def test_a_range_is_about_the_animations_that_fill_the_stage() -> None:
    takes = animation_takes(crowd([9, 5, 9]), Path("crowd.usda"))
    assert [take.frame_range for take in takes] == [(1.0, 9.0), None, (1.0, 9.0)]
