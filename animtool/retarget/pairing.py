"""Pairing of two skeletons' joints by roles, names or a map file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import field, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TypeAlias

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError, Severity, counted, listed, warning
from animtool.core.record import dataclass
from animtool.documents.document import Location
from animtool.retarget.anatomy import find_anatomy
from animtool.retarget.file import MapFile, ResolvedMap, load_map, resolve_map
from animtool.retarget.map import JointChain, JointMap, JointPair, TwistFraction
from animtool.retarget.map_order import map_order_warnings
from animtool.retarget.names import check_presets
from animtool.retarget.roled_skeleton import RoledSkeleton
from animtool.retarget.roles import (
    ARM_ROLES,
    CONTROL,
    DIGITS,
    END,
    LEG_ROLES,
    MITTEN_ROLE,
    ROLES,
    SIDES,
    TWIST,
    Anatomy,
    MapMode,
    RoleSource,
    base_role,
)
from animtool.retarget.transfer import equal_name_pairs
from animtool.rig.kinematics import rest_world
from animtool.rig.sides import pair_sides
from animtool.rig.skeleton import Rig

# Code, joint of the target, message, hint.
MapFaultFactory: TypeAlias = Callable[[str, int, str, str], Fault]

# Roles that the last bone of a chain leads to, in order of preference.
_NEXT_ROLES = {
    "spine": ("neck", "head"),
    "neck": ("head",),
    "clavicle": ("upper_arm",),
    "upper_arm": ("forearm",),
    "forearm": ("hand",),
    "pelvis": ("thigh",),
    "thigh": ("shin",),
    "shin": ("foot",),
    "foot": ("toe",),
}
# Joints that other joints move, that end bones, or that are no part of the body.
_KINDS_WITHOUT_ROLE = frozenset({TWIST, END, CONTROL})
# Evidence from the name of a joint.
_NAME_EVIDENCE = frozenset({RoleSource.NAME, RoleSource.PRESET, RoleSource.FILE})
# A take with fewer joints has no limb.
MIN_BODY_JOINTS = 4
# Twist joints belong to the bone given by their name or position.
_TWIST_BONES = ("upper_arm", "forearm", "thigh", "shin")


def map_joints(
    source: Rig,
    target: Rig,
    *,
    preset: str | None = None,
    target_preset: str | None = None,
    map_file: Path | str | MapFile | None = None,
    mode: MapMode = "auto",
    source_positions: FloatArray | None = None,
    target_positions: FloatArray | None = None,
) -> JointMap:
    """Pair the joints of two skeletons by roles, names or a map file.

    Args:
        source: Skeleton of a take, of J joints.
        target: The target rig, of K joints.
        preset: Naming convention of the source; None detects it.
        target_preset: Naming convention of the target.
        map_file: A map file or its path; its pairs take precedence.
        mode: Kind of evidence that pairs joints.
        source_positions: Joint positions of the source in a standing pose ``(J, 3)``
            [m], if its rest pose does not stand.
        target_positions: Joint positions of the target ``(K, 3)`` [m].

    Raises:
        FormatError: The map file cannot be read, or names an unknown joint.
        OptionError: Unknown preset (MAP003), or nothing is mapped (MAP004).

    >>> from animtool.rig.skeleton import Joint
    >>> ours = [Joint("LeftArm", -1), Joint("LeftForeArm", 0), Joint("LeftHand", 1)]
    >>> theirs = [Joint("hand_l", -1)]
    >>> found = map_joints(Rig("take", tuple(ours)), Rig("puppet", tuple(theirs)))
    >>> [(pair.source, pair.target, pair.role) for pair in found.pairs]
    [(2, 0, 'hand_l')]
    """
    check_presets(preset=preset, target_preset=target_preset)
    file_map: ResolvedMap | None = None
    joint_order_warnings: tuple[Fault, ...] = ()
    file: MapFile | None = None
    if map_file is not None:
        file = map_file if isinstance(map_file, MapFile) else load_map(map_file)
        file_map = resolve_map(file, source, target)
        joint_order_warnings = tuple(map_order_warnings(file, file_map, source, target))
    uses_names = mode != "structure"
    find_roles = partial(find_anatomy, uses_names=uses_names)
    anatomies = (
        find_roles(source, preset=preset, positions=source_positions),
        find_roles(target, preset=target_preset, positions=target_positions),
    )
    collector = _PairCollector((source, target), anatomies)
    if file_map is not None:
        collector.add_file(file_map)
    if file_map is None or not file_map.is_exclusive:
        if mode == "rename":
            collector.add_same_names()
        for role in ROLES:
            collector.add_role(role, mode)
        if mode != "rename":
            collector.add_mittens()
        if uses_names and mode != "rename" and source is not target:
            collector.add_remaining_names()
    pairs, chains, rigs = collector.pairs, collector.chains, (source, target)
    if file_map is not None and file_map.twists is not None:
        twists = file_map.twists
    else:
        twists = _twist_fractions(target, anatomies[1], collector)
    if not pairs:
        message = f"no joint of {source.name!r} maps to one of {target.name!r}"
        hint = "name a preset for each, or write a map file"
        if len(source.joints) < MIN_BODY_JOINTS:
            message += f": {source.name!r} has {counted(len(source.joints), 'joint')}"
            message += f" ({listed(list(map(repr, source.names)), MIN_BODY_JOINTS)})"
            hint = "choose a file with a skeleton; animtool info lists its joints"
        raise OptionError(Fault("MAP004", message, hint=hint))
    used_joints = {pair.source for pair in pairs.values()}
    used_joints |= {j for chain in chains for j in chain.source}
    warning_at = partial(_located_map_warning, file, file_map)
    driven_joints = {*pairs, *(twist.target for twist in twists)}
    return JointMap(
        tuple(pairs[j] for j in sorted(pairs)),
        tuple(chains),
        twists,
        _unmapped_joints(source, anatomies[0], used_joints),
        _unmapped_joints(target, anatomies[1], driven_joints),
        *anatomies,
        (
            *anatomies[0].notices,
            *anatomies[1].notices,
            *joint_order_warnings,
            *_crossed_side_warnings(rigs, anatomies, pairs.values(), warning_at),
            *(
                _leg_count_warnings(rigs, anatomies)
                or _crossed_limb_warnings(rigs, anatomies, pairs.values(), warning_at)
            ),
            *(
                ()
                if file is None
                else _shifted_limb_warnings(rigs, anatomies, pairs, warning_at)
            ),
        ),
    )


def _crossed_side_warnings(
    rigs: tuple[Rig, Rig],
    anatomies: tuple[Anatomy, Anatomy],
    pairs: Iterable[JointPair],
    warning_at: MapFaultFactory,
) -> list[Fault]:
    """Return a warning if left joints are paired with right joints (MAP108)."""
    crossed_pairs, crossed_sources, other_sources = [], set(), set()
    crossed_targets = []
    for pair in pairs:
        source_roles = anatomies[0].roles[pair.source]
        target_roles = anatomies[1].roles[pair.target]
        if {source_roles[-2:], target_roles[-2:]} == {"_l", "_r"}:
            crossed_targets.append(pair.target)
            joint_names = rigs[0].names[pair.source], rigs[1].names[pair.target]
            crossed_pairs.append(f"{joint_names[0]} to {joint_names[1]}")
            crossed_sources.add(pair.source)
        else:
            other_sources.add(pair.source)
    if not crossed_pairs:
        return []
    side_count = sum(role[-2:] in {"_l", "_r"} for role in anatomies[1].roles)
    message = f"{counted(len(crossed_pairs), 'joint')} of {side_count} on the left and "
    message += f"right follow the other side: {listed(crossed_pairs, 6)}"
    hint = "swap the sides in the map; to mirror a take, use the mirror pass"
    if crossed_sources <= other_sources:
        joint = min(crossed_sources)
        partner = int(pair_sides(rigs[0].names, rigs[0].parents).partners[joint])
        if partner not in {joint, *crossed_sources, *other_sources}:
            joint_names = rigs[0].names[partner], rigs[0].names[joint]
            hint = (
                f"write {joint_names[0]} in place of {joint_names[1]}, which another "
            )
            hint += "joint follows too"
    return [warning_at("MAP108", crossed_targets[0], message, hint)]


def _located_map_warning(
    file: MapFile | None,
    file_map: ResolvedMap | None,
    code: str,
    joint: int,
    message: str,
    hint: str,
) -> Fault:
    """Return a warning at the entry of a map file that drives a joint of the target."""
    if file is None or file_map is None:
        return warning(code, message, hint)
    location: Location = ()
    for i, entry in enumerate(file_map.entries):
        if joint in entry.target:
            location = ("joints", i)
            break
    fault = file.document.fault(code, location, message, hint)
    return replace(fault, severity=Severity.WARNING)


def _crossed_limb_warnings(
    rigs: tuple[Rig, Rig],
    anatomies: tuple[Anatomy, Anatomy],
    pairs: Iterable[JointPair],
    warning_at: MapFaultFactory,
) -> list[Fault]:
    """Return a warning if joints of an arm are paired with those of a leg (MAP114)."""
    limb_of_role = dict.fromkeys(ARM_ROLES, "arm") | dict.fromkeys(LEG_ROLES, "leg")
    crossed_pairs, crossed_targets = [], []
    for pair in pairs:
        limbs = [
            limb_of_role.get(base_role(anatomy.roles[joint]))
            for anatomy, joint in zip(
                anatomies, (pair.source, pair.target), strict=True
            )
        ]
        if {*limbs} == {"arm", "leg"}:
            crossed_targets.append(pair.target)
            joint_names = rigs[0].names[pair.source], rigs[1].names[pair.target]
            crossed_pairs.append(
                f"{joint_names[0]} ({limbs[0]}) to {joint_names[1]} ({limbs[1]})"
            )
    if not crossed_pairs:
        return []
    message = f"{counted(len(crossed_pairs), 'joint')} of {rigs[1].name!r} follow the "
    message += f"other kind of limb: {listed(crossed_pairs, 4)}"
    hint = "pair arms with arms and legs with legs in the map"
    return [warning_at("MAP114", crossed_targets[0], message, hint)]


def _shifted_limb_warnings(
    rigs: tuple[Rig, Rig],
    anatomies: tuple[Anatomy, Anatomy],
    pair_by_target: Mapping[int, JointPair],
    warning_at: MapFaultFactory,
) -> list[Fault]:
    """Return a warning if a limb's joint follows that of another bone (MAP115).

    ``pair_by_target`` has each pair by the index of its target joint.
    """
    joints_by_role = {role: j for j, role in enumerate(anatomies[1].roles) if role}
    shifted_limbs = []
    for pair in pair_by_target.values():
        role = anatomies[0].roles[pair.source]
        target_role = anatomies[1].roles[pair.target]
        bones = (base_role(role), base_role(target_role))
        limbs = ARM_ROLES[1:], LEG_ROLES[1:4]
        is_same_limb = any({*bones} <= {*limb} for limb in limbs)
        if not is_same_limb or bones[0] == bones[1] or role[-2:] != target_role[-2:]:
            continue
        upper_joint = joints_by_role.get(role)
        if upper_joint is None or target_role not in anatomies[0].roles:
            continue
        upper_pair = pair_by_target.get(upper_joint)
        if upper_pair is None or upper_pair.source == pair.source:
            shifted_limbs.append((pair, upper_joint, bones[0].replace("_", " ")))
    if not shifted_limbs:
        return []
    pair, upper_joint, bone = shifted_limbs[0]
    upper_name, target_name = (rigs[1].names[j] for j in (upper_joint, pair.target))
    source_name = rigs[0].names[pair.source]
    message = f"{target_name!r} follows the {bone} {source_name!r}, "
    if upper_joint in pair_by_target:
        message += f"as {upper_name!r} does"
    else:
        message += f"although {upper_name!r} follows nothing"
    other_names = [repr(rigs[1].names[shift[0].target]) for shift in shifted_limbs[1:]]
    if other_names:
        message += f"; the same holds for {listed(other_names, 4)}"
    hint = f"map {source_name} to {upper_name}, and the joints below it likewise"
    return [warning_at("MAP115", pair.target, message, hint)]


def _leg_count_warnings(
    rigs: tuple[Rig, Rig], anatomies: tuple[Anatomy, Anatomy]
) -> list[Fault]:
    """Return a warning if one skeleton is a biped and the other not (MAP109)."""
    stands_on_hands = [
        RoledSkeleton.of(rig, anatomy.roles).stands_on_hands()
        for rig, anatomy in zip(rigs, anatomies, strict=True)
    ]
    if {*stands_on_hands} != {True, False}:
        return []
    legs, other_legs = ("four" if on_hands else "two" for on_hands in stands_on_hands)
    drive_text = "the arms drive the front legs"
    if stands_on_hands[0]:
        drive_text = "the front legs drive the arms"
    message = (
        f"{rigs[0].name!r} has {legs} legs and {rigs[1].name!r} has {other_legs}: "
    )
    message += f"{drive_text}, although their poses differ"
    hint = "choose a rig with the same number of legs, or pair joints in a map file"
    return [warning("MAP109", message, hint)]


def _unmapped_joints(
    rig: Rig, anatomy: Anatomy, used_joints: set[int]
) -> tuple[int, ...]:
    """Return the unmapped joints that do more than mark the end of a bone.

    Those of limbs come first.
    """
    unmapped_joints = [
        j
        for j in range(len(rig.joints))
        if j not in used_joints and anatomy.roles[j] != END
    ]
    limb_roles = {*ARM_ROLES, *LEG_ROLES}
    return tuple(
        sorted(
            unmapped_joints, key=lambda j: base_role(anatomy.roles[j]) not in limb_roles
        )
    )


@dataclass(slots=True)
class _PairCollector:
    """Collects pairs and chains; earlier pairs take precedence."""

    rigs: tuple[Rig, Rig]
    anatomies: tuple[Anatomy, Anatomy]
    pairs: dict[int, JointPair] = field(default_factory=dict)  # by joint of the target
    chains: list[JointChain] = field(default_factory=list)
    # Joints that a file keeps at rest, on both sides.
    ignored_joints: tuple[frozenset[int], frozenset[int]] = (frozenset(), frozenset())

    def add_file(self, file_map: ResolvedMap) -> None:
        """Pair the joints that a map file names."""
        self.ignored_joints = file_map.ignored_joints
        for entry in file_map.entries:
            role = entry.role or self.anatomies[1].roles[entry.target[0]]
            role = role if role in ROLES else ""
            self._pair(role, entry.source, entry.target, RoleSource.FILE)

    def add_same_names(self) -> None:
        """Pair every target joint with the source joint of the same name."""
        source, target = self.rigs
        joint_by_name = {name: j for j, name in enumerate(source.names)}
        for j, name in enumerate(target.names):
            is_used = j in self.pairs or j in self.ignored_joints[1]
            if name in joint_by_name and not is_used:
                self.pairs[j] = JointPair(
                    joint_by_name[name], j, "", RoleSource.NAME, 1.0
                )

    def add_remaining_names(self) -> None:
        """Pair joints of equal names that are unpaired on both skeletons."""
        source, target = self.rigs
        source_joints = np.full(len(target.joints), -1)
        for pair in self.pairs.values():
            source_joints[pair.target] = pair.source
        used_joints = {j for chain in self.chains for j in chain.source}
        used_joints |= self.ignored_joints[0]
        for joint, other in equal_name_pairs(source, target, source_joints):
            roles = self.anatomies[0].roles[other], self.anatomies[1].roles[joint]
            is_free = other not in used_joints and joint not in self.ignored_joints[1]
            if is_free and _KINDS_WITHOUT_ROLE.isdisjoint(roles):
                self.pairs[joint] = JointPair(other, joint, "", RoleSource.NAME, 1.0)

    def add_role(self, role: str, mode: MapMode) -> None:
        """Pair the unpaired target joints of a role with its source joints.

        The mode ``names`` only uses joints whose name tells the role; ``rename`` pairs
        them one to one and uses no source joint twice.
        """
        source_joints, target_joints = (
            [
                j
                for j in anatomy.chain(role)
                if j not in ignored
                and (mode != "names" or anatomy.evidence[j] in _NAME_EVIDENCE)
            ]
            for anatomy, ignored in zip(
                self.anatomies, self.ignored_joints, strict=True
            )
        )
        target_joints = [j for j in target_joints if j not in self.pairs]
        if mode == "rename":
            used_sources = {pair.source for pair in self.pairs.values()}
            source_joints = [j for j in source_joints if j not in used_sources]
            for k, j in zip(source_joints, target_joints, strict=False):
                self._pair(role, [k], [j])
        elif source_joints and target_joints and base_role(role) == "toe":
            self._add_toes(role, source_joints, target_joints)
        elif source_joints and target_joints:
            self._pair(role, source_joints, target_joints)

    def _add_toes(
        self, role: str, source_joints: list[int], target_joints: list[int]
    ) -> None:
        """Pair the toes of a foot in order, from the inner side outwards."""
        source_toes, target_toes = (
            _toes_inside_out(rig, anatomy, role, chain)
            for rig, anatomy, chain in zip(
                self.rigs, self.anatomies, (source_joints, target_joints), strict=True
            )
        )
        last_source, last_target = len(source_toes) - 1, len(target_toes) - 1
        for i, toe in enumerate(target_toes):
            fraction = i / last_target if last_target else 0.5
            self._pair(role, source_toes[int(fraction * last_source + 0.5)], toe)

    def add_mittens(self) -> None:
        """Pair the fingers of one skeleton with the mitten chain of the other."""
        for side in SIDES:
            mittens = [
                anatomy.chain(f"{MITTEN_ROLE}_{side}") for anatomy in self.anatomies
            ]
            finger_joints = [
                [j for digit in DIGITS[1:] for j in anatomy.chain(f"{digit}_1_{side}")]
                for anatomy in self.anatomies
            ]
            source_joints, target_joints = mittens
            if source_joints and not target_joints:
                for j in finger_joints[1]:
                    if j not in self.pairs and j not in self.ignored_joints[1]:
                        self._pair(self.anatomies[1].roles[j], source_joints[:1], [j])
            elif target_joints and finger_joints[0] and not source_joints:
                middle_finger = finger_joints[0][min(1, len(finger_joints[0]) - 1)]
                if target_joints[0] not in self.pairs:
                    role = f"{MITTEN_ROLE}_{side}"
                    self._pair(role, [middle_finger], target_joints[:1])

    def _pair(
        self,
        role: str,
        source_joints: Sequence[int],
        target_joints: Sequence[int],
        evidence: RoleSource | None = None,
    ) -> None:
        """Pair the joints of two chains; record chains of more than one joint."""
        chain_fractions = [
            _chain_fractions(rig, anatomy, chain)
            for rig, anatomy, chain in zip(
                self.rigs, self.anatomies, (source_joints, target_joints), strict=True
            )
        ]
        if len(source_joints) > 1 or len(target_joints) > 1:
            joints = tuple(source_joints), tuple(target_joints)
            chain = JointChain(role, *joints, *map(tuple, chain_fractions))
            self.chains.append(chain)
        for i, j in enumerate(target_joints):
            nearest_index = i
            if len(source_joints) != len(target_joints):
                nearest_index = _nearest_index(
                    chain_fractions[0], chain_fractions[1][i]
                )
            source_joint = source_joints[nearest_index]
            anatomy, joint = min(
                zip(self.anatomies, (source_joint, j), strict=True),
                key=lambda anatomy_joint: anatomy_joint[0].confidence[anatomy_joint[1]],
            )
            evidence_and_confidence = anatomy.evidence[joint], anatomy.confidence[joint]
            if evidence is not None:
                evidence_and_confidence = evidence, 1.0
            self.pairs[j] = JointPair(source_joint, j, role, *evidence_and_confidence)


def _toes_inside_out(
    rig: Rig, anatomy: Anatomy, role: str, joints: list[int]
) -> list[list[int]]:
    """Return the joints of each toe of a foot, the innermost first."""
    toe_roots = [j for j in joints if int(rig.parents[j]) not in joints]
    toes = [
        [j for j in joints if first_joint in rig.upwards(j)]
        for first_joint in toe_roots
    ]
    side_suffix, positions = role[-1:], rest_world(rig).positions[0]
    feet = [
        anatomy.chain(f"foot_{suffix}")
        for suffix in (side_suffix, "lr".replace(side_suffix, ""))
    ]
    if len(toes) < 2 or not all(feet):
        return toes
    inward_direction = positions[feet[1][0]] - positions[feet[0][0]]
    return sorted(toes, key=lambda toe: -float(positions[toe[0]] @ inward_direction))


def _nearest_index(start_fractions: Sequence[float], fraction: float) -> int:
    """Return the index of the joint that begins nearest to a position on its chain."""
    return int(np.argmin(np.abs(np.asarray(start_fractions) - fraction)))


def _chain_fractions(rig: Rig, anatomy: Anatomy, chain: Sequence[int]) -> list[float]:
    """Return the start of each joint of a chain, as fractions of the chain's length."""
    step_lengths = [0.0, *(_path_length(rig, a, b) for a, b in pairwise(chain))]
    chain_length = sum(step_lengths) + _bone_length(rig, anatomy, chain[-1])
    if chain_length <= 0 or max(step_lengths) <= 0:
        return [i / len(chain) for i in range(len(chain))]
    return [float(distance) / chain_length for distance in np.cumsum(step_lengths)]


def _path_length(rig: Rig, upper: int, lower: int) -> float:
    """Return the length of the path from one joint down to another [m]."""
    path = rig.upwards(lower)
    path = path[: path.index(upper)] if upper in path else [lower]
    return float(np.linalg.norm(rig.rest_translations[path], axis=1).sum())


def _bone_length(rig: Rig, anatomy: Anatomy, joint: int) -> float:
    """Return the length of a joint's bone: to the next role, else to its end [m]."""
    role = anatomy.roles[joint]
    side_suffix = role.removeprefix(base_role(role))
    for name in _NEXT_ROLES.get(base_role(role), ()):
        next_joints = [
            j for j in anatomy.chain(name + side_suffix) if joint in rig.upwards(j)[1:]
        ]
        if next_joints:
            return _path_length(rig, joint, next_joints[0])
    end_offsets = [child.translation for child in rig.joints if child.parent == joint]
    end_offsets += rig.joints[joint].tips
    return max(
        (float(np.linalg.norm(end_offset)) for end_offset in end_offsets), default=0.0
    )


def _twist_fractions(
    target: Rig, anatomy: Anatomy, collector: _PairCollector
) -> tuple[TwistFraction, ...]:
    """Return the fraction of a bone's twist that each joint along the bone takes."""
    twist_fractions = []
    for j, role in enumerate(anatomy.roles):
        bone = target.joints[j].parent
        is_used = j in collector.pairs or j in collector.ignored_joints[1]
        if role != TWIST or bone < 0 or is_used:
            continue
        if base_role(anatomy.roles[bone]) not in _TWIST_BONES:
            continue
        length = _bone_length(target, anatomy, bone)
        offset = float(np.linalg.norm(target.joints[j].translation))
        fraction = min(offset / length, 1.0) if length > 0 else 0.5
        twist_fractions.append(TwistFraction(j, bone, fraction))
    return tuple(twist_fractions)
