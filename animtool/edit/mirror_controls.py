"""The value of a control's partner in a mirror."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.rig.controls import Control, evaluate_controls
from animtool.rig.joints import DRIVEN_PARTS, split_part
from animtool.rig.kinematics import rest_world
from animtool.rig.skeleton import Rig

# How far a control is moved to see what it does, as a share of its range [1].
NUDGE = 0.1
# Effects that differ by less are the same [rad], [m].
SAME_EFFECT = 1e-9


@dataclass(frozen=True, slots=True)
class ControlMirror:
    """How values of each control look on its partner.

    Attributes:
        partners: Index of each one's partner ``(C,)``.
        signs: 1 where both go the same way, -1 where they go opposite ways ``(C,)``.
        pivots: The values that stay where signs change ``(C,)``.
    """

    partners: IntArray
    signs: FloatArray
    pivots: FloatArray

    @staticmethod
    def of(
        rig: Rig,
        partners: IntArray,
        joints: IntArray,
        shapes: IntArray,
        normal: FloatArray,
    ) -> ControlMirror:
        """Return what a rig's controls do in a mirror.

        A control and its partner go opposite ways where the mirror image of what one
        does to joints and shapes is nearer to what the other does when it goes back:
        a control that turns the head to the left above 0, to the right below it.

        Args:
            rig: Whose controls they are.
            partners: Of the controls ``(C,)``.
            joints: Partners of the joints ``(J,)``.
            shapes: Partners of the shapes ``(S,)``.
            normal: What the mirror multiplies directions by ``(3,)``.
        """
        # Axes of rotation turn the other way round.
        across = np.concatenate([-normal, normal])
        turned = rest_world(rig).linear[0]

        def effect(c: int, way: float) -> FloatArray:
            return _flat(_effect(rig, c, way, turned))

        signs = np.ones(len(partners))
        for i, partner in enumerate(partners.tolist()):
            moved, weights = _effect(rig, i, 1.0, turned)
            seen = _flat(((moved * across)[joints], weights[shapes]))
            if not seen.any():
                continue
            on, back = (
                np.linalg.norm(seen - effect(partner, way)) for way in (1.0, -1.0)
            )
            if back < on - SAME_EFFECT:
                signs[i] = -1.0
        pivots = np.array([_pivot(control) for control in rig.controls])
        return ControlMirror(partners, signs, pivots)

    def __call__(self, values: FloatArray, c: IntArray) -> FloatArray:
        """Return values ``(..., A, 1)`` of controls as their partners have them."""
        turned = self.pivots[self.partners[c], None] - (values - self.pivots[c, None])
        return np.where(self.signs[c, None] < 0, turned, values)


def _pivot(control: Control) -> float:
    """Return 0, or the default of a control whose range is without 0."""
    if control.low is None or control.high is None:
        return 0.0
    return 0.0 if control.low <= 0 <= control.high else control.default


def _flat(effect: tuple[FloatArray, FloatArray]) -> FloatArray:
    return np.concatenate([part.ravel() for part in effect])


def _effect(
    rig: Rig, c: int, way: float, turned: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return what a control does when it moves a little.

    Args:
        rig: Whose control it is.
        c: Its index.
        way: 1 or -1.
        turned: Rotations of the joints at rest, world ``(J, 3, 3)``.

    Returns:
        To each joint in the world ``(J, 6)``, a rotation vector [rad] and a
        translation [m]; and to each shape ``(S,)``.
    """
    control = rig.controls[c]
    span = 1.0
    if control.low is not None and control.high is not None:
        span = control.high - control.low
    still = np.array([_pivot(control)])
    moved = still + way * NUDGE * span
    before = evaluate_controls(rig.controls, {control.name: still}).targets
    after = evaluate_controls(rig.controls, {control.name: moved}).targets
    local, weights = np.zeros((len(rig.joints), 6)), np.zeros(len(rig.shapes))
    shapes = {shape.name: i for i, shape in enumerate(rig.shapes)}
    for target in after:
        change = after[target][0] - before[target][0]
        kind, _, name = target.partition("/")
        if kind == "shape":
            weights[shapes[name]] += change
            continue
        name, part = split_part(name, DRIVEN_PARTS)
        j = rig.index(name)
        first = 0 if part.startswith(("angle", "rotation")) else 3
        if part in {"angle", "slide"}:
            axis = np.array(rig.joints[j].axis, np.float64)
        else:
            axis = np.eye(3)["xyz".index(part[-1])]
        local[j, first : first + 3] += axis * change
    halves = (np.einsum("jab,jb->ja", turned, half) for half in np.split(local, 2, 1))
    return np.concatenate(list(halves), axis=1), weights
