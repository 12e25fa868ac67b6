"""Small rigs with things attached, and takes that move them."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool.core.clock import Clock
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.passes import PassContext
from animtool.motion.take import Take, TakeStream
from animtool.rig.parts import Attachment, Collider, LoadedArray, Mesh, Skin
from animtool.rig.skeleton import Joint, JointType, Rig
from animtool.systems.attach import take_pass
from animtool.systems.attach.settings import SimulateOptions

__all__ = [
    "GRAVITY",
    "moved",
    "sheet_rig",
    "simulate",
    "simulated",
    "strands_rig",
    "tail_rig",
    "take_of",
]

GRAVITY = 9.81


def tail_rig(
    bones: int = 1, length: float = 0.5, colliders: tuple[Collider, ...] = ()
) -> Rig:
    """Return a body with a tail of bones that point to +X, all but the last joints."""
    joints = [Joint("body", -1)]
    for k in range(bones):
        offset = (0.0, 0.0, 0.0) if k == 0 else (length, 0.0, 0.0)
        tips = ((length, 0.0, 0.0),) if k == bones - 1 else ()
        joints.append(
            Joint(f"tail_{k + 1}", k, JointType.BALL, translation=offset, tips=tips)
        )
    names = tuple(joint.name for joint in joints[1:])
    attach = (Attachment("tail", "spring_chain", names),)
    return Rig("beast", tuple(joints), attach=attach, colliders=colliders)


def strands_rig(colliders: tuple[Collider, ...] = ()) -> Rig:
    """Return a head with three strands of five points that hang down."""
    down = np.linspace(0, -0.4, 5)
    points = np.zeros((3, 5, 3))
    points[..., 1] = down
    points[..., 0] = np.array([0.1, 0.2, 0.3])[:, None]
    attach = (Attachment("hair", "strands", ("head",), points=LoadedArray(points)),)
    return Rig("head", (Joint("head", -1),), attach=attach, colliders=colliders)


def sheet_rig(
    size: int = 4, pins: tuple[int, ...] | None = None, side: float = 0.3
) -> Rig:
    """Return a post with a sheet in its plane that hangs from its upper edge.

    Its sides are ``side`` long [m], with ``size`` points each.
    """
    across, down = np.meshgrid(np.linspace(0, side, size), np.linspace(0, -side, size))
    points = np.stack([across, down, np.zeros_like(down)], axis=-1).reshape(-1, 3)
    row, column = np.mgrid[: size - 1, : size - 1]
    corner = (row * size + column).ravel()
    faces = np.stack([corner, corner + 1, corner + size + 1, corner + size], axis=1)
    held = LoadedArray(np.array(range(size) if pins is None else pins, np.float64))
    every = np.zeros((len(points), 1))
    skin = Skin("linear", ("post",), LoadedArray(every), LoadedArray(every + 1.0))
    mesh = Mesh(
        "flag", LoadedArray(points), LoadedArray(faces.astype(float)), skin=skin
    )
    attach = (Attachment("flag", "cloth", mesh="flag", pins=held),)
    return Rig("pole", (Joint("post", -1),), meshes=(mesh,), attach=attach)


def take_of(
    rig: Rig,
    fps: int,
    seconds: float,
    place: Callable[[np.ndarray], np.ndarray] | None = None,
    turn: Callable[[np.ndarray], np.ndarray] | None = None,
    **turns: tuple[float, float, float],
) -> Take:
    """Return a take whose root goes and turns as functions of time say.

    Args:
        rig: The character.
        fps: Frames a second.
        seconds: Length.
        place: From times ``(F,)`` to positions ``(F, 3)`` [m].
        turn: From times to rotation vectors ``(F, 3)`` [rad].
        turns: Rotation vectors of other joints, by name, that do not change.
    """
    count = round(seconds * fps) + 1
    t = np.arange(count) / fps
    translations = np.repeat(rig.rest_translations[None], count, axis=0)
    rotations = np.repeat(rig.rest_rotations[None], count, axis=0)
    if place is not None:
        translations[:, 0] = place(t)
    if turn is not None:
        rotations[:, 0] = so3.exp(turn(t))
    for name, vector in turns.items():
        rotations[:, rig.index(name)] = so3.exp(np.array(vector))
    motion = Motion(
        Channel.from_dense(translations),
        Channel.from_dense(so3.align_signs(rotations)),
    )
    return Take(rig, Clock(Fraction(fps), Fraction(1), Fraction(1), count), motion)


def simulate(stream: TakeStream, options: SimulateOptions) -> TakeStream:
    """Return a take with what options name simulated, outside of any scene."""
    context = PassContext(lambda _: stream.collect(), Path())
    return take_pass.simulate(stream, options, context)


def simulated(take: Take, blocks: int = 1, **options: object) -> tuple[Take, list[str]]:
    """Return a take with its only attachment simulated, and the codes of notices."""
    stream = TakeStream.of(take)
    parts = np.array_split(np.arange(take.clock.count), blocks)
    stream.blocks = iter([take.motion.select(part) for part in parts if len(part)])
    given = {"what": (take.rig.attach[0].name,), **options}
    done = simulate(stream, SimulateOptions(**given))
    made = done.collect()
    return made, [notice.code for notice in done.notices]


def moved(take: Take) -> np.ndarray:
    """Return where the attachment of a take is: bone ends of a tail, or points."""
    if take.motion.points:
        (points,) = take.motion.points.values()
        return points.dense()
    world = take.world()
    tip = np.array(take.rig.joints[-1].tips[0])
    end = world.positions[:, -1] + world.linear[:, -1] @ tip
    return np.concatenate([world.positions[:, 1:], end[:, None]], axis=1)
