"""Panels of tables."""

from __future__ import annotations

from animtool.ik.methods import IkMethod
from animtool.preview.tables import ik_panels
from animtool.scene.ik_table import IkTable, IkTableRow


def row(
    method: IkMethod, position: float, angle: float, refused: str = ""
) -> IkTableRow:
    return IkTableRow(
        "x", 1e-3, 1e-3, method, refused, 250.0, position, angle, 3.0, 1.0
    )


def table(angle: float) -> IkTable:
    first, second, third = list(IkMethod)[:3]
    return IkTable(
        5,
        7,
        [row(first, 10.0**-n, angle) for n in (2, 3)],
        [row(second, 1e-4, angle), row(third, 1.0, angle, "it cannot")],
    )


def test_a_line_over_tolerances_and_a_point_for_each_method() -> None:
    (panel,) = ik_panels(table(0.0), "reach")
    assert (panel.title, panel.time) == ("reach, positions", "seconds a frame")
    names = [curve.name for curve in panel.curves]
    assert names == ["over tolerances", str(list(IkMethod)[1])]
    points = panel.curves[0].points
    assert [(p.seconds, p.error) for p in points] == [(250e-6, 1e-2), (250e-6, 1e-3)]


def test_angles_have_a_panel_where_any_is_missed() -> None:
    _, angles = ik_panels(table(0.5), "reach")
    assert angles.error.endswith("[rad]")
    assert {p.error for curve in angles.curves for p in curve.points} == {0.5}
