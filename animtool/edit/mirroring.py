"""Mirroring of a take: left and right are swapped, including controls."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from enum import StrEnum
from typing import TypeAlias

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import (
    Fault,
    OptionError,
    listed,
    percent_text,
    refuse,
    warning,
)
from animtool.core.loaded import check_loaded
from animtool.core.record import dataclass
from animtool.edit.tree import joint_index
from animtool.maths import so3
from animtool.motion.keyed import parse_choice
from animtool.motion.motion import Channel, Motion
from animtool.motion.passes import (
    EVERY_PART,
    MOTION_PARTS,
    FrameScope,
    Pass,
    PassContext,
    TakePart,
)
from animtool.motion.take import Take, TakeStream
from animtool.rig.controls import Control, evaluate_controls
from animtool.rig.joints import DRIVEN_PARTS, split_part
from animtool.rig.kinematics import rest_size, rest_world
from animtool.rig.sides import SidePairs, find_likely_pairs, pair_sides
from animtool.rig.skeleton import Rig

# Test change of a control, as a fraction of its range [1].
PROBE_CHANGE = 0.1
# Effects that differ by less are equal [rad], [m].
EFFECT_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class ControlMirror:
    """Maps values of controls to those of their mirror partners."""

    partners: IntArray  # index of each control's partner ``(C,)``
    # 1 for equal signs, -1 for opposite signs ``(C,)``.
    signs: FloatArray
    pivots: FloatArray  # values that remain unchanged when signs flip ``(C,)``

    @staticmethod
    def from_rig(
        rig: Rig,
        partners: IntArray,
        joint_partners: IntArray,
        shape_partners: IntArray,
        axis_signs: FloatArray,
    ) -> ControlMirror:
        """Determine the partner and the sign of each control of a rig.

        A control and its partner have opposite signs if the mirror image of one's
        effect on joints and shapes is nearer to the other's negative effect: for
        example, a control that rotates the head left for positive and right for
        negative values.

        ``partners`` ``(C,)``, ``joint_partners`` ``(J,)``, ``shape_partners`` ``(S,)``,
        ``axis_signs`` ``(3,)``.
        """
        # A mirror reverses axes of rotation.
        effect_signs = np.concatenate([-axis_signs, axis_signs])
        rest_rotations = rest_world(rig).linear[0]
        signs = np.ones(len(partners))
        for i, partner in enumerate(partners.tolist()):
            effects, weights = _control_effect(rig, i, 1.0, rest_rotations)
            mirrored_effects = (effects * effect_signs)[joint_partners]
            flat_effect = _flatten_effect(mirrored_effects, weights[shape_partners])
            if not flat_effect.any():
                continue
            distances = []
            for sign in (1.0, -1.0):
                partner_effect = _control_effect(rig, partner, sign, rest_rotations)
                difference = flat_effect - _flatten_effect(*partner_effect)
                distances.append(np.linalg.norm(difference))
            if distances[1] < distances[0] - EFFECT_TOLERANCE:
                signs[i] = -1.0
        pivots = np.array([_pivot(control) for control in rig.controls])
        return ControlMirror(partners, signs, pivots)

    def __call__(self, values: FloatArray, control_indices: IntArray) -> FloatArray:
        """Return values ``(..., A, 1)`` of controls mapped to their partners."""
        distances = values - self.pivots[control_indices, None]
        flipped_values = self.pivots[self.partners[control_indices], None] - distances
        return np.where(self.signs[control_indices, None] < 0, flipped_values, values)


def _pivot(control: Control) -> float:
    """Return the value that mirroring keeps: 0, or the default if 0 is out of range."""
    if control.low is None or control.high is None:
        return 0.0
    return 0.0 if control.low <= 0 <= control.high else control.default


def _flatten_effect(joint_effects: FloatArray, shape_effects: FloatArray) -> FloatArray:
    """Concatenate effects on joints and shapes to one vector."""
    return np.concatenate([joint_effects.ravel(), shape_effects.ravel()])


def _control_effect(
    rig: Rig, control_index: int, sign: float, rest_rotations: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the effect of a small change of a control, in direction 1 or -1.

    On a joint, the effect is a world-space rotation vector [rad] and a translation [m]
    ``(J, 6)``; on a shape, a weight ``(S,)``. ``rest_rotations``: world rotations of
    the joints at rest ``(J, 3, 3)``.
    """
    control = rig.controls[control_index]
    range_width = 1.0
    if control.low is not None and control.high is not None:
        range_width = control.high - control.low
    base_value = np.array([_pivot(control)])
    changed_value = base_value + sign * PROBE_CHANGE * range_width
    targets_before, targets_after = (
        evaluate_controls(rig.controls, {control.name: value}).targets
        for value in (base_value, changed_value)
    )
    local_effects, weights = np.zeros((len(rig.joints), 6)), np.zeros(len(rig.shapes))
    index_by_shape = {shape.name: i for i, shape in enumerate(rig.shapes)}
    for target in targets_after:
        change = targets_after[target][0] - targets_before[target][0]
        kind, _, name = target.partition("/")
        if kind == "shape":
            weights[index_by_shape[name]] += change
            continue
        name, part = split_part(name, DRIVEN_PARTS)
        j = rig.index(name)
        first_row = 0 if part.startswith(("angle", "rotation")) else 3
        if part in {"angle", "slide"}:
            axis = np.array(rig.joints[j].axis, np.float64)
        else:
            axis = np.eye(3)["xyz".index(part[-1])]
        local_effects[j, first_row : first_row + 3] += axis * change
    halves = np.split(local_effects, 2, 1)
    world_effects = [np.einsum("jab,jb->ja", rest_rotations, half) for half in halves]
    return np.concatenate(world_effects, axis=1), weights


# Largest distance between a joint's rest position and its partner's mirror image, as a
# fraction of the rig's size: measured skeletons of people reach 0.015 [1].
SYMMETRY_TOLERANCE = 0.02

_ValueMap: TypeAlias = Callable[[FloatArray, IntArray], FloatArray]


class Axis(StrEnum):
    """An axis of the world."""

    X = "X"
    Y = "Y"
    Z = "Z"


@dataclass(frozen=True, slots=True)
class MirrorOptions:
    """The mirror plane, and the joints it swaps.

    Attributes:
        axis: Normal of the mirror plane.
        pairs: Names of joints to swap; other pairs are found by the rig's statements,
            then by names.
    """

    axis: Axis = Axis.X
    pairs: tuple[tuple[str, str], ...] = ()


def mirror(
    take: Take, axis: Axis | str = Axis.X, pairs: Sequence[Sequence[str]] = ()
) -> Take:
    """Mirror a take on its rig: left and right are swapped.

    The world motion of a joint beyond its rest frame is mirrored and given to its
    partner. Each joint keeps its rest offset, so that rigs whose halves have different
    frames work, and static joints stay static. A joint without a partner below one with
    a partner keeps its motion: a sword in the right hand. Control values go to their
    partners, with opposite sign if the mirrored effect of a control is the partner's
    negative effect. The plane passes through the rest position of each root. Mirroring
    twice restores the source.

    Limits: if the rest poses of both sides are not mirror images, neither is the
    result, by the same amount. Scales that differ by axis keep their meaning, and are
    restored, only if partners' axes are parallel or perpendicular in the mirror.

    Args:
        take: A take of F frames.
        axis: Normal of the mirror plane, an axis of the world.
        pairs: Pairs of joint names to swap; others are found by the rig's statements,
            then by names.

    Raises:
        OptionError: A pair names an unknown joint (SCN012), the parents of partners are
            not partners (SCN019), or the axis is unknown (SCN025).
    """
    check_loaded(take, Take, "take")
    options = MirrorOptions(parse_choice(Axis, axis, "axis"), _pair_tuples(pairs))
    return _run_mirror(TakeStream.of(take), options).collect()


def _pair_tuples(pairs: Sequence[Sequence[str]]) -> tuple[tuple[str, str], ...]:
    """Return pairs as tuples; raise if an entry is not a pair of names."""
    if any(isinstance(pair, str) or len(pair) != 2 for pair in pairs):
        refuse("SCN019", f"pairs must be pairs of joint names, not {list(pairs)!r:.80}")
    return tuple((a, b) for a, b in pairs)


def _with_rig_pairs(
    rig: Rig, pairs: Sequence[tuple[str, str]]
) -> list[tuple[str, str]]:
    """Return the requested pairs, and those that the rig states for other joints."""
    for name in (name for pair in pairs for name in pair):
        joint_index(rig, name, "pairs")
    stated_pairs = [(j.name, str(getattr(j, "mirror", ""))) for j in rig.joints]
    return [*pairs, *((a, b) for a, b in stated_pairs if b in rig.names)]


def _run_mirror(
    stream: TakeStream, options: MirrorOptions, context: PassContext | None = None
) -> TakeStream:
    """Run the pass: swap left and right."""
    rig = stream.rig
    requested_pairs = _with_rig_pairs(rig, _pair_tuples(options.pairs))
    partner_pairs = pair_sides(rig.names, rig.parents, requested_pairs)
    partners = partner_pairs.partners
    _check_requested_pairs(rig, options.pairs, partners)
    is_kept = _is_unpaired(rig, partners)
    _check_partner_parents(rig, partners, is_kept)
    axis = "XYZ".index(parse_choice(Axis, options.axis, "axis"))
    names_by_kind = {
        kind: [part.name for part in getattr(rig, kind, ())]
        for kind in ("shapes", "controls")
    }
    pairs_by_kind = {kind: pair_sides(names) for kind, names in names_by_kind.items()}
    if context is not None:
        notices = context.notices
        notices.extend(_unpaired_warnings("joints", rig.names, partner_pairs, is_kept))
        for kind, names in names_by_kind.items():
            notices.extend(_unpaired_warnings(kind, names, pairs_by_kind[kind]))
        is_unpaired = is_kept.copy()
        is_unpaired[list(partner_pairs.unpaired_indices)] = True
        notices.extend(_asymmetry_warnings(rig, partners, ~is_unpaired, axis))
    joint_mirror = _JointMirror.from_rig(rig, partners, is_kept, axis)
    shape_partners = pairs_by_kind["shapes"].partners
    control_partners = pairs_by_kind["controls"].partners
    control_mirror = ControlMirror.from_rig(
        rig, control_partners, partners, shape_partners, joint_mirror.axis_signs
    )
    blocks = _mirrored_blocks(stream, joint_mirror, shape_partners, control_mirror)
    return replace(stream, blocks=blocks)


def _is_unpaired(rig: Rig, partners: IntArray) -> BoolArray:
    """Return a mask of unpaired joints below a joint with a partner ``(J,)``."""
    parents = rig.parents
    is_unpaired = partners == np.arange(len(partners))
    return np.asarray(is_unpaired & (parents >= 0) & (partners[parents] != parents))


def _unpaired_warnings(
    part_kind: str,
    part_names: Sequence[str],
    partner_pairs: SidePairs,
    is_kept: BoolArray | None = None,
) -> Iterator[Fault]:
    """Yield a warning about joints of one side without a partner."""
    unpaired_indices = set(partner_pairs.unpaired_indices)
    if is_kept is not None:
        unpaired_indices.update(np.flatnonzero(is_kept).tolist())
    if not unpaired_indices:
        return
    names_text = listed([repr(part_names[i]) for i in sorted(unpaired_indices)])
    message = f"mirror: {part_kind} of one side have no partner: {names_text}"
    likely_pairs = find_likely_pairs(part_names, partner_pairs)
    if part_kind != "joints":
        hint = "each keeps its values; give both sides the same name except for the "
        hint += "side"
    elif likely_pairs:
        written_pairs = ", ".join(f"[{a}, {b}]" for a, b in likely_pairs)
        hint = f"add pairs: [{written_pairs}] to the pass's options to pair them"
    else:
        unpaired_name = part_names[min(unpaired_indices)]
        hint = f"add pairs: [[{unpaired_name}, OTHER]] to the pass's options to pair "
        hint += "two joints; without a pair each keeps its own motion"
    yield warning("SCN082", message, hint)


def _asymmetry_warnings(
    rig: Rig, partners: IntArray, is_checked: BoolArray, axis_index: int
) -> Iterator[Fault]:
    """Yield a warning if the rest pose is not symmetric."""
    if not is_checked.any():
        return
    positions = rest_world(rig).positions[0]
    roots = np.arange(len(positions))
    for i, joint in enumerate(rig.joints):
        roots[i] = roots[joint.parent] if joint.parent >= 0 else i
    offsets = positions - positions[roots]
    rig_size = rest_size(rig)
    mirror_signs = np.where(np.arange(3) == axis_index, -1.0, 1.0)
    mirrored_offsets = offsets[partners] * mirror_signs
    distances = np.linalg.norm(mirrored_offsets - offsets, axis=1) * is_checked
    worst_joint = int(distances.argmax())
    if not distances[worst_joint] > SYMMETRY_TOLERANCE * rig_size:
        return
    asymmetric_count = int(np.count_nonzero(distances > SYMMETRY_TOLERANCE * rig_size))
    message = (
        f"mirror: the rest pose is not symmetric: {rig.names[worst_joint]!r} is "
        f"{distances[worst_joint]:.3g} m from the mirror image of "
        f"{rig.names[int(partners[worst_joint])]!r}, "
        f"{percent_text(distances[worst_joint] / rig_size)} of the rig's size; joints "
        f"that differ by more than {percent_text(SYMMETRY_TOLERANCE)}: "
        f"{asymmetric_count}"
    )
    hint = "each joint moves from its own rest pose, so the result differs by as much"
    yield warning("SCN083", message, hint)


def _check_requested_pairs(
    rig: Rig, pairs: Sequence[Sequence[str]], partners: IntArray
) -> None:
    """Raise if the parents of two joints of a requested pair are not partners."""
    faults = []
    for left, right in pairs:
        i, j = (rig.joints[rig.index(name)].parent for name in (left, right))
        if min(i, j) < 0 and i != j:
            first_name, second_name = (left, right) if i >= 0 else (right, left)
            reason = f"{second_name!r} has no parent, but {first_name!r} has one"
        elif min(i, j) >= 0 and partners[i] != j:
            parents_text = f"{rig.names[i]!r} and {rig.names[j]!r}"
            reason = f"their parents {parents_text} are not a pair"
        else:
            continue
        faults.append(f"pairs: {left!r} and {right!r} cannot be swapped: {reason}")
    if faults:
        hint = "pair their parents too, or name other joints"
        raise OptionError([Fault("SCN019", text, hint=hint) for text in faults])


def _check_partner_parents(rig: Rig, partners: IntArray, is_kept: BoolArray) -> None:
    """Raise if a joint's parent is not the partner of its partner's parent."""
    for i, joint in enumerate(rig.joints):
        if is_kept[i]:
            continue
        partner_parent = int(partners[joint.parent]) if joint.parent >= 0 else -1
        partner_joint = rig.joints[int(partners[i])]
        if partner_joint.parent != partner_parent:
            names_text = f"{joint.name!r} and {partner_joint.name!r}"
            message = f"the parents of {names_text} are not a pair"
            raise OptionError(Fault("SCN019", message, hint="write the pairs"))


@dataclass(frozen=True, slots=True)
class _JointMirror:
    """Maps local values of joints to their mirror partners."""

    partners: IntArray
    is_kept: BoolArray  # mask of the joints that keep their values (J,)
    axis_signs: FloatArray
    rest_world_rotations: FloatArray  # world rotations at rest (J, 4)
    parent_rotations: FloatArray  # world rotations of the parents at rest
    rest_translations: FloatArray

    @staticmethod
    def from_rig(
        rig: Rig, partners: IntArray, is_kept: BoolArray, axis_index: int
    ) -> _JointMirror:
        """Return the mirror of a rig's joints about a plane normal to an axis."""
        rest_world_rotations = rig.rest_rotations.copy()
        parent_rotations = np.tile(so3.IDENTITY, (len(rest_world_rotations), 1))
        for i, joint in enumerate(rig.joints):
            if joint.parent >= 0:
                parent_rotations[i] = rest_world_rotations[joint.parent]
                world_rotation = so3.multiply(
                    parent_rotations[i], rest_world_rotations[i]
                )
                rest_world_rotations[i] = world_rotation
        axis_signs = np.where(np.arange(3) == axis_index, -1.0, 1.0)
        return _JointMirror(
            partners,
            is_kept,
            axis_signs,
            rest_world_rotations,
            parent_rotations,
            rig.rest_translations,
        )

    def mirror_rotations(
        self, values: FloatArray, joint_indices: IntArray
    ) -> FloatArray:
        """Return local rotations ``(..., A, 4)`` mapped to the joints' partners."""
        partners = self.partners[joint_indices]
        inverse_rest = so3.conjugate(self.rest_world_rotations[joint_indices])
        rotations = so3.multiply(self.parent_rotations[joint_indices], values)
        rotations = so3.multiply(rotations, inverse_rest)
        # A mirror reverses axes of rotation.
        rotations = rotations * np.append(-self.axis_signs, 1.0)
        inverse_parent = so3.conjugate(self.parent_rotations[partners])
        rotations = so3.multiply(inverse_parent, rotations)
        rotations = so3.multiply(rotations, self.rest_world_rotations[partners])
        return np.where(self.is_kept[joint_indices, None], values, rotations)

    def mirror_translations(
        self, values: FloatArray, joint_indices: IntArray
    ) -> FloatArray:
        """Return local translations ``(..., A, 3)`` mapped to the joints' partners."""
        partners = self.partners[joint_indices]
        offset = values - self.rest_translations[joint_indices]
        world_offset = so3.rotate(self.parent_rotations[joint_indices], offset)
        inverse_parent = so3.conjugate(self.parent_rotations[partners])
        mirrored_offset = so3.rotate(inverse_parent, world_offset * self.axis_signs)
        mirrored_translations = self.rest_translations[partners] + mirrored_offset
        return np.where(
            self.is_kept[joint_indices, None], values, mirrored_translations
        )

    def mirror_scales(self, values: FloatArray, joint_indices: IntArray) -> FloatArray:
        """Return local scales ``(..., A, 3)`` mapped to the joints' partners."""
        source_axes, partner_axes = (
            so3.to_matrix(self.rest_world_rotations[k])
            for k in (joint_indices, self.partners[joint_indices])
        )
        mirrored_axes = self.axis_signs[:, None] * source_axes
        axis_map = np.swapaxes(partner_axes, -1, -2) @ mirrored_axes
        mirrored_scales = np.asarray((axis_map**2 @ values[..., None])[..., 0])
        return np.where(self.is_kept[joint_indices, None], values, mirrored_scales)


def _mirrored_blocks(
    stream: TakeStream,
    joint_mirror: _JointMirror,
    shape_partners: IntArray,
    control_mirror: ControlMirror,
) -> Iterator[Motion]:
    """Yield the mirrored motion."""
    partners = joint_mirror.partners
    for block in stream.blocks:
        yield Motion(
            _mirror_channel(
                block.translations, partners, joint_mirror.mirror_translations
            ),
            _mirror_channel(block.rotations, partners, joint_mirror.mirror_rotations),
            _swap_partners(block.scales, partners, joint_mirror.mirror_scales),
            _swap_partners(block.weights, shape_partners, lambda values, _: values),
            _swap_partners(block.controls, control_mirror.partners, control_mirror),
            block.track_times,
        )


def _swap_partners(
    channel: Channel | None, partners: IntArray, map_values: _ValueMap
) -> Channel | None:
    """Return a mirrored channel; None or a channel with other rows stays unchanged."""
    if channel is None or len(partners) != len(channel.rest):
        return channel
    return _mirror_channel(channel, partners, map_values)


def _mirror_channel(
    channel: Channel, partners: IntArray, map_values: _ValueMap
) -> Channel:
    """Return a channel in which each row has the mapped values of its partner."""
    all_joints = np.arange(len(channel.rest))
    rest_values = map_values(channel.rest, all_joints)[partners]
    values = map_values(channel.values, channel.animated)
    order = np.argsort(partners[channel.animated])
    return Channel(rest_values, partners[channel.animated][order], values[:, order])


PASS = Pass(
    "mirror",
    "Swap left and right",
    MirrorOptions,
    FrameScope.FRAME,
    _run_mirror,
    reads=EVERY_PART - {TakePart.CLOCK},
    changes=MOTION_PARTS,
)
