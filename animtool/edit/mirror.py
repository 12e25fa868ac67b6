"""Swapping the left and right of a motion."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TypeAlias

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.choices import chosen
from animtool.edit.joint_names import joint_index
from animtool.errors import Fault, OptionError
from animtool.maths import so3
from animtool.passes import EVERY_PART, MOTION_PARTS, Pass, PassContext, Scope, TakePart
from animtool.rig.skeleton import Rig
from animtool.take import Channel, Motion, Take, TakeStream

__all__ = ["PASS", "Axis", "MirrorOptions", "mirror", "mirror_pairs"]


_Look: TypeAlias = Callable[[FloatArray, IntArray], FloatArray]


class Axis(StrEnum):
    """An axis of the world."""

    X = "X"
    Y = "Y"
    Z = "Z"


@dataclass(frozen=True, slots=True)
class MirrorOptions:
    """Where the mirror stands, and what it swaps.

    Attributes:
        axis: Normal of the mirror's plane.
        pairs: Names of joints that change places; the rest is found by what the
            rig states, then by names.
    """

    axis: Axis = Axis.X
    pairs: tuple[tuple[str, str], ...] = ()


def mirror(
    take: Take, axis: Axis | str = Axis.X, pairs: Sequence[Sequence[str]] = ()
) -> Take:
    """Return the take seen in a mirror, on the same rig.

    What a joint does beyond its rest frame, in the world, its partner does
    mirrored; rest offsets stay each joint's own, so that a rig whose halves are
    framed differently works, and what is static stays so. The plane goes through
    the rest position of each root. Twice is the source again.

    Limits: scales that differ by axis keep their meaning, and come back, only where
    partners' axes are parallel or at right angles in the mirror.

    Raises:
        OptionError: A pair names no joint (SCN012), or partners do not hang from
            partners (SCN019), or there is no such axis (SCN025).
    """
    options = MirrorOptions(chosen(Axis, axis, "axis"), _tuples(pairs))
    return _mirrored(TakeStream.of(take), options).collect()


def _tuples(pairs: Sequence[Sequence[str]]) -> tuple[tuple[str, str], ...]:
    if any(isinstance(pair, str) or len(pair) != 2 for pair in pairs):
        message = f"pairs must be pairs of joint names, not {list(pairs)!r:.80}"
        raise OptionError(Fault("SCN019", message))
    return tuple((a, b) for a, b in pairs)


# What is left in a name, and what is right in its place.
_SIDES = [
    (r"left", "right"), (r"Left", "Right"), (r"LEFT", "RIGHT"),
    (r"(?<=[_.])l(?=$|[_.])", "r"), (r"(?<=[_.])L(?=$|[_.])", "R"),
    (r"^L(?=[_A-Z])", "R"), (r"^l(?=[_A-Z])", "r"), (r"Lf", "Rt"),
]  # fmt: skip


def mirror_pairs(
    names: Sequence[str], stated: Sequence[tuple[str, str]] = ()
) -> IntArray:
    """Return the partner of each name, itself where it has none.

    >>> mirror_pairs(["hips", "arm_l", "arm_r", "LeftLeg", "RightLeg"]).tolist()
    [0, 2, 1, 4, 3]
    """
    index = {name: i for i, name in enumerate(names)}
    partners = np.arange(len(names))
    free = set(names)

    def pair(a: str, b: str) -> None:
        partners[index[a]], partners[index[b]] = index[b], index[a]
        free.difference_update((a, b))

    for a, b in stated:
        if a in free and b in free:
            pair(a, b)
    for name in names:
        for left, right in _SIDES:
            other = re.sub(left, right, name)
            if other != name and other in free and name in free:
                pair(name, other)
    return partners


def _stated(rig: Rig, pairs: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    for name in (name for pair in pairs for name in pair):
        joint_index(rig, name, "pairs")
    own = [(j.name, str(getattr(j, "mirror", ""))) for j in rig.joints]
    return [*pairs, *((a, b) for a, b in own if b in rig.names)]


def _mirrored(
    stream: TakeStream, options: MirrorOptions, _: PassContext | None = None
) -> TakeStream:
    rig = stream.rig
    partners = mirror_pairs(rig.names, _stated(rig, _tuples(options.pairs)))
    _check_stated(rig, options.pairs, partners)
    _check_tree(rig, partners)
    glass = _Glass.of(rig, partners, "XYZ".index(chosen(Axis, options.axis, "axis")))
    swaps = [
        mirror_pairs([part.name for part in getattr(rig, kind, ())])
        for kind in ("shapes", "controls")
    ]
    return replace(stream, blocks=_blocks(stream, glass, swaps))


def _check_stated(rig: Rig, pairs: Sequence[Sequence[str]], partners: IntArray) -> None:
    """Refuse stated pairs whose parents are no partners."""
    faults = []
    for a, b in pairs:
        above = [rig.joints[rig.index(name)].parent for name in (a, b)]
        if min(above) < 0 and above[0] != above[1]:
            low, top = (a, b) if above[0] >= 0 else (b, a)
            faults.append(f"{top!r} hangs from no joint, {low!r} does")
        elif min(above) >= 0 and partners[above[0]] != above[1]:
            one, two = (repr(rig.names[parent]) for parent in above)
            faults.append(f"they hang from {one} and {two}, which are no partners")
        else:
            continue
        faults[-1] = f"pairs: {a!r} and {b!r} cannot change places: {faults[-1]}"
    if faults:
        hint = "pair their parents too, or name other joints"
        raise OptionError([Fault("SCN019", text, hint=hint) for text in faults])


def _check_tree(rig: Rig, partners: IntArray) -> None:
    for i, joint in enumerate(rig.joints):
        above = int(partners[joint.parent]) if joint.parent >= 0 else -1
        other = rig.joints[int(partners[i])]
        if other.parent != above:
            message = f"{joint.name!r} and {other.name!r} do not hang from partners"
            raise OptionError(Fault("SCN019", message, hint="state the pairs"))


@dataclass(frozen=True, slots=True)
class _Glass:
    """How values of each joint look on its partner."""

    partners: IntArray
    normal: FloatArray
    world: FloatArray  # rest rotations in the world (J, 4)
    above: FloatArray  # of the parents
    rest: FloatArray

    @staticmethod
    def of(rig: Rig, partners: IntArray, axis: int) -> _Glass:
        world = rig.rest_rotations.copy()
        above = np.tile(so3.IDENTITY, (len(world), 1))
        for i, joint in enumerate(rig.joints):
            if joint.parent >= 0:
                above[i] = world[joint.parent]
                world[i] = so3.multiply(above[i], world[i])
        normal = np.where(np.arange(3) == axis, -1.0, 1.0)
        return _Glass(partners, normal, world, above, rig.rest_translations)

    def rotations(self, values: FloatArray, j: IntArray) -> FloatArray:
        p = self.partners[j]
        turned = so3.multiply(self.above[j], values)
        turned = so3.multiply(turned, so3.conjugate(self.world[j]))
        # A mirror turns axes of rotation the other way round.
        turned = turned * np.append(-self.normal, 1.0)
        turned = so3.multiply(so3.conjugate(self.above[p]), turned)
        return so3.multiply(turned, self.world[p])

    def translations(self, values: FloatArray, j: IntArray) -> FloatArray:
        p = self.partners[j]
        away = so3.rotate(self.above[j], values - self.rest[j]) * self.normal
        return self.rest[p] + so3.rotate(so3.conjugate(self.above[p]), away)

    def scales(self, values: FloatArray, j: IntArray) -> FloatArray:
        ours, theirs = (so3.to_matrix(self.world[k]) for k in (j, self.partners[j]))
        change = np.swapaxes(theirs, -1, -2) @ (self.normal[:, None] * ours)
        return np.asarray((change**2 @ values[..., None])[..., 0])


def _blocks(
    stream: TakeStream, glass: _Glass, swaps: list[IntArray]
) -> Iterator[Motion]:
    for block in stream.blocks:
        yield Motion(
            _seen(block.translations, glass.partners, glass.translations),
            _seen(block.rotations, glass.partners, glass.rotations),
            None
            if block.scales is None
            else _seen(block.scales, glass.partners, glass.scales),
            _swapped(block.weights, swaps[0]),
            _swapped(block.controls, swaps[1]),
            block.track_times,
        )


def _swapped(channel: Channel | None, partners: IntArray) -> Channel | None:
    if channel is None or len(partners) != len(channel.rest):
        return channel
    return _seen(channel, partners, lambda values, _: values)


def _seen(channel: Channel, partners: IntArray, look: _Look) -> Channel:
    everyone = np.arange(len(channel.rest))
    rest = look(channel.rest, everyone)[partners]
    values = look(channel.values, channel.animated)
    order = np.argsort(partners[channel.animated])
    return Channel(rest, partners[channel.animated][order], values[:, order])


PASS = Pass(
    "mirror",
    "Swap left and right",
    MirrorOptions,
    Scope.FRAME,
    _mirrored,
    reads=EVERY_PART - {TakePart.CLOCK},
    changes=MOTION_PARTS,
)
