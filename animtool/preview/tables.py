"""Panels of the tables that commands measure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from animtool.preview.work_precision import Curve, Panel, Point

if TYPE_CHECKING:
    from animtool.scene.ik_table import IkTable, IkTableRow
    from animtool.scene.simulation_table import SimulationTable
    from animtool.scene.table import BakeTable
    from animtool.sim.trials.measuring import TrialTable


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


def ik_panels(table: IkTable, name: str) -> list[Panel]:
    """Return a panel of positions, and one of angles where any is missed.

    Each has a line over tolerances, and a point for each method at the tolerance that
    is asked for. Methods that cannot solve the problem are left out.
    """
    errors = {"position": "largest miss [m]"}
    if any(row.angle > 0 for row in (*table.tolerances, *table.methods)):
        errors["angle"] = "largest miss [rad]"
    lines = [("over tolerances", table.tolerances)]
    lines += [(str(row.method), [row]) for row in table.methods]
    return [
        Panel(
            f"{name}, {what}s",
            error,
            tuple(
                curve for line, rows in lines if (curve := _solved(line, rows, what))
            ),
            time="seconds a frame",
        )
        for what, error in errors.items()
    ]


def _solved(line: str, rows: Sequence[IkTableRow], what: str) -> Curve | None:
    points = tuple(
        Point(row.microseconds / 1e6, float(getattr(row, what)))
        for row in rows
        if not row.refused
    )
    return Curve(line, points) if points else None
