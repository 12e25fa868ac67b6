"""A joint that hangs on a particle of a rope or strand that a scene simulates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from animtool._types import FloatArray
from animtool.documents.names import nearest
from animtool.errors import Fault, OptionError
from animtool.maths import so3
from animtool.passes import OptionChecks, Pass, PassContext, Scope, TakePart
from animtool.rig.kinematics import WorldTransforms, rest_world
from animtool.rig.skeleton import JointType
from animtool.take import Take
from animtool.units import UpAxis


@dataclass(frozen=True, slots=True)
class HangOptions:
    """What hangs where.

    Attributes:
        joint: A free joint of the rig; what is below it goes along.
        system: Name of a rope or of strands of the scene's ``systems``.
        particle: Of it, by the name of its place or by its number.
        axis: Of the joint, in its own frame, that lies along the last segment, away
            from the rope; None is what points down at rest, and zeros leave the
            joint's rotation as it is.
    """

    joint: str = ""
    system: str = ""
    particle: str = "end"
    axis: Sequence[float] | None = None


def hang(
    take: Take,
    joint: str,
    ends: FloatArray,
    axis: Sequence[float] | None = None,
) -> Take:
    """Return a take whose joint follows the last segment of a rope.

    The joint's origin is at the end of the segment. It keeps the rotation that the take
    has, turned the shortest way until its axis lies along the segment.

    Limits: where the axis points against the segment, which way it turns is arbitrary.

    Args:
        take: F frames.
        joint: Name of a free joint.
        ends: The particle before the last and the last ``(F, 2, 3)`` [m], in the
            space of the take.
        axis: As `HangOptions` has it.

    Raises:
        OptionError: The joint is unknown, not free or below one that is scaled to 0,
            or the axis is not finite (SIM192).
    """
    rig, motion = take.rig, take.motion
    _check_axis(axis)
    if joint not in rig.names:
        hint = nearest(joint, rig.names)
        raise _refusal(f"unknown joint {joint!r}", "joint", hint)
    j = rig.index(joint)
    if rig.joints[j].type is not JointType.FREE:
        message = f"joint {joint!r} is of type {rig.joints[j].type}, and cannot leave "
        raise _refusal(f"{message}its parent", "joint", "make it `type: free`")
    at, world = np.array([j]), take.world()
    _check_scales(take, world, j)
    turn = world.rotations[:, j]
    down = _axis(take, j) if axis is None else np.asarray(axis, np.float64)
    if down.any():
        along = ends[:, 1] - ends[:, 0]
        turn = so3.multiply(_shortest(so3.rotate(turn, down), along), turn)
    places, turns = _local(world, rig.joints[j].parent, ends[:, 1], turn)
    turns = so3.align_signs(turns)
    return replace(
        take,
        motion=replace(
            motion,
            translations=motion.translations.put(at, places[:, None]).compact(),
            rotations=motion.rotations.put(at, turns[:, None]).compact(),
        ),
    )


def _axis(take: Take, joint: int) -> FloatArray:
    """Return what points down at rest, in the frame of a joint."""
    down = -np.eye(3)[{UpAxis.Y: 1, UpAxis.Z: 2}[take.rig.up]]
    rest = rest_world(take.rig).rotations[0, joint]
    return np.asarray(so3.rotate(so3.conjugate(rest), down))


def _shortest(before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the shortest rotations ``(F, 4)`` of directions to others ``(F, 3)``."""
    sizes = [np.linalg.norm(v, axis=1, keepdims=True) for v in (before, after)]
    # A segment without length has no direction.
    still = (sizes[0] == 0) | (sizes[1] == 0)
    a, b = (
        np.divide(v, size, out=np.zeros_like(v), where=size > 0)
        for v, size in zip((before, after), sizes, strict=True)
    )
    across = np.cross(a, b)
    angle = np.arctan2(
        np.linalg.norm(across, axis=1, keepdims=True), (a * b).sum(1, keepdims=True)
    )
    # Half a turn goes about anything across.
    other = np.cross(a, np.eye(3)[np.abs(a).argmin(axis=1)])
    parallel = np.linalg.norm(across, axis=1, keepdims=True) < 1e-12
    axis = np.where(parallel, other, across)
    axis = axis / np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-300)
    return so3.exp(np.where(still, 0.0, axis * angle))


def _local(
    world: WorldTransforms, parent: int, places: FloatArray, turns: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return world transforms of a joint in the space of its parent."""
    if parent < 0:
        return places, turns
    inverse = np.linalg.inv(world.linear[:, parent])
    local = np.einsum("fij,fj->fi", inverse, places - world.positions[:, parent])
    undo = so3.conjugate(world.rotations[:, parent])
    return np.ascontiguousarray(local), so3.multiply(undo, turns)


def _check_scales(take: Take, world: WorldTransforms, joint: int) -> None:
    """Refuse a joint below one that is scaled to 0: no value brings it anywhere."""
    parent = take.rig.joints[joint].parent
    if parent < 0:
        return
    gone = np.flatnonzero(np.linalg.det(world.linear[:, parent]) == 0.0)
    if len(gone):
        message = (
            f"joint {take.rig.names[joint]!r} cannot hang: a joint above it is scaled "
            f"to 0 at frame {take.clock.times[gone[0]]:g}"
        )
        raise _refusal(message, "joint", "give that joint another scale there")


def _check_axis(axis: Sequence[float] | None) -> None:
    if axis is None:
        return
    if len(axis) != 3 or not all(math.isfinite(value) for value in axis):
        raise _refusal(f"axis must be three finite numbers, not {list(axis)}", "axis")


def _named(options: HangOptions, key: str) -> None:
    if not getattr(options, key):
        raise _refusal(f"{key} is missing", key)


def _refusal(message: str, where: str, hint: str | None = None) -> OptionError:
    return OptionError(Fault("SIM192", message, where=where, hint=hint))


def _run(take: Take, options: HangOptions, context: PassContext) -> Take:
    if context.segments is None:
        message = "only a scene with systems has something to hang on"
        raise _refusal(message, "system")
    ends = context.segments(take, options.system, options.particle, context.progress)
    return hang(take, options.joint, ends, options.axis)


def _checks(options: HangOptions) -> OptionChecks:
    return {
        "joint": lambda: _named(options, "joint"),
        "system": lambda: _named(options, "system"),
        "axis": lambda: _check_axis(options.axis),
    }


PASS = Pass(
    "hang",
    "Hang a joint on the end of a rope that the scene simulates",
    HangOptions,
    Scope.CLIP,
    _run,
    _checks,
    reads=frozenset({TakePart.RIG, TakePart.JOINTS, TakePart.CLOCK}),
    changes=frozenset({TakePart.JOINTS}),
    tells=True,
)
