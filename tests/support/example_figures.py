"""Figures of the examples of systems, and of other small ones, by kind."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from support.figures import check_figures
from support.simulated import Simulator
from support.system_examples import EXAMPLES

# Past the bursts, moves and openings of examples.
TIMES = (0.0, 0.0625, 0.15, 0.3, 0.40625)
# What is a prototype or made when it is asked for is left out.
APART = {"meshes", "prototypes", "casts", "surface", "physics"}


def example_figures(
    test: str,
    folder: Path,
    kind: str,
    name: str,
    changes: dict[str, Any],
    times: tuple[float, ...] = TIMES,
) -> None:
    """Check the figures of what an example shows at some times [s].

    Args:
        test: The file of the test.
        folder: Where its scene is written.
        kind: Of system.
        name: Of the run.
        changes: Keys of the example that are other ones.
        times: When it is looked at.
    """
    entry = {"name": "it", **EXAMPLES[kind].keys, **changes}
    rows = Simulator(folder).simulate([{kind: entry}], times)["it"]
    check_figures(test, name, [shown(row) for row in rows])


def shown(frame: Any) -> Any:
    """Return what a frame shows, as far as it has figures."""
    if not is_dataclass(frame):
        return frame
    found = {}
    for one in fields(frame):
        value = getattr(frame, one.name)
        if one.name not in APART and not callable(value):
            found[one.name] = value
    return found
