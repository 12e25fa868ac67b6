"""Mirroring of a take: left and right exchanged, controls too."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from enum import StrEnum
from typing import TypeAlias

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, OptionError, Severity, listed, percent
from animtool.core.record import dataclass
from animtool.edit.tree import joint_index
from animtool.maths import so3
from animtool.motion.keyed import parse_choice
from animtool.motion.motion import Channel, Motion
from animtool.motion.passes import (
    EVERY_PART,
    MOTION_PARTS,
    Pass,
    PassContext,
    Scope,
    TakePart,
)
from animtool.motion.take import Take, TakeStream
from animtool.rig.controls import Control, evaluate_controls
from animtool.rig.joints import DRIVEN_PARTS, split_part
from animtool.rig.kinematics import rest_size, rest_world
from animtool.rig.sides import SidePairs, pair_sides, unpaired_sides
from animtool.rig.skeleton import Rig

# Test change of a control, as a fraction of its range [1].
NUDGE = 0.1
# Effects that differ by less are equal [rad], [m].
SAME_EFFECT = 1e-9


@dataclass(frozen=True, slots=True)
class ControlMirror:
    """How values of each control map to its partner."""

    partners: IntArray  # index of each one's partner ``(C,)``
    # 1 for equal signs, -1 for opposite signs ``(C,)``.
    signs: FloatArray
    pivots: FloatArray  # the values that stay where signs change ``(C,)``

    @staticmethod
    def of(
        rig: Rig,
        partners: IntArray,
        joints: IntArray,
        shapes: IntArray,
        normal: FloatArray,
    ) -> ControlMirror:
        """Return how a rig's controls are mirrored.

        A control and its partner have opposite signs if the mirror image of one's
        effect on joints and shapes is nearer to the other's negative effect: a control
        that turns the head left above 0 and right below it.

        ``partners`` ``(C,)``, ``joints`` ``(J,)``, ``shapes`` ``(S,)``, ``normal``
        ``(3,)``.
        """
        # A mirror reverses axes of rotation.
        across = np.concatenate([-normal, normal])
        rest_rotations = rest_world(rig).linear[0]

        def effect(c: int, sign: float) -> FloatArray:
            return _flat(_effect(rig, c, sign, rest_rotations))

        signs = np.ones(len(partners))
        for i, partner in enumerate(partners.tolist()):
            displaced, weights = _effect(rig, i, 1.0, rest_rotations)
            flat_effect = _flat(((displaced * across)[joints], weights[shapes]))
            if not flat_effect.any():
                continue
            on, back = (
                np.linalg.norm(flat_effect - effect(partner, sign))
                for sign in (1.0, -1.0)
            )
            if back < on - SAME_EFFECT:
                signs[i] = -1.0
        pivots = np.array([_pivot(control) for control in rig.controls])
        return ControlMirror(partners, signs, pivots)

    def __call__(self, values: FloatArray, c: IntArray) -> FloatArray:
        """Return values ``(..., A, 1)`` of controls mapped to their partners."""
        turned = self.pivots[self.partners[c], None] - (values - self.pivots[c, None])
        return np.where(self.signs[c, None] < 0, turned, values)


def _pivot(control: Control) -> float:
    """Return 0, or the default of a control whose range excludes 0."""
    if control.low is None or control.high is None:
        return 0.0
    return 0.0 if control.low <= 0 <= control.high else control.default


def _flat(effect: tuple[FloatArray, FloatArray]) -> FloatArray:
    return np.concatenate([part.ravel() for part in effect])


def _effect(
    rig: Rig, c: int, sign: float, turned: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the effect of a small change of a control, in direction 1 or -1.

    On each joint in the world ``(J, 6)``, a rotation vector [rad] and a translation
    [m]; and on each shape ``(S,)``. ``turned`` are joints at rest, world ``(J, 3, 3)``.
    """
    control = rig.controls[c]
    span = 1.0
    if control.low is not None and control.high is not None:
        span = control.high - control.low
    start = np.array([_pivot(control)])
    displaced = start + sign * NUDGE * span
    before = evaluate_controls(rig.controls, {control.name: start}).targets
    after = evaluate_controls(rig.controls, {control.name: displaced}).targets
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


# How far the rest position of a joint may be from its partner's mirror image, as a
# share of the rig's size: measured skeletons of people differ by up to 0.015 [1].
SYMMETRIC = 0.02

_ValueMap: TypeAlias = Callable[[FloatArray, IntArray], FloatArray]


class Axis(StrEnum):
    """An axis of the world."""

    X = "X"
    Y = "Y"
    Z = "Z"


@dataclass(frozen=True, slots=True)
class MirrorOptions:
    """The mirror plane, and the joints it exchanges.

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
    framed differently works, and what is static stays so. A joint without partner
    below one that has a partner keeps its own motion: a sword in the right hand. Values
    of controls go to their partners, and change their sign where the mirror image of
    what a control does is what its partner does the other way. The
    plane goes through the rest position of each root. Twice is the source again.

    Limits: where the rest poses of both sides are no mirror images, the result is not
    either, by as much. Scales that differ by axis keep their meaning, and come back,
    only where partners' axes are parallel or at right angles in the mirror.

    Args:
        take: F frames.
        axis: Normal of the mirror's plane, an axis of the world.
        pairs: Pairs of names of joints that change places; others are found by what
            the rig states, then by names.

    Raises:
        OptionError: A pair names no joint (SCN012), or partners do not hang from
            partners (SCN019), or there is no such axis (SCN025).
    """
    options = MirrorOptions(parse_choice(Axis, axis, "axis"), _tuples(pairs))
    return _mirrored(TakeStream.of(take), options).collect()


def _tuples(pairs: Sequence[Sequence[str]]) -> tuple[tuple[str, str], ...]:
    if any(isinstance(pair, str) or len(pair) != 2 for pair in pairs):
        message = f"pairs must be pairs of joint names, not {list(pairs)!r:.80}"
        raise OptionError(Fault("SCN019", message))
    return tuple((a, b) for a, b in pairs)


def _stated(rig: Rig, pairs: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    for name in (name for pair in pairs for name in pair):
        joint_index(rig, name, "pairs")
    stated = [(j.name, str(getattr(j, "mirror", ""))) for j in rig.joints]
    return [*pairs, *((a, b) for a, b in stated if b in rig.names)]


def _mirrored(
    stream: TakeStream, options: MirrorOptions, context: PassContext | None = None
) -> TakeStream:
    rig = stream.rig
    pairs = pair_sides(rig.names, rig.parents, _stated(rig, _tuples(options.pairs)))
    partners = pairs.partners
    _check_stated(rig, options.pairs, partners)
    kept = _kept(rig, partners)
    _check_tree(rig, partners, kept)
    axis = "XYZ".index(parse_choice(Axis, options.axis, "axis"))
    names_by_kind = {
        kind: [part.name for part in getattr(rig, kind, ())]
        for kind in ("shapes", "controls")
    }
    swaps = {kind: pair_sides(names) for kind, names in names_by_kind.items()}
    if context is not None:
        context.notices.extend(_strays("joints", rig.names, pairs, kept))
        for kind, names in names_by_kind.items():
            context.notices.extend(_strays(kind, names, swaps[kind]))
        alone = kept.copy()
        alone[list(pairs.strays)] = True
        context.notices.extend(_asymmetries(rig, partners, ~alone, axis))
    glass = _JointMirror.of(rig, partners, kept, axis)
    shapes = swaps["shapes"].partners
    controls = ControlMirror.of(
        rig, swaps["controls"].partners, partners, shapes, glass.normal
    )
    return replace(stream, blocks=_blocks(stream, glass, shapes, controls))


def _kept(rig: Rig, partners: IntArray) -> BoolArray:
    """Return which joints have no partner but a parent that has one ``(J,)``."""
    parents = rig.parents
    alone = partners == np.arange(len(partners))
    return np.asarray(alone & (parents >= 0) & (partners[parents] != parents))


def _strays(
    kind: str, names: Sequence[str], pairs: SidePairs, kept: BoolArray | None = None
) -> Iterator[Fault]:
    """Yield a warning about joints of one side without a partner."""
    alone = {*pairs.strays, *([] if kept is None else np.flatnonzero(kept).tolist())}
    if not alone:
        return
    shown = listed([repr(names[i]) for i in sorted(alone)])
    message = f"mirror: {kind} of one side have no partner: {shown}"
    meant = unpaired_sides(names, pairs)
    if kind != "joints":
        hint = (
            "each keeps its values; give both sides the same name except for the side"
        )
    elif meant:
        written = ", ".join(f"[{a}, {b}]" for a, b in meant)
        hint = f"add pairs: [{written}] to the pass's options to pair them"
    else:
        stray = names[min(alone)]
        hint = (
            f"add pairs: [[{stray}, OTHER]] to the pass's options to pair two joints; "
        )
        hint += "without a pair each keeps its own motion"
    yield Fault("SCN082", message, hint=hint, severity=Severity.WARNING)


def _asymmetries(
    rig: Rig, partners: IntArray, looked_at: BoolArray, axis: int
) -> Iterator[Fault]:
    """Yield a warning where the rest pose is not its own mirror image."""
    if not looked_at.any():
        return
    positions = rest_world(rig).positions[0]
    roots = np.arange(len(positions))
    for i, joint in enumerate(rig.joints):
        roots[i] = roots[joint.parent] if joint.parent >= 0 else i
    offsets = positions - positions[roots]
    size = rest_size(rig)
    across = np.where(np.arange(3) == axis, -1.0, 1.0)
    away = np.linalg.norm(offsets[partners] * across - offsets, axis=1) * looked_at
    worst = int(away.argmax())
    if not away[worst] > SYMMETRIC * size:
        return
    count = int(np.count_nonzero(away > SYMMETRIC * size))
    message = (
        f"mirror: the rest pose is not symmetric: {rig.names[worst]!r} is "
        f"{away[worst]:.3g} m from the mirror image of "
        f"{rig.names[int(partners[worst])]!r}, {percent(away[worst] / size)} of the "
        f"rig's size; joints that differ by more than {percent(SYMMETRIC)}: {count}"
    )
    hint = "each joint moves from its own rest pose, so the result differs by as much"
    yield Fault("SCN083", message, hint=hint, severity=Severity.WARNING)


def _check_stated(rig: Rig, pairs: Sequence[Sequence[str]], partners: IntArray) -> None:
    """Refuse stated pairs whose parents are not partners."""
    faults = []
    for a, b in pairs:
        above = [rig.joints[rig.index(name)].parent for name in (a, b)]
        if min(above) < 0 and above[0] != above[1]:
            low, top = (a, b) if above[0] >= 0 else (b, a)
            faults.append(f"{top!r} has no parent, but {low!r} has one")
        elif min(above) >= 0 and partners[above[0]] != above[1]:
            one, two = (repr(rig.names[parent]) for parent in above)
            faults.append(f"their parents {one} and {two} are not a pair")
        else:
            continue
        faults[-1] = f"pairs: {a!r} and {b!r} cannot be swapped: {faults[-1]}"
    if faults:
        hint = "pair their parents too, or name other joints"
        raise OptionError([Fault("SCN019", text, hint=hint) for text in faults])


def _check_tree(rig: Rig, partners: IntArray, kept: BoolArray) -> None:
    for i, joint in enumerate(rig.joints):
        if kept[i]:
            continue
        above = int(partners[joint.parent]) if joint.parent >= 0 else -1
        other = rig.joints[int(partners[i])]
        if other.parent != above:
            message = f"the parents of {joint.name!r} and {other.name!r} are not a pair"
            raise OptionError(Fault("SCN019", message, hint="write the pairs"))


@dataclass(frozen=True, slots=True)
class _JointMirror:
    """How values of each joint map to its partner."""

    partners: IntArray
    kept: BoolArray  # those that keep their values (J,)
    normal: FloatArray
    world: FloatArray  # rest rotations in the world (J, 4)
    above: FloatArray  # of the parents
    rest: FloatArray

    @staticmethod
    def of(rig: Rig, partners: IntArray, kept: BoolArray, axis: int) -> _JointMirror:
        world = rig.rest_rotations.copy()
        above = np.tile(so3.IDENTITY, (len(world), 1))
        for i, joint in enumerate(rig.joints):
            if joint.parent >= 0:
                above[i] = world[joint.parent]
                world[i] = so3.multiply(above[i], world[i])
        normal = np.where(np.arange(3) == axis, -1.0, 1.0)
        return _JointMirror(partners, kept, normal, world, above, rig.rest_translations)

    def rotations(self, values: FloatArray, j: IntArray) -> FloatArray:
        p = self.partners[j]
        turned = so3.multiply(self.above[j], values)
        turned = so3.multiply(turned, so3.conjugate(self.world[j]))
        # A mirror reverses axes of rotation.
        turned = turned * np.append(-self.normal, 1.0)
        turned = so3.multiply(so3.conjugate(self.above[p]), turned)
        turned = so3.multiply(turned, self.world[p])
        return np.where(self.kept[j, None], values, turned)

    def translations(self, values: FloatArray, j: IntArray) -> FloatArray:
        p = self.partners[j]
        away = so3.rotate(self.above[j], values - self.rest[j]) * self.normal
        reflected = self.rest[p] + so3.rotate(so3.conjugate(self.above[p]), away)
        return np.where(self.kept[j, None], values, reflected)

    def scales(self, values: FloatArray, j: IntArray) -> FloatArray:
        ours, theirs = (so3.to_matrix(self.world[k]) for k in (j, self.partners[j]))
        change = np.swapaxes(theirs, -1, -2) @ (self.normal[:, None] * ours)
        scaled = np.asarray((change**2 @ values[..., None])[..., 0])
        return np.where(self.kept[j, None], values, scaled)


def _blocks(
    stream: TakeStream, glass: _JointMirror, shapes: IntArray, controls: ControlMirror
) -> Iterator[Motion]:
    for block in stream.blocks:
        yield Motion(
            _mirrored_channel(block.translations, glass.partners, glass.translations),
            _mirrored_channel(block.rotations, glass.partners, glass.rotations),
            None
            if block.scales is None
            else _mirrored_channel(block.scales, glass.partners, glass.scales),
            _swapped(block.weights, shapes, lambda values, _: values),
            _swapped(block.controls, controls.partners, controls),
            block.track_times,
        )


def _swapped(
    channel: Channel | None, partners: IntArray, look: _ValueMap
) -> Channel | None:
    if channel is None or len(partners) != len(channel.rest):
        return channel
    return _mirrored_channel(channel, partners, look)


def _mirrored_channel(channel: Channel, partners: IntArray, look: _ValueMap) -> Channel:
    all_joints = np.arange(len(channel.rest))
    rest = look(channel.rest, all_joints)[partners]
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
