"""Poses of a take as one problem over many frames.

A problem has one rig, whose joints above the goals' chains stand still. In a take they
move, and joints may do what their types cannot. So the targets of each frame are
brought into the frame of what carries the chain, and what coordinates cannot say goes
into the rest pose.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import Fault, OptionError
from animtool.core.record import dataclass
from animtool.ik.goals import KINDS, Goal, Targets, TargetValue, rows_of
from animtool.ik.problem import build
from animtool.maths import so3
from animtool.motion.take import Take
from animtool.rig.driver_plan import plan_of
from animtool.rig.joints import (
    LocalTransforms,
    coordinates_from_local,
    local_from_coordinates,
)
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.skeleton import Rig

# Transforms that differ by less are the same but for rounding [m], [rad].
SAME = 1e-9


@dataclass(frozen=True, slots=True)
class Part:
    """Frames that are problems of one rig."""

    rig: Rig  # its rest pose holds what coordinates cannot say of the frames
    frames: slice  # which frames they are
    coordinates: FloatArray  # of the poses ``(N, Q)``
    places: FloatArray  # what carries each goal's chain: positions ``(N, E, 3)`` [m]
    turns: FloatArray  # and rotations ``(N, E, 4)``

    def to_chain_frame(self, targets: Targets) -> Targets:
        """Return the targets of all frames as seen from the part's first pose."""
        turn = so3.multiply(self.turns[:1], so3.conjugate(self.turns))

        given = rows_of(targets, self.frames)
        parts = {}
        for kind in KINDS:
            values = np.asarray(getattr(given, kind.targets))
            if kind.value is TargetValue.ROTATION:
                parts[kind.targets] = so3.multiply(turn, values)
            else:
                away = so3.rotate(turn, values - self.places)
                parts[kind.targets] = np.asarray(self.places[:1] + away)
        return replace(given, **parts)


@dataclass(frozen=True, slots=True)
class Parts:
    """The frames of a take as parts."""

    all: list[Part]  # one, or where none fits all frames, one each
    # Names of the joints, and controls of their drivers, for which none does.
    between: tuple[str, ...]


def parts_of(
    rig: Rig,
    local: LocalTransforms,
    world: WorldTransforms,
    goals: Sequence[Goal],
    joints: Collection[str] | None,
    controls: Mapping[str, FloatArray] | None = None,
) -> Parts:
    """Return the frames of a take as parts.

    ``controls``: values ``(F,)`` of those that drivers of joints read.
    """
    coordinates = coordinates_from_local(rig, local)
    controls = controls or {}
    rig = with_controls(rig, controls, 0)
    probe = build(rig, goals, joints=joints, pose=coordinates[0])
    moving = {rig.index(name) for name in probe.joints}
    paths = [rig.upwards(rig.index(goal.joint)) for goal in goals]
    tops = [max(i for i, j in enumerate(path) if j in moving) for path in paths]
    carriers = [rig.parents[path[top]] for path, top in zip(paths, tops, strict=True)]
    inside = {j for path, top in zip(paths, tops, strict=True) for j in path[: top + 1]}
    rests = _rests(rig, local, coordinates)
    pivots = inside - _turning(goals, paths)
    changes = _moved(local), _turned(local)
    strays = _moved(rests) | _turned(rests)
    between = [
        j
        for j in sorted(inside)
        if (strays[j] if j in moving else changes[0][j])
        or (j not in moving | pivots and changes[1][j])
    ]
    read = _moving_sources(rig, moving & inside, moving, changes[0] | changes[1])
    between = sorted({*between, *read})
    others = [name for name, values in controls.items() if (values != values[0]).any()]
    count = len(coordinates)
    spans = (
        [slice(f, f + 1) for f in range(count)]
        if between or others
        else [slice(0, count)]
    )
    places, turns = _carriers(world, carriers)
    of_paths = sorted({j for path in paths for j in path})
    parts = [
        Part(
            with_controls(
                _with_rests(rig, rests, span.start, of_paths), controls, span.start
            ),
            span,
            coordinates[span],
            places[span],
            turns[span],
        )
        for span in spans
    ]
    return Parts(parts, (*(rig.names[j] for j in between), *others))


def _moving_sources(
    rig: Rig, driven: set[int], free: set[int], changed: BoolArray
) -> list[int]:
    """Return joints that driven ones read, which move but are not solved."""
    if not rig.is_driven:
        return []
    plan = plan_of(rig)
    read = {
        source for j in driven.intersection(plan.joints) for source in plan.sources(j)
    }
    return [j for j in read - free if changed[j]]


def with_controls(rig: Rig, values: Mapping[str, FloatArray], frame: int) -> Rig:
    """Return a rig whose controls stand at values of a frame, as their defaults."""
    if not values:
        return rig
    controls = tuple(
        replace(control, default=float(values[control.name][frame]))
        if control.name in values
        else control
        for control in rig.controls
    )
    return replace(rig, controls=controls)


def _turning(goals: Sequence[Goal], paths: Sequence[Sequence[int]]) -> set[int]:
    """Return the joints whose rotation matters: not those that turn about the point."""
    turning: set[int] = set()
    for goal, path in zip(goals, paths, strict=True):
        turning.update(path[1:] if goal.pivots else path)
    return turning


def _rests(
    rig: Rig, local: LocalTransforms, coordinates: FloatArray
) -> LocalTransforms:
    """Return the rest poses with which coordinates say exactly what joints do."""
    # local = rest · motion, so rest = local · motion⁻¹.
    model = local_from_coordinates(rig, coordinates)
    undo = so3.conjugate(rig.rest_rotations)
    motion_turn = so3.multiply(undo, model.rotations)
    motion_move = so3.rotate(undo, model.translations - rig.rest_translations)
    turns = so3.multiply(local.rotations, so3.conjugate(motion_turn))
    places = local.translations - so3.rotate(turns, motion_move)
    return LocalTransforms(places, turns)


def _moved(local: LocalTransforms) -> BoolArray:
    """Return which joints are not in every frame where they are in the first."""
    away = np.abs(local.translations - local.translations[:1]).max(axis=(0, 2))
    return np.asarray(away > SAME, np.bool_)


def _turned(local: LocalTransforms) -> BoolArray:
    """Return which joints are not in every frame turned as in the first."""
    turned = so3.angle_between(local.rotations, local.rotations[:1]).max(axis=0)
    return np.asarray(turned > SAME, np.bool_)


def _with_rests(
    rig: Rig, rests: LocalTransforms, frame: int, moving: Sequence[int]
) -> Rig:
    """Return the rig with the rest pose of a frame, where that is another."""
    joints = list(rig.joints)
    for j in moving:
        place, turn = rests.translations[frame, j], rests.rotations[frame, j]
        apart = np.abs(place - rig.rest_translations[j]).max() > SAME
        if apart or so3.angle_between(turn, rig.rest_rotations[j]) > SAME:
            x, y, z = place.tolist()
            a, b, c, w = turn.tolist()
            joints[j] = replace(joints[j], translation=(x, y, z), rotation=(a, b, c, w))
    return rig if tuple(joints) == rig.joints else replace(rig, joints=tuple(joints))


def _carriers(
    world: WorldTransforms, joints: Sequence[int]
) -> tuple[FloatArray, FloatArray]:
    """Return where joints are ``(F, E, 3)`` and ``(F, E, 4)``; -1 is the world."""
    count = len(world.positions)
    places = np.zeros((count, len(joints), 3))
    turns = np.tile(so3.IDENTITY, (count, len(joints), 1))
    for e, j in enumerate(joints):
        if j >= 0:
            places[:, e] = world.positions[:, j]
            turns[:, e] = so3.align_signs(so3.from_matrix(world.linear[:, j]))
    return places, turns


def refuse_scales(
    take: Take, effectors: Iterable[tuple[str, str]], path: Path | None = None
) -> None:
    """Refuse scales of what an effector hangs from: a chain has lengths that stay."""
    channel = take.motion.scales
    if channel is None:
        return
    scaled = (channel.rest != 1.0).any(axis=1)
    scaled[channel.animated] |= (channel.values != 1.0).any(axis=(0, 2))
    faults = {}
    place = None if path is None else str(path)
    for effector, joint in effectors:
        for j in take.rig.upwards(take.rig.index(joint)):
            if scaled[j]:
                name = take.rig.names[j]
                message = f"{effector!r} is below {name!r}, which is scaled"
                hint = "inverse kinematics needs joints without scale"
                faults[name] = Fault("TGT016", message, place, (), hint)
    if faults:
        raise OptionError(list(faults.values()))
