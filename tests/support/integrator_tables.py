"""The tables of integrators in ``docs/reference/integrators.md``, measured.

``PYTHONPATH=tests python tests/support/integrator_tables.py`` writes them anew into the
page, times included; the test of the page compares all but the times.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np

from animtool.sim import (
    INTEGRATORS,
    IntegrateOptions,
    Integrator,
    find_integrator,
    integrate,
)
from animtool.sim.integrators.integrator import EquationForm, StepControl
from support.motions import Motion, kepler, pendulum, pendulum_period

PAGE = Path(__file__).parents[2] / "animtool/docs/reference/integrators.md"
_MARK = re.compile(r"(<!-- integrators: (\w+) -->\n)(?:\n(?:\|.*\n)+)?")
DAMPING = (0.0, 0.063, 1.58)
# Steps a period of methods with fixed ones, and the tolerance of others.
STEPS, TOLERANCE = 200, 1e-7
RUNS = 5


@dataclass(frozen=True)
class BakeMeasurements:
    """A method on a motion: its error, what that took, and how long of a core [ms]."""

    error: float
    evaluations: int
    milliseconds: float


def _swing() -> tuple[Motion, float, float]:
    return pendulum(2.0), pendulum_period(2.0), 5.3


def _orbit() -> tuple[Motion, float, float]:
    return kepler(0.5), 2 * math.pi, 5.3


# A motion, its period [s], and how many of them; not a whole number.
MOTIONS: dict[str, Callable[[], tuple[Motion, float, float]]] = {
    "pendulum": _swing,
    "orbit": _orbit,
}


def measured(name: str, kind: str) -> BakeMeasurements:
    """Return how a method does on a motion, the largest error of five times."""
    motion, period, count = MOTIONS[kind]()
    times = np.linspace(0, count * period, 6)
    if find_integrator(name).control is StepControl.FIXED:
        options = IntegrateOptions(name, step=period / STEPS, growth=math.inf)
    else:
        options = IntegrateOptions(name, tolerance=TOLERANCE)
    seconds, found = math.inf, integrate(motion.system, times, options)
    for _ in range(RUNS):
        begun = process_time()
        integrate(motion.system, times, options)
        seconds = min(seconds, process_time() - begun)
    wanted = np.array([motion.state(t) for t in found.times.tolist()])
    whole = len(found.times) == len(times)
    error = float(np.abs(found.states - wanted)[:, 0].max()) if whole else math.inf
    return BakeMeasurements(error, found.stats.evaluations, seconds * 1e3)


def _order(integrator: Integrator) -> str:
    drag = integrator.drag_order
    return f"{integrator.order}" + (f", {drag} with drag" if drag else "")


def _kind(integrator: Integrator) -> str:
    if integrator.control is StepControl.SCIPY:
        kind = "scipy"
    else:
        kind = (
            "steps by error" if integrator.control is StepControl.ADAPTIVE else "fixed"
        )
    words = [
        kind,
        "implicit" if integrator.is_implicit else "",
        "symplectic" if integrator.is_symplectic else "",
        "accelerations" if integrator.form is EquationForm.ACCELERATIONS else "",
    ]
    return ", ".join(word for word in words if word)


def _limit(integrator: Integrator, damping: float) -> str:
    limit = integrator.largest_step(1.0, damping)
    if limit is None:
        return "its own"
    if limit == 0:
        return "none"
    return "any" if math.isinf(limit) else f"{limit:.2f}"


def properties() -> list[list[str]]:
    """Return the table of what methods are."""
    rows = [["`method`", "kind", "order", *(f"ω·h at ζ {z:g}" for z in DAMPING)]]
    for name in INTEGRATORS:
        each = find_integrator(name)
        limits = [_limit(each, damping) for damping in DAMPING]
        rows.append([f"`{name}`", _kind(each), _order(each), *limits])
    return rows


def errors() -> list[list[str]]:
    """Return the table of error against time."""
    heads = [
        f"{kind}: {what}" for kind in MOTIONS for what in ("error", "forces", "ms")
    ]
    rows = [["`method`", *heads]]
    for name in INTEGRATORS:
        cells = [f"`{name}`"]
        for kind in MOTIONS:
            found = measured(name, kind)
            error = "gave up" if math.isinf(found.error) else f"{found.error:.1e}"
            cells += [error, f"{found.evaluations}", f"{found.milliseconds:.1f}"]
        rows.append(cells)
    return rows


TABLES = {"properties": properties, "errors": errors}


def listed(text: str, kind: str) -> list[list[str]]:
    """Return the cells of a page's table."""
    _, _, below = text.partition(f"<!-- integrators: {kind} -->\n\n")
    body, _, _ = below.partition("\n\n")
    rows = [[c.strip() for c in row.split("|")[1:-1]] for row in body.splitlines()]
    return [rows[0], *rows[2:]]


def filled(text: str) -> str:
    """Return a page with the table of each mark ``<!-- integrators: KIND -->``."""

    def table(mark: re.Match[str]) -> str:
        rows = TABLES[mark[2]]()
        rows.insert(1, ["---"] * len(rows[0]))
        lines = [f"| {' | '.join(row)} |\n" for row in rows]
        return f"{mark[1]}\n{''.join(lines)}"

    return _MARK.sub(table, text)


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text("utf-8")), "utf-8")
