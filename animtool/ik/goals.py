"""What may be asked of a joint, and where it should be."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from animtool._types import ArrayLike, BoolArray, FloatArray, IntArray
from animtool.errors import Fault, OptionError, counted, excerpt
from animtool.rig.parts import Vector
from animtool.rig.skeleton import Rig
from animtool.similar import similar

# Numbers beyond this have no square [m]; no character is so large.
FARTHEST = 1e100


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


# Where each part stands in a row of targets.
_PLACES = {
    "positions": slice(0, 3),
    "rotations": slice(3, 7),
    "aims": slice(7, 10),
    "poles": slice(10, 13),
    "weights": slice(13, 17),
}
PARTS = ("positions", "rotations", "aims", "poles")


def goal_faults(goal: Goal, rig: Rig, where: str) -> list[Fault]:
    """Return what is wrong with a goal by itself."""
    faults = []
    if goal.joint not in rig.names:
        near = similar(goal.joint, rig.names)
        hint = f"did you mean {near}?" if near else None
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
    if np.shape(goal.offset) != (3,):
        count = counted(np.size(goal.offset), "number")
        message = f"its offset has {count} where 3 are wanted"
        faults.append(Fault("IK002", message, where=where))
    if not (np.abs(goal.offset) <= FARTHEST).all():
        message = f"its offset is beyond {FARTHEST:g} m, or no number"
        faults.append(Fault("IK002", message, where=where))
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


def rows_of(targets: Targets, frames: IntArray | slice) -> Targets:
    """Return the targets of some frames."""
    parts = [getattr(targets, part.name) for part in fields(Targets)]
    return Targets(*[None if p is None else np.asarray(p)[frames] for p in parts])


def pack(targets: Targets, goals: tuple[Goal, ...]) -> FloatArray:
    """Return targets side by side ``(B, E, 17)``; numbers nobody asks for are finite.

    Raises:
        OptionError: What a goal asks for is missing or of another shape (IK010), not
            finite, or a weight is less than 0 (IK011), with every such fault.
    """
    faults: list[Fault] = []
    parts = {
        name: _shaped(name, getattr(targets, name), len(goals), place, faults)
        for name, place in _PLACES.items()
    }
    found = {name: part for name, part in parts.items() if part is not None}
    batches = {len(part) for part in found.values()}
    if len(batches) > 1:
        faults.append(Fault("IK010", f"targets of {sorted(batches)} problems at once"))
    packed = np.zeros((min(batches, default=1), len(goals), 17))
    packed[:, :, 6] = packed[:, :, 13:] = 1.0
    for name, part in found.items():
        packed[:, :, _PLACES[name]] = part[: len(packed)]
    asked = _asked(goals, packed)
    wanting = asked & [getattr(targets, name) is None for name in PARTS]
    if faults or wanting.any() or not _is_plain(packed):
        faults += _value_faults(packed, asked, wanting)
        np.nan_to_num(packed, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
    if faults:
        raise OptionError(faults)
    for name in ("rotations", "aims", "poles"):
        _bring_in(packed[:, :, _PLACES[name]])
    return packed


def _bring_in(directions: FloatArray) -> None:
    """Scale numbers of which only the direction counts to where they have squares."""
    sizes = np.abs(directions).max(axis=2, keepdims=True)
    if (sizes > FARTHEST).any():
        directions *= FARTHEST / np.maximum(sizes, FARTHEST)


def _shaped(
    name: str,
    given: ArrayLike | None,
    goals: int,
    place: slice,
    faults: list[Fault],
) -> FloatArray | None:
    """Return the targets of one part, or None where there are none of that shape."""
    if given is None:
        return None
    array = np.asarray(given, np.float64)
    width = place.stop - place.start
    if array.ndim == 3 and array.shape[1:] == (goals, width):
        return array
    message = f"{name} must have shape (B, {goals}, {width}), not {array.shape}"
    faults.append(Fault("IK010", message))
    return None


def _asked(goals: tuple[Goal, ...], packed: FloatArray) -> BoolArray:
    """Return which parts of which goals each problem asks for ``(B, E, 4)``."""
    own = np.array([goal.weights for goal in goals]) > 0
    return np.asarray(own & (packed[:, :, 13:] > 0))


def _is_plain(packed: FloatArray) -> bool:
    """Return whether there is nothing to look at in any part, asked for or not."""
    turned = packed[:, :, 3:7].any(axis=2).all()
    return bool(np.isfinite(packed).all() and turned and (packed[:, :, 13:] >= 0).all())


def _value_faults(
    packed: FloatArray, asked: BoolArray, wanting: BoolArray
) -> list[Fault]:
    """Return what is missing or no number where it is asked for ``(B, E, 4)``."""
    faults = []
    weights = packed[:, :, 13:]
    bad = ~(np.isfinite(weights) & (weights >= 0)).all(axis=2)
    if bad.any():
        b, e = (int(i) for i in np.argwhere(bad)[0])
        message = f"weights[{b}, {e}] are no finite numbers from 0"
        faults.append(Fault("IK011", message))
    for i, name in enumerate(PARTS):
        if wanting[..., i].any():
            goal = int(np.argwhere(wanting[..., i])[0, 1])
            faults.append(Fault("IK010", f"goal {goal} asks for {name}"))
            continue
        part = packed[:, :, _PLACES[name]]
        bad = ~np.isfinite(part).all(axis=2)
        if name == "rotations":
            bad |= ~part.any(axis=2)
        bad &= asked[..., i]
        if bad.any():
            b, e = (int(i) for i in np.argwhere(bad)[0])
            what = "is no rotation" if name == "rotations" else "are no finite numbers"
            faults.append(Fault("IK011", f"{name}[{b}, {e}] {what}"))
    return faults
