"""Markers whose sides are swapped, and captures in which they are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.marked import FIGURE, TEMPLATE, captured, moving

from animtool.capture.solve.run import solve_markers
from animtool.maths import so3
from animtool.motion.markers import Markers


def codes(markers: Markers) -> list[str]:
    solve = solve_markers(markers, FIGURE, TEMPLATE)
    return [notice.code for notice in solve.notices]


def swapped(markers: Markers, *stems: str) -> Markers:
    """Return markers with the names of some left and right ones swapped."""
    other = {"L": "R", "R": "L"}
    names = tuple(
        other[name[0]] + name[1:]
        if name[1:] in stems and other.get(name[0], "") + name[1:] in markers.names
        else name
        for name in markers.names
    )
    return replace(markers, names=names)


@pytest.mark.parametrize(
    "stems",
    [("ASI", "UPA", "ELB", "WRA", "WRB"), ("ELB",)],
)
def test_swapped_sides_are_named(stems: tuple[str, ...]) -> None:
    markers = captured(moving(40, 100, 3)).markers
    found = codes(swapped(markers, *stems))
    assert found.count("SOL109") == 1
    assert "SOL107" not in found


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_right_sides_are_not(seed: int) -> None:
    markers = captured(moving(40, 100, seed)).markers
    assert "SOL109" not in codes(markers)
    turned = so3.rotate(
        so3.from_axis_angle((0, 1, 0), np.array(2.0)), markers.positions
    )
    assert "SOL109" not in codes(replace(markers, positions=turned))
    larger = replace(markers, positions=1.15 * markers.positions)
    assert "SOL109" not in codes(larger)
    noisy = captured(moving(40, 100, seed), noise=0.01).markers
    assert "SOL109" not in codes(noisy)


def test_another_subject_is_no_swap() -> None:
    markers = captured(moving(40, 100, 1)).markers
    longer = markers.positions.copy()
    longer[..., 1] *= 1.3
    found = codes(replace(markers, positions=longer))
    assert "SOL109" not in found


def test_mirrored_offsets_are_named() -> None:
    markers = captured(moving(40, 100, 3)).markers
    mirrored = replace(
        TEMPLATE,
        markers=tuple(
            replace(m, offset=(-m.offset[0], *m.offset[1:])) for m in TEMPLATE.markers
        ),
    )
    notices = solve_markers(markers, FIGURE, mirrored).notices
    hints = [notice.hint for notice in notices if notice.code == "SOL107"]
    assert hints == ["negate x of all offsets in the template"]
