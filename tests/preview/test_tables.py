"""Panels of tables."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from animtool.ik.options import IkMethod
from animtool.preview.tables import ik_panels, simulation_panels
from animtool.preview.work_precision import Curve, Panel, Point
from animtool.scene.ik_table import IkTable, IkTableRow
from animtool.scene.simulation_table import SimulationTable
from animtool.sim.trials.measuring import Reference, TrialRow, TrialTable
from animtool.sim.trials.trial import Distances, Setting


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


def simulated(reference: Reference | None) -> Panel:
    rows = [
        TrialRow(Setting(name, ()), seconds, error=error and Distances(9.0, error, 8.0))
        for name, seconds, error in (
            ("rk4", 0.1, 1e-3), ("euler", 0.2, 1e-1), ("rk4", 0.3, 1e-5), ("x", 9, None)
        )
    ]  # fmt: skip
    rows[2] = replace(rows[2], best=True, chosen=True)
    part = TrialTable("rope", "springs", 1.0, 3, 4, 1.0, reference, rows)
    (panel,) = simulation_panels(SimulationTable(Path("a.scene.yaml"), [part]))
    return panel


def test_a_simulation_has_a_curve_for_each_method() -> None:
    panel = simulated(None)
    assert (panel.title, panel.floor, panel.remark) == ("rope, springs", 0.0, "")
    assert panel.curves == (
        Curve("rk4", (Point(0.1, 1e-3), Point(0.3, 1e-5, chosen=True, best=True))),
        Curve("euler", (Point(0.2, 1e-1),)),
    )


def test_the_reference_is_the_floor_and_a_sensitive_motion_is_remarked() -> None:
    finest = Setting("rk4", ()), Distances(1.0, 1e-7, 2.0), 4.0
    calm = simulated(Reference(*finest, sensitive=False))
    assert (calm.floor, calm.remark) == (1e-7, "")
    assert "sensitive" in simulated(Reference(*finest, sensitive=True)).remark
