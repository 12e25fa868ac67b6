"""Formats tables of cost against error, which `animtool report` measures, as text."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from animtool.core.quantities import length_text, plain_number
from animtool.core.record import dataclass
from animtool.report.text import Each, Line, Table, Template, render, table_cells
from animtool.sim.trials.trial import CostMeasure, Figure

if TYPE_CHECKING:
    from animtool.sim.trials.table import TrialRow, TrialTable

LEGEND = "> current setting   * Pareto front   + recommended"
_HEADER_LINES: tuple[Line, ...] = (
    "{name}: {kind}, {span:plain 4} s",
    "[  reference: {reference.setting}[{?points}, up to {points:n point} at "
    "{instants:n time}]]",
    "[{?reference.error.rms}  error of the reference: {reference.error.rms:milli} mm "
    "(rms)[, observed order {reference.order:.1f}]"
    "[{?reference.sensitive}; not small: the motion is sensitive]]",
    "  work: number of {unit}",
)
_ROW_TABLE = Table(
    "applicable",
    {
        "": "{self:marks}",
        "method": "{setting.method}",
        "setting": "{setting.options:options}",
        "seconds": "{seconds:plain}",
        "work": "{steps}",
        "kB": "[{?bytes}{bytes:kB}]",
        "largest mm": "{error.largest:milli}",
        "rms mm": "[{?by_rms}{error.rms:milli}]",
        "median mm": "[{?by_rms}{error.median:milli}]",
        "rms deg": "{error.angle:degrees}",
        "lone %": "[{?has_unmatched}{error.unmatched:hundredths}]",
        "energy %": "{energy_drift:share}",
        "stretch %": "{self:stretch}",
        "depth mm": "{self:depth}",
        "pierced": "{self:pierced}",
        "miss mm": "{self:miss}",
        "miss deg": "{self:miss_angle}",
        "reached %": "{self:reached}",
        "worst": "{worst}",
        " ": "{self:ending}",
    },
    left=("", "method", "setting", "worst", " "),
    optional=(
        "kB", "rms mm", "median mm", "rms deg", "lone %", "energy %", "stretch %",
        "depth mm", "pierced", "miss mm", "miss deg", "reached %", "worst",
    ),
    indent="  ",
)  # fmt: skip
_ADVICE_LINES: tuple[Line, ...] = (
    Each("self:left_out", ("  skipped: {value:list}: {key}",)),
    "[  {self:advice}]",
)


def _marks_text(row: TrialRow) -> str:
    is_marked_by_symbol = {
        ">": row.chosen,
        "*": row.is_pareto_optimal,
        "+": row.recommended,
    }
    return "".join(mark for mark, is_marked in is_marked_by_symbol.items() if is_marked)


def _missing_error_text(row: TrialRow) -> str:
    """Return why a row has no error; "" if it has one."""
    if not row.reason:
        return ""
    text = f"{row.ended}: {row.reason}"
    stable_step = row.stable_step
    if stable_step == 0:
        text += "; no step is stable"
    elif stable_step is not None and math.isfinite(stable_step):
        text += f"; stable up to steps of {plain_number(stable_step)} s"
    return text


def _exclusion_reasons(table: TrialTable) -> dict[str, list[str]]:
    """Return the names of excluded methods, grouped by the reason."""
    methods_by_reason: dict[str, dict[str, None]] = {}
    for row in table.rows:
        if row.status is None:
            method = row.setting.method
            reason = row.reason.removeprefix(method).strip()
            methods_by_reason.setdefault(reason, {})[method] = None
    return {reason: list(methods) for reason, methods in methods_by_reason.items()}


def _advice_text(table: TrialTable) -> str:
    """Return a text that recommends a setting; "" if there is no recommendation."""
    if table.reference is None or table.reference.sensitive:
        return ""
    recommended_row, current_row = table.recommended, table.chosen
    if table.budget is not None:
        error = None if recommended_row is None else table.error_of(recommended_row)
        if recommended_row is None or error is None:
            return ""
        setting_text = "the current setting"
        if not recommended_row.chosen:
            setting_text = str(recommended_row.setting)
        return (
            f"cheapest within {length_text(table.budget)}: {setting_text}, "
            f"with {length_text(error)} ({table.error})"
        )
    if recommended_row is None:
        return (
            "no setting is as accurate and at least 20 % cheaper than the current one"
        )
    if current_row.error is None:
        return f"the current setting fails; {recommended_row.setting} works"
    cost_fraction = _cost(recommended_row, table.cost) / _cost(current_row, table.cost)
    quantity = "time" if table.cost is CostMeasure.SECONDS else str(table.cost)
    cost_text = f"{cost_fraction:.0%} of the {quantity}"
    return f"{recommended_row.setting} is as accurate in {cost_text}"


def _cost(row: TrialRow, measure: CostMeasure) -> float:
    cost: float = getattr(row, measure.value)
    return cost


def _figure_printer(name: str, scale: float) -> Callable[[TrialRow], str]:
    """Return a function that formats a figure of a row, or returns "" without it."""

    def figure_text(row: TrialRow) -> str:
        value = row.figures.get(Figure(name))
        return "" if value is None else f"{scale * value:.3g}"

    return figure_text


_PRINTERS: dict[str, Callable[..., Any]] = {
    "marks": _marks_text,
    "ending": _missing_error_text,
    "left_out": _exclusion_reasons,
    "advice": _advice_text,
    # Errors span many decades.
    "milli": lambda length: f"{1e3 * length:.3g}",
    "share": lambda fraction: f"{1e2 * fraction:.3g}",
    "options": lambda options: ", ".join(
        f"{name} {value:.6g}" for name, value in options
    ),
    "stretch": _figure_printer("stretch", 1e2),
    "depth": _figure_printer("depth", 1e3),
    "pierced": _figure_printer("pierced", 1.0),
    "miss": _figure_printer("miss", 1e3),
    "miss_angle": _figure_printer("miss_angle", math.degrees(1.0)),
    "reached": _figure_printer("reached", 1e2),
}
TABLES = Template(
    "animtool.scene.tables.tradeoffs:Tradeoffs",
    (
        Each(
            "tables",
            (
                *_HEADER_LINES,
                _ROW_TABLE,
                *_ADVICE_LINES,
                Each("lines", ("    {self}",)),
                "",
            ),
        ),
        LEGEND,
    ),
    _PRINTERS,
    is_result=True,
)


@dataclass(frozen=True, slots=True)
class TableParts:
    """Texts of a table for an HTML page: header, cells, row classes and advice."""

    header: list[str]  # what was measured, and the reference
    rows: list[list[str]]  # cells, header row first
    left_columns: set[int]  # left-aligned columns
    # CSS classes of each row below the header: ``chosen`` or ``recommended``.
    classes: list[str]
    advice: list[str]


def table_parts(table: TrialTable) -> TableParts:
    """Format a table as texts for a page; see `TableParts`."""
    rows, left_columns = table_cells(table, _ROW_TABLE, _PRINTERS)
    classes = [
        "chosen" if row.chosen else "recommended" if row.recommended else ""
        for row in table.applicable
    ]
    header = render(table, _HEADER_LINES, _PRINTERS)
    advice = render(table, _ADVICE_LINES, _PRINTERS)
    return TableParts(header, rows, left_columns, classes, advice)
