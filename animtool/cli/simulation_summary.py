"""How what a table of a simulation comes to is printed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from animtool.core.errors import listed
from animtool.core.quantities import plain
from animtool.report.text import Each, Table, Template

if TYPE_CHECKING:
    from animtool.sim.trials.measuring import TrialRow, TrialTable
    from animtool.sim.trials.trial import Setting

LEGEND = "> the file's own   * none as exact is faster   + to take in its place"


def _marks(row: TrialRow) -> str:
    marks = {">": row.chosen, "*": row.best, "+": row.recommended}
    return "".join(mark for mark, given in marks.items() if given)


def _ending(row: TrialRow) -> str:
    """Return why a row has no error, empty where it has one."""
    if not row.reason:
        return ""
    text = f"{row.ended}: {row.reason}"
    step = row.stable_step
    if step == 0:
        text += "; no step is stable"
    elif step is not None and math.isfinite(step):
        text += f"; steps up to {plain(step)} s are stable"
    return text


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


TABLE = Template(
    "animtool.scene.tables.simulation:SimulationTable",
    (
        Each(
            "tables",
            (
                "{name}: {kind}, {span:plain 4} s simulated",
                "[  compared with {reference.setting} at {instants} times, up to "
                "{points} points]",
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
                        "sim s/s": "{simulated_per_second:plain}",
                        "steps": "{steps}",
                        "largest mm": "{error.largest:mm}",
                        "rms mm": "{error.rms:mm}",
                        "median mm": "{error.median:mm}",
                        "rms deg": "{error.angle:degrees}",
                        "lone %": "[{?has_lone}{error.apart:hundredths}]",
                        "energy %": "{energy_drift:hundredths}",
                        "stretch %": "{stretch:hundredths}",
                        " ": "{self:ending}",
                    },
                    left=("", "method", "setting", " "),
                    optional=("rms deg", "lone %", "energy %", "stretch %"),
                    indent="  ",
                ),
                Each("self:left_out", ("  left out: {value:list}: {key}",)),
                "[  {self:advice}]",
                "",
            ),
        ),
        LEGEND,
    ),
    {
        "marks": _marks,
        "ending": _ending,
        "left_out": _left_out,
        "advice": _advice,
        "options": lambda options: ", ".join(f"{n} {own:.6g}" for n, own in options),
    },
    is_result=True,
)
