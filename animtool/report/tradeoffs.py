"""What tables of time against error come to, in lines and in JSON."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from animtool.core.quantities import length_text, plain
from animtool.core.record import dataclass
from animtool.report.text import Each, Line, Table, render, table_cells
from animtool.report.values import picked, plain_value
from animtool.sim.trials.trial import CostMeasure, ErrorMeasure

if TYPE_CHECKING:
    from animtool.scene.tables.tradeoffs import Tradeoffs
    from animtool.sim.trials.measuring import Reference, TrialRow, TrialTable
    from animtool.sim.trials.trial import Distances, Setting

LEGEND = "> the present setting   * none as exact is cheaper   + to take in its place"
_HEAD: tuple[Line, ...] = (
    "{name}: {kind}, {span:plain 4} s",
    "[  compared with {reference.setting}[{?points} at {instants} times, up to "
    "{points:n point}]]",
    "[{?reference.error.rms}  which may be off by {reference.error.rms:milli} mm "
    "itself (rms)[; order {reference.order:.1f} seen]"
    "[{?reference.sensitive}: error not small, the motion is sensitive]]",
)
_ADVICE: tuple[Line, ...] = (
    Each("left_out", ("  left out: {value:list}: {key}",)),
    "[  {advice}]",
)
_FOOT: tuple[Line, ...] = (*_ADVICE, Each("lines", ("    {self}",)), "")
_COLUMNS = {
    "": "{self:marks}",
    "method": "{setting.method}",
    "setting": "{setting.options:options}",
    "seconds": "{seconds:plain}",
    "work": "{steps}",
    "kB": "[{?bytes}{bytes:kB}]",
    "largest mm": "{error.largest:milli}",
    "rms mm": "{error.rms:milli}",
    "median mm": "{error.median:milli}",
    "rms deg": "{error.angle:degrees}",
    "lone %": "[{?lone}{error.apart:hundredths}]",
    "energy %": "{energy_drift:share}",
    "stretch %": "{figures.stretch:hundredths}",
    "depth mm": "{figures.depth:milli}",
    "pierced": "{figures.pierced:g}",
    "miss mm": "{figures.miss:milli}",
    "miss deg": "{figures.miss_angle:turn}",
    "reached %": "{figures.reached:hundredths}",
    "worst": "{worst}",
    " ": "{self:ending}",
}
# Of points that are compared one by one; others say where the largest distance is.
_OF_RMS = ("rms mm", "median mm")
_ALWAYS = ("", "method", "setting", "seconds", "work", "largest mm", *_OF_RMS, " ")


def tradeoffs_text(report: Tradeoffs) -> list[str]:
    """Return a table of settings, their cost and their error, for each thing made."""
    lines: list[str] = []
    for part in report.tables:
        template = (*_HEAD, _table(part), *_FOOT)
        lines += render(part, template, _PRINTERS, **_facts(part))
    return [*lines, LEGEND]


@dataclass(frozen=True, slots=True)
class TableParts:
    """A table in parts, for a page."""

    head: list[str]  # what it is of, and what it was compared with
    rows: list[list[str]]  # cells, heads first
    left: set[int]  # columns that are flush left
    classes: list[str]  # of each row below the heads, ``chosen`` or ``recommended``
    advice: list[str]


def table_parts(part: TrialTable) -> TableParts:
    """Return the parts of a table."""
    facts = _facts(part)
    rows, left = table_cells(part, _table(part), _PRINTERS, **facts)
    classes = [
        "chosen" if row.chosen else "recommended" if row.recommended else ""
        for row in facts["tried"]
    ]
    return TableParts(
        render(part, _HEAD, _PRINTERS, **facts),
        rows,
        left,
        classes,
        render(part, _ADVICE, _PRINTERS, **facts),
    )


def _facts(part: TrialTable) -> dict[str, Any]:
    tried = [row for row in part.rows if row.status is not None]
    return {
        "tried": tried,
        "lone": any(row.error and row.error.apart for row in tried),
        "left_out": _left_out(part),
        "advice": _advice(part),
    }


def _table(part: TrialTable) -> Table:
    columns = {
        part.unit if head == "work" else head: cell
        for head, cell in _COLUMNS.items()
        if part.error is ErrorMeasure.RMS or head not in _OF_RMS
    }
    optional = tuple(head for head in _COLUMNS if head not in _ALWAYS)
    left = ("", "method", "setting", "worst", " ")
    return Table("tried", columns, left, optional, "  ")


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
    if part.reference is None or part.reference.sensitive:
        return ""
    better, chosen = part.recommended, part.chosen
    if part.budget is not None:
        if better is None or better.error is None:
            return ""
        error = better.error.error(part.error, 0.0)
        words = "the present setting" if better.chosen else str(better.setting)
        return (
            f"cheapest within {length_text(part.budget)}: {words}, "
            f"with {length_text(error)} ({part.error})"
        )
    if better is None:
        return "nothing tried is as exact and much cheaper than the present setting"
    settings = str(better.setting)
    if chosen.error is None:
        return f"the present setting does not work; {settings} does"
    share = _cost(better, part.cost) / _cost(chosen, part.cost)
    what = "time" if part.cost is CostMeasure.SECONDS else str(part.cost)
    return f"{settings} is as exact in {share:.0%} of the {what}"


def _cost(row: TrialRow, measure: CostMeasure) -> float:
    value: float = getattr(row, measure.value)
    return value


_PRINTERS: dict[str, Callable[..., str]] = {
    "marks": _marks,
    "ending": _ending,
    # Errors go over many decades.
    "milli": lambda length: f"{1e3 * length:.3g}",
    "share": lambda share: f"{1e2 * share:.3g}",
    "turn": lambda angle: f"{math.degrees(angle):.3g}",
    "options": lambda options: ", ".join(f"{name} {own:.6g}" for name, own in options),
}


def tradeoffs_json(report: Tradeoffs) -> dict[str, object]:
    """Return tables as plain values: lengths in metres, angles in radians."""
    names = "name kind span instants points extent measure=error cost unit lines"
    return {
        "report": "animtool/1",
        "source": str(report.source),
        "budget": report.budget,
        "tables": [
            {
                **picked(part, names),
                "reference": part.reference and _reference_json(part.reference),
                "rows": [_row_json(row) for row in part.rows],
            }
            for part in report.tables
        ],
        "notices": plain_value(report.notices),
    }


def _reference_json(reference: Reference) -> dict[str, object]:
    return {
        **_setting_json(reference.setting),
        "error": _distances_json(reference.error),
        **picked(reference, "order sensitive"),
    }


def _setting_json(setting: Setting) -> dict[str, object]:
    return {"method": setting.method, "options": dict(setting.options)}


def _row_json(row: TrialRow) -> dict[str, object]:
    return {
        **_setting_json(row.setting),
        "status": _status(row),
        **picked(row, "reason stable_step"),
        "seconds": round(row.seconds, 6),
        **picked(row, "steps bytes"),
        "error": None if row.error is None else _distances_json(row.error),
        **picked(row, "energy_drift figures worst chosen best recommended"),
    }


def _distances_json(error: Distances) -> dict[str, float]:
    values = asdict(error)
    del values["at"]
    angle = values.pop("angle")
    return values if angle is None else {**values, "angle": angle}
