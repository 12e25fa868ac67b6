"""Figures of the examples of systems, and of other small ones, by kind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

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


def globe(radius: float, at: Sequence[float]) -> dict[str, Any]:
    """Return a collider that is a coarse ball of triangles, of 50 points."""
    rings, sides = 6, 8
    polar = np.pi * np.arange(1, rings + 1) / (rings + 1)
    around = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack(
        [
            np.sin(polar)[:, None] * np.cos(around),
            np.repeat(np.cos(polar)[:, None], sides, axis=1),
            np.sin(polar)[:, None] * np.sin(around),
        ],
        axis=-1,
    ).reshape(-1, 3)
    points = radius * np.concatenate([ring, [[0.0, 1.1, 0.0], [0.0, -0.9, 0.0]]])
    faces = []
    for i in range(sides):
        j = (i + 1) % sides
        faces += [[rings * sides, j, i]]
        faces += [[rings * sides + 1, (rings - 1) * sides + i, (rings - 1) * sides + j]]
        for k in range(rings - 1):
            a, b = k * sides + i, k * sides + j
            faces += [[a, b, a + sides], [b, b + sides, a + sides]]
    shape = {"mesh": {"points": points, "triangles": np.array(faces)}}
    return {"shape": shape, "at": list(at), "friction": 0.3}
