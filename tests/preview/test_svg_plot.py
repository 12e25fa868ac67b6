"""Plots as SVG."""

from __future__ import annotations

import math
import re
from xml.etree import ElementTree as ET

from animtool.preview.svg_plot import (
    BOTTOM_MARGIN,
    HEIGHT,
    LEFT_MARGIN,
    RIGHT_MARGIN,
    TOP_MARGIN,
    WIDTH,
    plot_svg,
)
from animtool.preview.work_precision import Panel, PrecisionCurve, PrecisionPoint

SVG = "{http://www.w3.org/2000/svg}"


def panel(*points: PrecisionPoint, floor: float = 0.0) -> Panel:
    return Panel(
        "a < b & c", "error [m]", (PrecisionCurve("one & two", points),), floor=floor
    )


def test_points_stand_where_their_logarithms_say() -> None:
    made = panel(
        PrecisionPoint(1.0, 1e-1),
        PrecisionPoint(10.0, 1e-3, is_best=True),
        PrecisionPoint(100.0, 1e-5),
    )
    root = ET.fromstring(plot_svg(made))
    found = [
        (float(c.get("cx", 0)), float(c.get("cy", 0)))
        for c in root.iter(f"{SVG}circle")
    ]
    (x0, y0), (x1, y1), (x2, y2) = found
    assert math.isclose(x1 - x0, x2 - x1, abs_tol=0.11)
    assert math.isclose(y1 - y0, y2 - y1, abs_tol=0.11)
    # A margin of a twentieth at each end.
    share = (WIDTH - RIGHT_MARGIN - LEFT_MARGIN) / 1.1
    assert math.isclose(x2 - x0, share, abs_tol=0.2)
    assert math.isclose(
        y2 - y0, (HEIGHT - BOTTOM_MARGIN - TOP_MARGIN) / 1.1, abs_tol=0.2
    )


def test_names_are_escaped_and_points_without_a_logarithm_are_left_out() -> None:
    made = panel(
        PrecisionPoint(0.0, 1e-1),
        PrecisionPoint(1.0, 0.0),
        PrecisionPoint(1.0, math.nan),
        PrecisionPoint(2.0, 0.1),
    )
    text = plot_svg(made)
    assert "one &amp; two" in text
    assert text.count("<circle") == 1
    ET.fromstring(text)


def test_the_present_one_has_a_ring_and_what_to_take_a_square() -> None:
    text = plot_svg(
        panel(
            PrecisionPoint(1.0, 0.1, is_current=True),
            PrecisionPoint(2.0, 0.01, is_recommended=True),
        )
    )
    assert len(re.findall('class="ring"', text)) == 2
    assert text.count("<rect") == 1


def test_the_front_joins_what_nothing_beats_in_order() -> None:
    best = [
        PrecisionPoint(4.0, 0.01, is_best=True),
        PrecisionPoint(1.0, 0.1, is_best=True),
    ]
    text = plot_svg(panel(*best, PrecisionPoint(2.0, 0.2)))
    (front,) = re.findall('class="front" d="M([^"]*)"', text)
    xs = [float(part.split()[0]) for part in front.split("L")]
    assert xs == sorted(xs)
    assert len(xs) == 2


def test_nothing_to_draw_is_said() -> None:
    assert "nothing to draw" in plot_svg(panel())
    assert 'class="floor"' in plot_svg(panel(PrecisionPoint(1.0, 0.1), floor=1e-4))
