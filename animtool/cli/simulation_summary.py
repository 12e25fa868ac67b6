"""What a table of a simulation comes to, in words and in JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from animtool.cli.console import columns, finite
from animtool.core.errors import listed
from animtool.core.quantities import plain

if TYPE_CHECKING:
    from animtool.scene.tables.simulation import SimulationTable
    from animtool.sim.trials.measuring import Reference, TrialRow, TrialTable
    from animtool.sim.trials.trial import Distances, Setting

LEGEND = "> the file's own   * none as exact is faster   + to take in its place"


def simulation_table_text(table: SimulationTable) -> list[str]:
    """Return a table of settings, their cost and their error, for each simulation."""
    lines: list[str] = []
    for part in table.tables:
        lines += [*_part_text(part), ""]
    return [*lines, LEGEND]


def _part_text(part: TrialTable) -> list[str]:
    lines = [f"{part.name}: {part.kind}, {plain(part.span, 4)} s simulated"]
    if part.reference is not None:
        lines += _reference_text(part, part.reference)
    lines += [f"  {line}" for line in _grid(part)]
    lines += [f"  {reason}" for reason in _left_out(part)]
    return lines + _advice(part)


def _reference_text(part: TrialTable, reference: Reference) -> list[str]:
    off = f"may be off by {_millimetres(reference.error.rms)} mm itself (rms)"
    if reference.order is not None:
        off += f"; order {reference.order:.1f} seen"
    if reference.sensitive:
        off += ": error not small, the motion is sensitive"
    return [
        f"  compared with {reference.setting} at {part.instants} times, "
        f"up to {part.points} points",
        f"  which {off}",
    ]


def _millimetres(meters: float) -> str:
    return plain(meters * 1000)


def _grid(part: TrialTable) -> list[str]:
    """Return the rows that were simulated, in columns."""
    rows = [row for row in part.rows if row.status is not None]
    heads = ["", "method", "setting", "seconds", "sim s/s", "steps"]
    heads += ["largest mm", "rms mm", "median mm"]
    optional = _optional(rows)
    lines = [[*heads, *optional, ""]]
    for i, row in enumerate(rows):
        own = [values[i] for values in optional.values()]
        lines.append([*_cells(row, part.span), *own, _ending(row)])
    return columns(lines, {0, 1, 2, len(lines[0]) - 1})


def _cells(row: TrialRow, span: float) -> list[str]:
    error = row.error
    sizes = ["", "", ""]
    if error is not None:
        each = (error.largest, error.rms, error.median)
        sizes = [_millimetres(size) for size in each]
    return [
        _marks(row),
        row.setting.method,
        ", ".join(f"{name} {value:.6g}" for name, value in row.setting.options),
        plain(row.seconds),
        plain(span / row.seconds) if row.seconds else "",
        str(row.steps),
        *sizes,
    ]


def _optional(rows: list[TrialRow]) -> dict[str, list[str]]:
    """Return columns that only some simulations have."""
    errors = [row.error for row in rows]
    apart = [None if error is None else error.apart for error in errors]
    columns = {
        "rms deg": [
            None if error is None or error.angle is None else math.degrees(error.angle)
            for error in errors
        ],
        "lone %": _percent(apart if any(apart) else []),
        "energy %": _percent([row.energy_drift for row in rows]),
        "stretch %": _percent([row.stretch for row in rows]),
    }
    return {
        head: ["" if value is None else plain(value) for value in values]
        for head, values in columns.items()
        if any(value is not None for value in values)
    }


def _percent(values: Sequence[float | None]) -> list[float | None]:
    return [None if value is None else 100 * value for value in values]


def _marks(row: TrialRow) -> str:
    marks = {">": row.chosen, "*": row.best, "+": row.recommended}
    return "".join(mark for mark, given in marks.items() if given)


def _ending(row: TrialRow) -> str:
    """Return why a row has no error, empty where it has one."""
    if not row.reason:
        return ""
    text = f"{_status(row)}: {row.reason}"
    step = row.stable_step
    if step == 0:
        text += "; no step is stable"
    elif step is not None and math.isfinite(step):
        text += f"; steps up to {plain(step)} s are stable"
    return text


def _status(row: TrialRow) -> str:
    if row.status is None:
        return "left out"
    return "blew up" if row.status == "unstable" else str(row.status)


def _left_out(part: TrialTable) -> list[str]:
    """Return why methods are not for it, each reason once."""
    causes: dict[str, dict[str, None]] = {}
    for row in part.rows:
        if row.status is None:
            method = row.setting.method
            reason = row.reason.removeprefix(method).strip()
            causes.setdefault(reason, {})[method] = None
    return [
        f"left out: {listed(list(methods))}: {reason}"
        for reason, methods in causes.items()
    ]


def _advice(part: TrialTable) -> list[str]:
    """Return what to take in place of the chosen setting."""
    chosen = next(row for row in part.rows if row.chosen)
    better = next((row for row in part.rows if row.recommended), None)
    if part.reference is None or part.reference.sensitive:
        return []
    if better is None:
        return ["  nothing tried is as exact and much faster than the file's own"]
    settings = listed([f"{name}: {value}" for name, value in _keys(better.setting)])
    if chosen.error is None:
        return [f"  the file's own does not work; {settings} does"]
    share = better.seconds / chosen.seconds
    return [f"  {settings} is as exact in {share:.0%} of the time"]


def _keys(setting: Setting) -> list[tuple[str, str]]:
    """Return a setting as the scene file has it."""
    options = [(name, f"{value:.6g}") for name, value in setting.options]
    named = [] if options[0][0] == "rate" else [("method", setting.method)]
    return named + options


def simulation_table_json(table: SimulationTable) -> dict[str, object]:
    """Return a table as plain values: lengths in metres, angles in radians."""
    return {
        "simulation_table": "animtool/1",
        "source": str(table.source),
        "simulated": [_part_json(part) for part in table.tables],
        "notices": [notice.as_dict() for notice in table.notices],
    }


def _part_json(part: TrialTable) -> dict[str, object]:
    compared = part.reference
    reference = None
    if compared is not None:
        reference = {
            **_setting_json(compared.setting),
            "error": _distances_json(compared.error),
            "order": compared.order,
            "sensitive": compared.sensitive,
        }
    return {
        "name": part.name,
        "kind": part.kind,
        "span": part.span,
        "instants": part.instants,
        "points": part.points,
        "extent": part.extent,
        "reference": reference,
        "rows": [_row_json(row, part.span) for row in part.rows],
    }


def _setting_json(setting: Setting) -> dict[str, object]:
    return {"method": setting.method, "options": dict(setting.options)}


def _row_json(row: TrialRow, span: float) -> dict[str, object]:
    return {
        **_setting_json(row.setting),
        "status": _status(row),
        "reason": row.reason,
        "stable_step": finite(row.stable_step),
        "seconds": round(row.seconds, 6),
        "simulated_per_second": span / row.seconds if row.seconds else None,
        "steps": row.steps,
        "error": None if row.error is None else _distances_json(row.error),
        "energy_drift": finite(row.energy_drift),
        "stretch": finite(row.stretch),
        "chosen": row.chosen,
        "best": row.best,
        "recommended": row.recommended,
    }


def _distances_json(error: Distances) -> dict[str, float]:
    values = asdict(error)
    angle = values.pop("angle")
    return values if angle is None else {**values, "angle": angle}
