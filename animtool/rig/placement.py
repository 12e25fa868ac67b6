"""Where a skeleton stands, how large it is, and a rig brought there."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from animtool._types import FloatArray
from animtool.errors import Fault, FormatError
from animtool.maths import so3
from animtool.rig.limits import RangeLimit
from animtool.rig.parts import Attachment, Collider, HeldArray, IkChain, Mesh

if TYPE_CHECKING:
    from animtool.rig.skeleton import Joint, Pose, Rig
    from animtool.units import UpAxis

# A part of a placement nearer to none than this is the rounding of files [m], [1].
SAME = 1e-7


@dataclass(frozen=True, eq=False)
class Placement:
    """A rigid motion and an even scale: ``p -> translation + rotation · size · p``.

    Attributes:
        translations: ``(F, 3)`` [m]; F is 1 where nothing moves.
        rotations: Unit quaternions ``(F, 4)``.
        sizes: ``(F,)``, positive.
    """

    translations: FloatArray
    rotations: FloatArray
    sizes: FloatArray

    @staticmethod
    def turn(rotation: FloatArray) -> Placement:
        """Return one that only turns, by a quaternion ``(4,)``."""
        return Placement(np.zeros((1, 3)), np.asarray(rotation)[None], np.ones(1))

    @property
    def moves(self) -> bool:
        """Whether it changes over frames."""
        return len(self.sizes) > 1

    @property
    def size(self) -> float:
        """The scale that lengths of bones are multiplied by, that of the first frame.

        Where the scale changes, the roots hold what is left of it.
        """
        return float(self.sizes[0])

    @cached_property
    def is_none(self) -> bool:
        """Whether everything stays where it is."""
        away = np.abs(self.translations).max(initial=0.0)
        turned = 1.0 - np.abs(self.rotations[:, 3]).min(initial=1.0)
        sized = np.abs(self.sizes - 1.0).max(initial=0.0)
        # Of a turn by a small angle, w is off by an eighth of its square.
        return bool(away <= SAME and turned <= SAME**2 and sized <= SAME)

    def points(self, points: FloatArray) -> FloatArray:
        """Return points, placed; those of moving ones ``(F, N, 3)``."""
        sizes, rotations, translations = self._parts()
        # What is 1 or 0 leaves numbers to the last bit, and signs of zeros, alone.
        sized = points if (self.sizes == 1.0).all() else sizes * points
        turned = so3.rotate(rotations, sized)
        if not self.translations.any():
            return turned
        return np.asarray(turned + translations)

    def turns(self, rotations: FloatArray) -> FloatArray:
        """Return rotations, turned; those of moving ones ``(F, N, 4)``."""
        return so3.multiply(self._parts()[1], rotations)

    def _parts(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        if not self.moves:
            return self.sizes[0], self.rotations[0], self.translations[0]
        return (
            self.sizes[:, None, None],
            self.rotations[:, None],
            self.translations[:, None],
        )

    def inverse(self) -> Placement:
        """Return what undoes it."""
        back = so3.conjugate(self.rotations)
        shifts = so3.rotate(back, self.translations) / self.sizes[:, None]
        return Placement(-shifts, back, 1.0 / self.sizes)

    def after(self, other: Placement) -> Placement:
        """Return what another does, and then this one."""
        moved = self.sizes[:, None] * other.translations
        return Placement(
            so3.rotate(self.rotations, moved) + self.translations,
            so3.multiply(self.rotations, other.rotations),
            self.sizes * other.sizes,
        )

    def first(self) -> Placement:
        """Return that of the first frame."""
        return Placement(self.translations[:1], self.rotations[:1], self.sizes[:1])

    def steady(self) -> Placement:
        """Return it as one frame where all frames are the same."""
        if not self.moves:
            return self
        apart = [
            np.abs(self.translations - self.translations[:1]).max(),
            np.abs(self.sizes / self.sizes[0] - 1.0).max(),
            1.0 - np.abs((self.rotations * self.rotations[:1]).sum(axis=-1)).min(),
        ]
        limits = [SAME, SAME, SAME**2]
        same = all(a <= limit for a, limit in zip(apart, limits, strict=True))
        return self.first() if same else self

    def split(self, up: UpAxis) -> tuple[Placement, Placement]:
        """Return where it stands and faces, and before that, what sizes and rights it.

        The second holds the scale, and the turn that brings the axis of a skeleton that
        is nearest to up, such as Y under a stage of Z up, to up itself. The first holds
        all else: the way and the heading, and a slope.
        """
        axis = np.array(up.vector)
        own = so3.rotate(so3.conjugate(self.rotations[0]), axis)
        k = int(np.abs(own).argmax())
        nearest = np.zeros(3)
        nearest[k] = np.copysign(1.0, own[k])
        righting = _shortest(nearest, axis)
        frames = np.repeat(righting[None], len(self.sizes), axis=0)
        sized = Placement(np.zeros((len(frames), 3)), frames, self.sizes)
        back = so3.multiply(self.rotations, so3.conjugate(righting))
        stands = Placement(self.translations, back, np.ones(len(frames)))
        return stands, sized


def _shortest(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the shortest turn from one axis to another, opposite ones about X."""
    if (one == -other).all():
        return np.array([1.0, 0.0, 0.0, 0.0])
    return so3.between(one, other)


def placed_rig(rig: Rig, placement: Placement, up: UpAxis | None = None) -> Rig:
    """Return a rig brought to a placement at rest, that of its first frame.

    A scale goes into lengths: what joints carry is bound where they are, and is scaled
    with them.

    up: the up axis that it has then; None is its own.
    """
    placement = placement.first()
    if placement.is_none and up in {None, rig.up}:
        return rig
    roots = {joint.name for joint in rig.joints if joint.parent < 0}
    size = placement.size
    stands = rig.stands
    if stands is not None:
        # Where it stood before, seen from where it is now.
        rigid = replace(placement, sizes=np.ones(1))
        moved = replace(stands, translations=stands.translations * size)
        stands = rigid.after(moved).after(rigid.inverse())
    return replace(
        rig,
        joints=tuple(_joint(joint, placement) for joint in rig.joints),
        up=rig.up if up is None else up,
        bind={
            name: _pose(pose, placement, root=name in roots)
            for name, pose in rig.bind.items()
        },
        meshes=tuple(
            _mesh(mesh, placement, rig.meters_per_unit) for mesh in rig.meshes
        ),
        ik=tuple(_chain(chain, placement, roots) for chain in rig.ik),
        attach=tuple(
            _strands(entry, placement, rig.meters_per_unit) for entry in rig.attach
        ),
        colliders=tuple(_collider(one, size) for one in rig.colliders),
        stands=stands,
    )


def _joint(joint: Joint, placement: Placement) -> Joint:
    if joint.parent < 0:
        x, y, z = placement.points(np.array(joint.translation)).tolist()
        a, b, c, w = placement.turns(np.array(joint.rotation)).tolist()
        joint = replace(joint, translation=(x, y, z), rotation=(a, b, c, w))
    size = placement.size
    if size == 1.0:
        return joint
    limits = joint.limits
    if isinstance(limits, RangeLimit) and joint.type.value == "prismatic":
        limits = RangeLimit(limits.low * size, limits.high * size)
    x, y, z = joint.translation
    if joint.parent >= 0:
        x, y, z = x * size, y * size, z * size
    tips = tuple((x * size, y * size, z * size) for x, y, z in joint.tips)
    return replace(joint, translation=(x, y, z), tips=tips, limits=limits)


def _pose(pose: Pose, placement: Placement, *, root: bool) -> Pose:
    if root:
        x, y, z = placement.points(np.array(pose.translation)).tolist()
        a, b, c, w = placement.turns(np.array(pose.rotation)).tolist()
        return replace(pose, translation=(x, y, z), rotation=(a, b, c, w))
    if placement.size == 1.0:
        return pose
    x, y, z = (placement.size * np.array(pose.translation)).tolist()
    return replace(pose, translation=(x, y, z))


def _chain(chain: IkChain, placement: Placement, roots: Set[str]) -> IkChain:
    """Return a chain whose pole direction is turned where it is in the world."""
    if chain.pole_dir is None or chain.root not in roots:
        return chain
    turned = so3.rotate(placement.rotations[0], chain.pole_dir)
    x, y, z = turned.tolist()
    return replace(chain, pole_dir=(x, y, z))


def _mesh(mesh: Mesh, placement: Placement, unit: float) -> Mesh:
    """Return a mesh whose points are moved where they are bound."""
    bind = np.eye(4) if mesh.geom_bind is None else np.reshape(mesh.geom_bind, (4, 4))
    whole = placement_matrix(placement, unit)
    return replace(mesh, geom_bind=tuple((whole @ bind).ravel().tolist()))


def placement_matrix(placement: Placement, unit: float = 1.0) -> FloatArray:
    """Return the placement of the first frame for column vectors ``(4, 4)``.

    unit: of the lengths of those vectors [m].
    """
    whole = np.eye(4)
    whole[:3, :3] = so3.to_matrix(placement.rotations[0])
    if placement.size != 1.0:
        whole[:3, :3] *= placement.size
    whole[:3, 3] = placement.translations[0] / unit
    return whole


def _strands(entry: Attachment, placement: Placement, unit: float) -> Attachment:
    """Return an attachment whose strands are moved where they are in the world."""
    if entry.points is None:
        return entry
    in_unit = replace(placement, translations=placement.translations / unit)
    try:
        points = in_unit.points(entry.points.load())
    except ValueError as error:
        raise FormatError(Fault("RIG018", f"{entry.name!r}: {error}")) from error
    return replace(entry, points=HeldArray(points))


def _collider(one: Collider, size: float) -> Collider:
    if size == 1.0:
        return one
    shape = one.capsule
    x, y, z = shape.offset
    scaled = replace(
        shape,
        radius=shape.radius * size,
        length=shape.length * size,
        offset=(x * size, y * size, z * size),
    )
    return replace(one, capsule=scaled)


def at_origin(rig: Rig) -> Rig:
    """Return a rig of its size and upright, away from where its stage has it."""
    if rig.stands is None:
        return rig
    return replace(placed_rig(rig, rig.stands.inverse()), stands=None)
