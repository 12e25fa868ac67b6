"""Springs of ``$ANIMTOOL_DATA/sim``."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.systems.springs import Body, Family, Pins, SpringSystem, rope, sheet

__all__ = ["Case", "read_springs"]


@dataclass(frozen=True)
class Case:
    """An instance of a file.

    Attributes:
        name: Of it.
        system: Its springs.
        entry: All that is said of it.
        fps: Frames a second, of motions in frames.
    """

    name: str
    system: SpringSystem
    entry: dict[str, Any]
    fps: float = 24.0

    @property
    def reference(self) -> dict[str, Any]:
        """The answer."""
        found: dict[str, Any] = self.entry["reference"]
        return found


def read_springs(path: Path) -> list[Case]:
    """Return the cases of a file."""
    data = json.loads(path.read_text("utf-8"))
    make = _rope if data["case"] == "rope_stiff" else _sheet
    return [
        Case(entry["id"], make(entry), entry, entry.get("fps", 24.0))
        for entry in data["instances"]
    ]


def _rope(entry: dict[str, Any]) -> SpringSystem:
    params = entry["params"]
    end = [(params["n"] - 1) * params["rest_length"], 0, 0]
    line = rope(
        [0, 0, 0], end, params["n"], Family(params["k"], params["kd"]),
        mass=params["mass_particle"], tip_mass=params["mass_tip"],
    )  # fmt: skip
    return SpringSystem(
        line, pins=Pins(params["pinned"]), resistance=params["drag"],
        gravity=(0, 0, -params["g"]),
    )  # fmt: skip


def _sheet(entry: dict[str, Any]) -> SpringSystem:
    params = entry["params"]

    def family(name: str) -> Family:
        return Family(params[f"k_{name}"], ratio=params.get("zeta", 0.0))

    size = params["size"]
    body = sheet(
        params["N"], params["N"], mass=params["mass_particle"],
        structural=family("structural"), diagonals=family("shear"),
        bend=family("bend"), across=[size, 0, 0], up=[0, size, 0],
    )  # fmt: skip
    stretch = params.get("corner_stretch", 1.0)
    places: FloatArray = body.positions
    if stretch != 1.0:
        places = (places - [size / 2, size / 2, 0]) * stretch
    return SpringSystem(
        Body(np.asarray(places), body.masses, body.springs, body.triangles),
        pins=Pins(params["pinned"]), drag=params["drag_per_second"],
        gravity=(0, 0, -params["g"]),
    )  # fmt: skip
