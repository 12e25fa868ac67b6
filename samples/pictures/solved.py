"""The samples of inverse kinematics: their takes at the targets, and an arm to see."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from picture import Surface
from props import rod

from animtool.clip.clip import Clip
from animtool.clip.file import load_clip, open_clip
from animtool.ik import load_targets, solve_take
from animtool.motion.take import Take
from animtool.rig.file import load_rig
from animtool.rig.skeleton import Rig

Array = NDArray[np.float64]

SAMPLES = Path(__file__).parents[1]
PAINT, STEEL, RUBBER = (0.85, 0.42, 0.12), (0.25, 0.26, 0.28), (0.14, 0.14, 0.16)
COPPER = (0.75, 0.5, 0.25)

# Rods of the arm: joint and point from where to where, radius, colour, taper.
RODS = (
    ("base", (0, 0, 0), "base", (0, 0, 0.06), 0.12, STEEL, 1.0),
    ("base", (0, 0, 0.06), "axis_1", (0, 0, 0.08), 0.085, PAINT, 1.0),
    ("axis_2", (0, -0.09, 0), "axis_2", (0, 0.09, 0), 0.07, STEEL, 1.0),
    ("axis_2", (0, 0, 0), "axis_3", (0, 0, 0), 0.055, PAINT, 0.85),
    ("axis_3", (0, -0.078, 0), "axis_3", (0, 0.078, 0), 0.06, STEEL, 1.0),
    ("axis_3", (0, 0, 0), "axis_3", (0.2, 0, 0.03), 0.05, PAINT, 0.9),
    ("axis_4", (0, 0, 0), "axis_5", (0, 0, 0), 0.042, PAINT, 0.9),
    ("axis_5", (0, -0.058, 0), "axis_5", (0, 0.058, 0), 0.045, STEEL, 1.0),
    ("axis_5", (0, 0, 0), "axis_6", (0, 0, 0), 0.036, PAINT, 1.0),
    ("axis_6", (0, 0, 0), "axis_6", (0.03, 0, 0), 0.04, STEEL, 1.0),
    ("axis_6", (0.03, 0, 0), "axis_6", (0.09, 0, 0), 0.022, STEEL, 1.0),
    ("finger_l", (0, -0.02, 0), "finger_l", (0.06, -0.02, 0), 0.009, STEEL, 1.0),
    ("finger_r", (0, 0.02, 0), "finger_r", (0.06, 0.02, 0), 0.009, STEEL, 1.0),
    # The torch, its neck bent by 45°, and its tip.
    ("tool", (-0.03, 0, 0), "tool", (0.064, 0, 0), 0.016, RUBBER, 1.0),
    ("tool", (0.06, 0, 0), "tool", (0.108, 0, -0.048), 0.013, RUBBER, 0.9),
    ("tool", (0.104, 0, -0.044), "tool", (0.124, 0, -0.064), 0.007, COPPER, 0.4),
)


def checkpoint(rig: Rig) -> Take:
    """Return the blocked clip of ``carry`` with hands on the box and feet held."""
    folder = SAMPLES / "carry"
    take = load_clip(open_clip(folder / "carry.clip.yaml"), rig).sample(rig)
    return solve_take(take, load_targets(folder / "grip.targets.yaml", rig)).take


def welding() -> Take:
    """Return the arm on its way round the seam."""
    rig = load_rig(SAMPLES.parent / "rigs/arm/arm.rig.yaml")
    tracks = load_targets(SAMPLES / "weld/weld.targets.yaml", rig)
    clock = tracks.clock
    last = clock.start + clock.count - 1
    rest = Clip("rest", clock.fps, clock.start, last, ()).sample(rig)
    return solve_take(rest, tracks, still=True).take


def arm_surfaces(take: Take, frame: int) -> list[Surface]:
    """Return the arm and its torch in a frame of a take, counted from 0."""
    world = take.world()

    def at(name: str, point: tuple[float, ...]) -> Array:
        j = take.rig.index(name)
        local = world.linear[frame, j] @ np.array(point, np.float64)
        return np.asarray(world.positions[frame, j] + local)

    return [
        rod(at(a, start), at(b, end), radius, colour, taper)
        for a, start, b, end, radius, colour, taper in RODS
    ]
