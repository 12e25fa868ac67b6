"""What may be asked of a joint, and where it should be."""

from __future__ import annotations

import difflib
from dataclasses import dataclass

import numpy as np

from animtool._types import ArrayLike, BoolArray, FloatArray
from animtool.errors import Fault, OptionError, excerpt
from animtool.maths import so3
from animtool.rig.parts import Vector
from animtool.rig.skeleton import Rig

__all__ = ["Goal", "Targets"]


@dataclass(frozen=True, slots=True)
class Goal:
    """What a joint, or a point that it carries, is to reach.

    The weights multiply what is missing before it is squared and summed: positions in
    shares of the problem's length, the others in radians. 0 asks for nothing.

    Attributes:
        joint: Whose frame it is.
        offset: The point, in that frame [m].
        position: Weight of the point's position.
        orientation: Weight of the frame's rotation.
        aim: Weight of ``aim_axis`` pointing from the point to a target.
        aim_axis: Unit, in the joint's frame.
        pole: Weight of the limb's middle joint lying towards a point: in the half
            plane of the limb's root, its tip (the goal's point) and that point.
        root: Topmost joint that this goal moves, the joint itself or one above it; None
            is the topmost of the rig. Joints above it move only for goals of their own.
        priority: From 0, hard. Goals of higher numbers give way: among the poses that
            are best for those before them, the ones that are best for them are taken.
        soft: Share of the limb's reach, from its root to the point, over which its
            extension eases out, so that it does not snap straight; from 0 to less
            than 1.
        stretch: Share of their length that the limb's bones may grow by, all by as
            much, to reach what is too far.
    """

    joint: str
    offset: Vector = (0.0, 0.0, 0.0)
    position: float = 1.0
    orientation: float = 0.0
    aim: float = 0.0
    aim_axis: Vector = (0.0, 0.0, 1.0)
    pole: float = 0.0
    root: str | None = None
    priority: int = 0
    soft: float = 0.0
    stretch: float = 0.0

    @property
    def weights(self) -> tuple[float, float, float, float]:
        """Weights of position, orientation, aim and pole."""
        return (self.position, self.orientation, self.aim, self.pole)

    @property
    def rows(self) -> int:
        """How many residuals it has."""
        counts = zip((3, 3, 2, 1), self.weights, strict=True)
        return sum(count for count, weight in counts if weight > 0)


@dataclass(frozen=True, slots=True)
class Targets:
    """Where the goals are, for B problems, in the world.

    What no goal asks for may be left out.

    Attributes:
        positions: ``(B, E, 3)`` [m].
        rotations: Quaternions ``(B, E, 4)``, x y z w; brought to length 1.
        aims: Points to aim at ``(B, E, 3)`` [m].
        poles: Points that the limbs' middle joints lie towards ``(B, E, 3)`` [m].
        weights: What the goals' weights of position, orientation, aim and pole are
            multiplied by ``(B, E, 4)``; None is 1. What is multiplied by 0 is not
            asked in that problem, and its target may be anything.
    """

    positions: ArrayLike | None = None
    rotations: ArrayLike | None = None
    aims: ArrayLike | None = None
    poles: ArrayLike | None = None
    weights: ArrayLike | None = None


PARTS = ("positions", "rotations", "aims", "poles")
_PLACES = (slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 13))


def goal_faults(goal: Goal, rig: Rig, where: str) -> list[Fault]:
    """Return what is wrong with a goal by itself."""
    faults = []
    if goal.joint not in rig.names:
        near = difflib.get_close_matches(goal.joint, rig.names, 1)
        hint = f"did you mean {near[0]}?" if near else None
        message = f"no joint of {rig.name!r} is {excerpt(goal.joint)}"
        faults.append(Fault("IK001", message, where=where, hint=hint))
    faults += _root_faults(goal, rig, where)
    weights = np.array(goal.weights, np.float64)
    if not (np.isfinite(weights).all() and (weights >= 0).all() and weights.any()):
        message = "weights are numbers from 0, one of them more than 0"
        faults.append(Fault("IK002", message, where=where))
    if not (isinstance(goal.priority, int) and goal.priority >= 0):
        message = f"its priority is a whole number from 0, not {goal.priority!r}"
        faults.append(Fault("IK002", message, where=where))
    if not 0 <= goal.soft < 1:
        message = f"soft must be from 0 to less than 1, not {goal.soft}"
        faults.append(Fault("IK002", message, where=where))
    if not (goal.stretch >= 0 and np.isfinite(goal.stretch)):
        message = f"stretch must be a number from 0, not {goal.stretch}"
        faults.append(Fault("IK002", message, where=where))
    if not np.isfinite(goal.offset).all():
        faults.append(Fault("IK002", "its offset is not finite", where=where))
    if goal.aim > 0 and not abs(np.linalg.norm(goal.aim_axis) - 1) < 1e-6:
        faults.append(Fault("IK002", "its aim axis is not of length 1", where=where))
    return faults


def _root_faults(goal: Goal, rig: Rig, where: str) -> list[Fault]:
    if goal.root is None:
        return []
    if goal.root not in rig.names:
        message = f"no joint of {rig.name!r} is {excerpt(goal.root)}"
        return [Fault("IK001", message, where=where)]
    j = rig.index(goal.joint) if goal.joint in rig.names else -1
    while j >= 0 and rig.joints[j].name != goal.root:
        j = rig.joints[j].parent
    if j >= 0 or goal.joint not in rig.names:
        return []
    message = f"its root {goal.root!r} is not above {goal.joint!r}"
    return [Fault("IK007", message, where=where)]


def pack(targets: Targets, goals: tuple[Goal, ...]) -> FloatArray:
    """Return targets as the kernel takes them ``(B, E, 17)``, lengths in metres.

    Raises:
        OptionError: What a goal asks for is missing or of another shape (IK010), not
            finite, or a weight is less than 0 (IK011), with every such fault.
    """
    faults: list[Fault] = []
    weights = _weights(targets.weights, len(goals), faults)
    asked = np.array([goal.weights for goal in goals]) > 0
    asked = asked if weights is None else asked & (weights > 0)
    found: list[FloatArray | None] = []
    for i, (name, place) in enumerate(zip(PARTS, _PLACES, strict=True)):
        given = getattr(targets, name)
        width = place.stop - place.start
        shape = (len(goals), width)
        found.append(_part(name, given, shape, asked[..., i], faults))
    batches = {len(part) for part in (*found, weights) if part is not None}
    if len(batches) > 1:
        faults.append(Fault("IK010", f"targets of {sorted(batches)} problems at once"))
    if faults:
        raise OptionError(faults)
    packed = np.zeros((batches.pop() if batches else 0, len(goals), 17))
    packed[:, :, 6] = 1.0
    for part, place in zip(found, _PLACES, strict=True):
        if part is not None:
            packed[:, :, place] = np.where(np.isfinite(part), part, 0.0)
    packed[:, :, 3:7] = _rotations(packed[:, :, 3:7])
    packed[:, :, 13:] = 1.0 if weights is None else weights
    return packed


def _rotations(given: FloatArray) -> FloatArray:
    """Return quaternions of length 1; those without length turn nothing."""
    none = ~given.any(axis=-1, keepdims=True)
    return so3.normalize(np.where(none, so3.IDENTITY, given))


def _weights(
    given: ArrayLike | None, goals: int, faults: list[Fault]
) -> FloatArray | None:
    if given is None:
        return None
    weights = np.asarray(given, np.float64)
    if weights.ndim != 3 or weights.shape[1:] != (goals, 4):
        message = f"weights must have shape (B, {goals}, 4), not {weights.shape}"
        faults.append(Fault("IK010", message))
        return None
    bad = ~(np.isfinite(weights) & (weights >= 0)).all(axis=2)
    if bad.any():
        b, e = (int(i) for i in np.argwhere(bad)[0])
        message = f"weights[{b}, {e}] are no finite numbers from 0"
        faults.append(Fault("IK011", message))
    return weights


def _part(
    name: str,
    given: ArrayLike | None,
    shape: tuple[int, int],
    asked: BoolArray,
    faults: list[Fault],
) -> FloatArray | None:
    """Return the targets of one part; ``asked`` is ``(E,)`` or ``(B, E)``."""
    if given is None:
        if asked.any():
            goal = int(np.flatnonzero(asked.reshape(-1, shape[0]).any(axis=0))[0])
            faults.append(Fault("IK010", f"goal {goal} asks for {name}"))
        return None
    array = np.asarray(given, np.float64)
    if array.ndim != 3 or array.shape[1:] != shape:
        message = f"{name} must have shape (B, {shape[0]}, {shape[1]})"
        faults.append(Fault("IK010", f"{message}, not {array.shape}"))
        return None
    if asked.ndim == 2 and len(asked) != len(array):
        return array
    bad = ~np.isfinite(array).all(axis=2)
    if shape[1] == 4:
        bad |= ~array.any(axis=2)
    bad &= asked
    if bad.any():
        b, e = (int(i) for i in np.argwhere(bad)[0])
        message = f"{name}[{b}, {e}] are no finite numbers"
        if shape[1] == 4:
            message = f"{name}[{b}, {e}] is no rotation"
        faults.append(Fault("IK011", message))
    return array
