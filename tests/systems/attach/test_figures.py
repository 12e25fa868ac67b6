"""Figures of a tail, strands and a sheet on a body that swings, turns and leaps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.attached import moved, sheet_rig, simulated, strands_rig, tail_rig, take_of
from support.figures import check_figures

from animtool.rig.parts import Capsule, Collider
from animtool.rig.skeleton import Rig

BODY = Collider("body", Capsule(0.08, 0.3, (0.2, 1.0, 0.1), (0.05, -0.2, 0.02)))
HEAD = Collider("head", Capsule(0.09, 0.2, (0.2, 1.0, 0.1), (0.15, -0.25, 0.03)))
RIGS: dict[str, Rig] = {
    "tail": tail_rig(3, 0.2, (BODY,)),
    "strands": strands_rig((HEAD,)),
    "sheet": sheet_rig(),
}
OPTIONS: dict[str, dict[str, Any]] = {
    "plain": {},
    "wind": {"wind": (1.0, 0.2, -2.0), "drag": 3.0, "frequency": 1.5, "ratio": 0.4},
    "bent": {"bend": 2.0, "gravity": 5.0, "settle": 0.3, "weight": 0.7},
}


def place(t: np.ndarray) -> np.ndarray:
    """Return places of a root that goes to and fro, and leaps once."""
    leap = 0.5 * (t > 0.45)
    return np.stack([0.2 * np.sin(5 * t), 0.1 * t + leap, 0.3 * np.cos(3 * t)], axis=1)


def turn(t: np.ndarray) -> np.ndarray:
    return np.stack([0.5 * np.sin(4 * t), 2.0 * t, 0.3 * t * t], axis=1)


@pytest.mark.parametrize("kind", RIGS)
@pytest.mark.parametrize("options", OPTIONS)
def test_what_hangs_on_a_body(kind: str, options: str) -> None:
    take = take_of(RIGS[kind], 24, 0.75, place, turn)
    made, codes = simulated(take, blocks=2, **OPTIONS[options])
    found = [moved(made), made.motion.rotations.dense(), codes]
    check_figures(__file__, f"{kind} {options}", found)
