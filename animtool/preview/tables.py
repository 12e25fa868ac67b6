"""Panels of the tables that commands measure."""

from __future__ import annotations

from typing import TYPE_CHECKING

from animtool.preview.work_precision import Curve, Panel, Point

if TYPE_CHECKING:
    from animtool.scene.simulation_table import SimulationTable
    from animtool.scene.table import BakeTable
    from animtool.sim.trials.measuring import TrialTable

__all__ = ["bake_panels", "simulation_panels"]


def simulation_panels(table: SimulationTable) -> list[Panel]:
    """Return a panel for each simulation, with a curve for each method."""
    return [_simulated(part) for part in table.tables]


def _simulated(part: TrialTable) -> Panel:
    found: dict[str, list[Point]] = {}
    for row in part.rows:
        if row.error is not None:
            point = Point(row.seconds, row.error.rms, row.chosen, row.best)
            found.setdefault(row.setting.method, []).append(point)
    curves = tuple(Curve(name, tuple(points)) for name, points in found.items())
    reference = part.reference
    remark, floor = "", 0.0
    if reference is not None:
        floor = reference.error.rms
        if reference.sensitive:
            remark = "error not small: the motion is sensitive"
    return Panel(f"{part.name}, {part.kind}", "error, rms [m]", curves, floor, remark)


def bake_panels(table: BakeTable) -> list[Panel]:
    """Return one panel, with a curve for each kind of row."""
    found: dict[str, list[Point]] = {}
    for row in table.rows:
        found.setdefault(str(row.kind), []).append(Point(row.seconds, row.error))
    curves = tuple(Curve(name, tuple(points)) for name, points in found.items())
    return [Panel(table.source.name, "largest error [m]", curves)]
