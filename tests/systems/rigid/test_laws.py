"""Which end of a capsule a face meets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.simulated import Simulator


@pytest.mark.parametrize("degrees", [40.0, -40.0])
def test_the_lower_end_of_a_capsule_is_raised(tmp_path: Path, degrees: float) -> None:
    """It is half a metre long, and the end of its axis is 5 mm within a box."""
    tilt = np.radians(degrees)
    high = 0.25 * np.sin(abs(tilt)) - 0.005
    rod = {
        "name": "rod",
        "shape": {"capsule": {"radius": 0.1, "length": 0.5, "axis": [1, 0, 0]}},
        "at": [0, high, 0], "rotate": [np.cos(tilt / 2), 0, 0, np.sin(tilt / 2)],
    }  # fmt: skip
    block = {"shape": {"box": {"size": [4, 1, 4]}}, "at": [0, -0.5, 0]}
    systems = [{"rigid": {"name": "rods", "bodies": [rod], "colliders": [block]}}]
    rows = Simulator(tmp_path).simulate(systems, [0.0, 0.05, 0.1])["rods"]
    # Turned to lie flat: about z against the tilt.
    assert np.sign(rows[1].spins[0, 2]) == -np.sign(degrees)
    ends = [row.points[0] for row in rows]
    assert abs(ends[-1][0]) < 0.05
