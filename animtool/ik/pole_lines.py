"""Finds poles on the line of their limb, which do not determine its bend."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.ik.goals import PARTS, Goal, Targets
from animtool.ik.tracks import FreeEffector
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.skeleton import Rig

# A pole this near to the line is on it, and a middle joint this near is on a straight
# limb, whose pole does not matter; in lengths of the limb.
ON_LINE, STRAIGHT = 0.02, 0.02


def poles_on_lines(
    rig: Rig,
    goals: Sequence[Goal],
    world: WorldTransforms,
    targets: Targets,
    active: BoolArray,
) -> BoolArray:
    """Return a mask of poles on the line from root to end of a bent limb ``(F, E)``.

    Args:
        rig: J joints.
        goals: E goals.
        world: World transforms of the solved joints, F frames.
        targets: Positions and poles in world space.
        active: Mask of the active parts of goals ``(F, E, 4)``.
    """
    is_on_line = np.zeros(active.shape[:2], np.bool_)
    for e, goal in enumerate(goals):
        is_active = active[:, e, PARTS.index("pole")]
        if not is_active.any():
            continue
        effector = FreeEffector(rig, goal, world)
        limb = effector.limb()
        if limb is None:
            continue
        points = effector.position()
        root, middle = (world.positions[:, j] for j in limb)
        # The effector is off its position where the pole leads astray.
        has_position = active[:, e, PARTS.index("position")]
        positions = np.asarray(targets.positions)[:, e]
        ends = np.where(has_position[:, None], positions, points)
        length = np.linalg.norm(middle - root, axis=1)
        length += np.linalg.norm(points - middle, axis=1)
        pole_distance = _distances(np.asarray(targets.poles)[:, e], root, ends)
        is_bent = _distances(middle, root, points) > STRAIGHT * length
        is_on_line[:, e] = is_active & is_bent & (pole_distance < ON_LINE * length)
    return is_on_line


def _distances(points: FloatArray, root: FloatArray, end: FloatArray) -> FloatArray:
    """Return distances of points from the line through root and end ``(F,)`` [m]."""
    line = end - root
    length = np.maximum(np.linalg.norm(line, axis=1), 1e-300)
    cross_products = np.cross(points - root, line / length[:, None])
    return np.asarray(np.linalg.norm(cross_products, axis=1))
