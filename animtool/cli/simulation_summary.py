"""What a table of a simulation comes to, in lines and in JSON."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING

from animtool.core.errors import listed
from animtool.core.quantities import plain
from animtool.report.text import Each, Line, Table, render
from animtool.report.values import picked, plain_value

if TYPE_CHECKING:
    from animtool.scene.tables.simulation import SimulationTable
    from animtool.sim.trials.measuring import Reference, TrialRow, TrialTable
    from animtool.sim.trials.trial import Distances, Setting

LEGEND = "> the file's own   * none as exact is faster   + to take in its place"
_PART: tuple[Line, ...] = (
    "{name}: {kind}, {span:plain 4} s simulated",
    "[  compared with {reference.setting} at {instants} times, up to {points} points]",
    "[  which may be off by {reference.error.rms:mm} mm itself (rms)"
    "[; order {reference.order:.1f} seen]"
    "[{?reference.sensitive}: error not small, the motion is sensitive]]",
    Table(
        "tried",
        {
            "": "{self:marks}",
            "method": "{setting.method}",
            "setting": "{setting.options:options}",
            "seconds": "{seconds:plain}",
            "sim s/s": "{self:speed}",
            "steps": "{steps}",
            "largest mm": "{error.largest:mm}",
            "rms mm": "{error.rms:mm}",
            "median mm": "{error.median:mm}",
            "rms deg": "{error.angle:degrees}",
            "lone %": "[{?lone}{error.apart:hundredths}]",
            "energy %": "{energy_drift:hundredths}",
            "stretch %": "{stretch:hundredths}",
            " ": "{self:ending}",
        },
        left=("", "method", "setting", " "),
        optional=("rms deg", "lone %", "energy %", "stretch %"),
        indent="  ",
    ),
    Each("left_out", ("  left out: {value:list}: {key}",)),
    "[  {advice}]",
    "",
)


def simulation_table_text(table: SimulationTable) -> list[str]:
    """Return a table of settings, their cost and their error, for each simulation."""
    lines: list[str] = []
    for part in table.tables:
        tried = [row for row in part.rows if row.status is not None]
        lines += render(
            part,
            _PART,
            {**_PRINTERS, "speed": lambda row, span=part.span: _speed(row, span)},
            tried=tried,
            lone=any(row.error and row.error.apart for row in tried),
            left_out=_left_out(part),
            advice=_advice(part),
        )
    return [*lines, LEGEND]


def _speed(row: TrialRow, span: float) -> str:
    return plain(span / row.seconds) if row.seconds else ""


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


def _left_out(part: TrialTable) -> dict[str, list[str]]:
    """Return why methods are not for it, each reason once."""
    causes: dict[str, dict[str, None]] = {}
    for row in part.rows:
        if row.status is None:
            method = row.setting.method
            reason = row.reason.removeprefix(method).strip()
            causes.setdefault(reason, {})[method] = None
    return {reason: list(methods) for reason, methods in causes.items()}


def _advice(part: TrialTable) -> str:
    """Return what to take in place of the chosen setting, nothing where unknown."""
    chosen = next(row for row in part.rows if row.chosen)
    better = next((row for row in part.rows if row.recommended), None)
    if part.reference is None or part.reference.sensitive:
        return ""
    if better is None:
        return "nothing tried is as exact and much faster than the file's own"
    settings = listed([f"{name}: {value}" for name, value in _keys(better.setting)])
    if chosen.error is None:
        return f"the file's own does not work; {settings} does"
    share = better.seconds / chosen.seconds
    return f"{settings} is as exact in {share:.0%} of the time"


def _keys(setting: Setting) -> list[tuple[str, str]]:
    """Return a setting as the scene file has it."""
    options = [(name, f"{value:.6g}") for name, value in setting.options]
    named = [] if options[0][0] == "rate" else [("method", setting.method)]
    return named + options


_PRINTERS: dict[str, Callable[..., str]] = {
    "marks": _marks,
    "ending": _ending,
    "options": lambda options: ", ".join(f"{name} {own:.6g}" for name, own in options),
}


def simulation_table_json(table: SimulationTable) -> dict[str, object]:
    """Return a table as plain values: lengths in metres, angles in radians."""
    return {
        "simulation_table": "animtool/1",
        "source": str(table.source),
        "simulated": [
            {
                **picked(part, "name kind span instants points extent"),
                "reference": part.reference and _reference_json(part.reference),
                "rows": [_row_json(row, part.span) for row in part.rows],
            }
            for part in table.tables
        ],
        "notices": plain_value(table.notices),
    }


def _reference_json(reference: Reference) -> dict[str, object]:
    return {
        **_setting_json(reference.setting),
        "error": _distances_json(reference.error),
        **picked(reference, "order sensitive"),
    }


def _setting_json(setting: Setting) -> dict[str, object]:
    return {"method": setting.method, "options": dict(setting.options)}


def _row_json(row: TrialRow, span: float) -> dict[str, object]:
    return {
        **_setting_json(row.setting),
        "status": _status(row),
        **picked(row, "reason stable_step"),
        "seconds": round(row.seconds, 6),
        "simulated_per_second": span / row.seconds if row.seconds else None,
        "steps": row.steps,
        "error": None if row.error is None else _distances_json(row.error),
        **picked(row, "energy_drift stretch chosen best recommended"),
    }


def _distances_json(error: Distances) -> dict[str, float]:
    values = asdict(error)
    angle = values.pop("angle")
    return values if angle is None else {**values, "angle": angle}
