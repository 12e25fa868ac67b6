"""Pairing of two skeletons' joints by roles, names or a map file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import field
from itertools import pairwise
from pathlib import Path

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError, Severity, counted, listed
from animtool.core.record import dataclass
from animtool.retarget.anatomy import anatomy
from animtool.retarget.file import FileMap, MapFile, load_map, resolved_map
from animtool.retarget.map import JointChain, JointMap, JointPair, TwistFraction
from animtool.retarget.roles import (
    DIGITS,
    END,
    MITTEN,
    ROLES,
    SIDES,
    TWIST,
    Anatomy,
    MapMode,
    RoleSource,
    base_role,
)
from animtool.rig.kinematics import rest_world
from animtool.rig.skeleton import Rig

# Roles that the last bone of a chain leads to, in order of preference.
_NEXT = {
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
# Twist joints belong to the bone that their name or position tells.
_TWISTED = ("upper_arm", "forearm", "thigh", "shin")


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
    """Return which target joints follow which source joints.

    Args:
        source: The skeleton of a take, of J joints.
        target: The rig that it goes onto, of K joints.
        preset: The convention of the source's names; None finds it.
        target_preset: That of the target's names.
        map_file: A map file, or one that was read; its pairs go before all others.
        mode: Which evidence pairs joints.
        source_positions: Of the source's joints in a standing pose
            ``(J, 3)`` [m], if its rest pose does not stand.
        target_positions: Of the target's joints ``(K, 3)`` [m].

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
    stated: FileMap | None = None
    if map_file is not None:
        file = map_file if isinstance(map_file, MapFile) else load_map(map_file)
        stated = resolved_map(file, source, target)
    by_names = mode != "structure"
    anatomies = (
        anatomy(source, preset=preset, positions=source_positions, by_names=by_names),
        anatomy(
            target,
            preset=target_preset,
            positions=target_positions,
            by_names=by_names,
        ),
    )
    pairing = _Pairing((source, target), anatomies)
    if stated is not None:
        pairing.add_file(stated)
    if stated is None or not stated.only:
        if mode == "rename":
            pairing.add_same_names()
        for role in ROLES:
            pairing.add_role(role, mode)
        if mode != "rename":
            pairing.add_mittens()
    pairs, chains = pairing.pairs, pairing.chains
    if stated is not None and stated.twists is not None:
        twists = stated.twists
    else:
        twists = _twists(target, anatomies[1], pairing)
    if not pairs:
        message = f"no joint of {source.name!r} maps to one of {target.name!r}"
        hint = "name a preset for each, or write a map file"
        raise OptionError(Fault("MAP004", message, hint=hint))
    used = {pair.source for pair in pairs.values()}
    used |= {j for chain in chains for j in chain.source}
    driven = {*pairs, *(twist.target for twist in twists)}
    return JointMap(
        tuple(pairs[j] for j in sorted(pairs)),
        tuple(chains),
        twists,
        _left(source, anatomies[0], used),
        _left(target, anatomies[1], driven),
        *anatomies,
        (
            *anatomies[0].notices,
            *anatomies[1].notices,
            *_crossed_sides((source, target), anatomies, pairs.values(), map_file),
        ),
    )


def _crossed_sides(
    rigs: tuple[Rig, Rig],
    anatomies: tuple[Anatomy, Anatomy],
    pairs: Iterable[JointPair],
    map_file: MapFile | Path | str | None,
) -> list[Fault]:
    """Return a warning about pairs of a left and a right joint (MAP108)."""
    crossed = []
    for pair in pairs:
        source_roles, target_roles = (
            anatomies[0].roles[pair.source],
            anatomies[1].roles[pair.target],
        )
        if {source_roles[-2:], target_roles[-2:]} == {"_l", "_r"}:
            names = rigs[0].names[pair.source], rigs[1].names[pair.target]
            crossed.append(f"{names[0]} to {names[1]}")
    if not crossed:
        return []
    sided = sum(role[-2:] in {"_l", "_r"} for role in anatomies[1].roles)
    message = (
        f"{counted(len(crossed), 'joint')} of {sided} on the left and right follow the "
        f"other side: {listed(crossed, 6)}"
    )
    hint = "swap the sides in the map; to mirror a take, use the mirror pass"
    path = map_file.document.path if isinstance(map_file, MapFile) else map_file
    where = None if path is None else str(path)
    return [Fault("MAP108", message, where, (), hint, Severity.WARNING)]


def _left(rig: Rig, known: Anatomy, used: set[int]) -> tuple[int, ...]:
    """Return the unmapped joints that are not mere bone ends."""
    return tuple(
        j for j in range(len(rig.joints)) if j not in used and known.roles[j] != END
    )


@dataclass(slots=True)
class _Pairing:
    """Pairs and chains collected so far; earlier pairs win."""

    rigs: tuple[Rig, Rig]
    anatomies: tuple[Anatomy, Anatomy]
    pairs: dict[int, JointPair] = field(default_factory=dict)  # by joint of the target
    chains: list[JointChain] = field(default_factory=list)
    # Joints that a file keeps at rest, of both sides.
    ignored: tuple[frozenset[int], frozenset[int]] = (frozenset(), frozenset())

    def add_file(self, stated: FileMap) -> None:
        """Pair the joints that a map file names."""
        self.ignored = stated.ignored
        for entry in stated.entries:
            role = entry.role or self.anatomies[1].roles[entry.target[0]]
            role = role if role in ROLES else ""
            self._add(role, entry.source, entry.target, RoleSource.FILE)

    def add_same_names(self) -> None:
        """Pair joints of the same name."""
        source, target = self.rigs
        names = {name: j for j, name in enumerate(source.names)}
        for j, name in enumerate(target.names):
            if name in names and j not in self.pairs and j not in self.ignored[1]:
                self.pairs[j] = JointPair(names[name], j, "", RoleSource.NAME, 1.0)

    def add_role(self, role: str, mode: MapMode) -> None:
        """Pair the remaining joints of one role."""
        source_joints, target_joints = (
            [
                j
                for j in known.chain(role)
                if j not in ignored and (mode != "names" or _by_name(known, j))
            ]
            for known, ignored in zip(self.anatomies, self.ignored, strict=True)
        )
        target_joints = [j for j in target_joints if j not in self.pairs]
        if mode == "rename":
            taken = {pair.source for pair in self.pairs.values()}
            source_joints = [j for j in source_joints if j not in taken]
            for k, j in zip(source_joints, target_joints, strict=False):
                self._add(role, [k], [j])
        elif source_joints and target_joints and base_role(role) == "toe":
            self._add_toes(role, source_joints, target_joints)
        elif source_joints and target_joints:
            self._add(role, source_joints, target_joints)

    def _add_toes(
        self, role: str, source_joints: list[int], target_joints: list[int]
    ) -> None:
        """Pair the toes of a foot in order, from the inner side outwards."""
        rows = [
            _in_order(rig, known, role, chain)
            for rig, known, chain in zip(
                self.rigs, self.anatomies, (source_joints, target_joints), strict=True
            )
        ]
        last = len(rows[0]) - 1
        for i, toe in enumerate(rows[1]):
            at = i / (len(rows[1]) - 1) if len(rows[1]) > 1 else 0.5
            self._add(role, rows[0][int(at * last + 0.5)], toe)

    def add_mittens(self) -> None:
        """Pair fingers with a mitten chain, on either side."""
        for side in SIDES:
            mittens = [known.chain(f"{MITTEN}_{side}") for known in self.anatomies]
            first = [
                [j for digit in DIGITS[1:] for j in known.chain(f"{digit}_1_{side}")]
                for known in self.anatomies
            ]
            source_joints, target_joints = mittens
            if source_joints and not target_joints:
                for j in first[1]:
                    if j not in self.pairs and j not in self.ignored[1]:
                        self._add(self.anatomies[1].roles[j], source_joints[:1], [j])
            elif (
                target_joints
                and not source_joints
                and first[0]
                and target_joints[0] not in self.pairs
            ):
                middle = first[0][min(1, len(first[0]) - 1)]
                self._add(f"{MITTEN}_{side}", [middle], target_joints[:1])

    def _add(
        self,
        role: str,
        ours: Sequence[int],
        theirs: Sequence[int],
        evidence: RoleSource | None = None,
    ) -> None:
        """Pair two chains, and record them if either has several joints."""
        at = [
            _chain_fractions(rig, known, chain)
            for rig, known, chain in zip(
                self.rigs, self.anatomies, (ours, theirs), strict=True
            )
        ]
        if len(ours) > 1 or len(theirs) > 1:
            chain = (tuple(ours), tuple(theirs), tuple(at[0]), tuple(at[1]))
            self.chains.append(JointChain(role, *chain))
        for i, j in enumerate(theirs):
            same = len(ours) == len(theirs)
            k = ours[i] if same else ours[_nearest(at[0], at[1][i])]
            ends = zip(self.anatomies, (k, j), strict=True)
            sure, how = min(
                (
                    (known.confidence[each], known.evidence[each])
                    for known, each in ends
                ),
                key=lambda pair: pair[0],
            )
            if evidence is not None:
                sure, how = 1.0, evidence
            self.pairs[j] = JointPair(k, j, role, how, sure)


def _in_order(
    rig: Rig, known: Anatomy, role: str, joints: list[int]
) -> list[list[int]]:
    """Return the joints of each toe of a foot, the innermost first."""
    tops = [j for j in joints if int(rig.parents[j]) not in joints]
    toes = [[j for j in joints if top in rig.upwards(j)] for top in tops]
    side, positions = role[-1:], rest_world(rig).positions[0]
    feet = [known.chain(f"foot_{each}") for each in (side, "lr".replace(side, ""))]
    if len(toes) < 2 or not all(feet):
        return toes
    inwards = positions[feet[1][0]] - positions[feet[0][0]]
    return sorted(toes, key=lambda toe: -float(positions[toe[0]] @ inwards))


def _by_name(known: Anatomy, joint: int) -> bool:
    return known.evidence[joint] in {
        RoleSource.NAME,
        RoleSource.PRESET,
        RoleSource.FILE,
    }


def _nearest(at: Sequence[float], position: float) -> int:
    """Return the last joint that begins at or before a position along its chain."""
    return int(np.argmin(np.abs(np.asarray(at) - position)))


def _chain_fractions(rig: Rig, known: Anatomy, chain: Sequence[int]) -> list[float]:
    """Return where the joints of a chain begin, as fractions of its length."""
    steps = [0.0, *(_distance(rig, a, b) for a, b in pairwise(chain))]
    total = sum(steps) + _bone(rig, known, chain[-1])
    if total <= 0 or max(steps) <= 0:
        return [i / len(chain) for i in range(len(chain))]
    return [float(at) / total for at in np.cumsum(steps)]


def _distance(rig: Rig, upper: int, lower: int) -> float:
    """Return the length of the path from one joint down to another [m]."""
    path = rig.upwards(lower)
    path = path[: path.index(upper)] if upper in path else [lower]
    return float(np.linalg.norm(rig.rest_translations[path], axis=1).sum())


def _bone(rig: Rig, known: Anatomy, joint: int) -> float:
    """Return the length of a joint's bone: to the next role, else to its end [m]."""
    role = known.roles[joint]
    side = role.removeprefix(base_role(role))
    for name in _NEXT.get(base_role(role), ()):
        below = [j for j in known.chain(name + side) if joint in rig.upwards(j)[1:]]
        if below:
            return _distance(rig, joint, below[0])
    ends = [child.translation for child in rig.joints if child.parent == joint]
    ends += rig.joints[joint].tips
    return max((float(np.linalg.norm(end)) for end in ends), default=0.0)


def _twists(
    target: Rig, known: Anatomy, pairing: _Pairing
) -> tuple[TwistFraction, ...]:
    """Return the twist fractions of joints that lie along a bone."""
    shares = []
    for j, role in enumerate(known.roles):
        bone = target.joints[j].parent
        if role != TWIST or bone < 0 or j in {*pairing.pairs, *pairing.ignored[1]}:
            continue
        if base_role(known.roles[bone]) not in _TWISTED:
            continue
        length = _bone(target, known, bone)
        offset = float(np.linalg.norm(target.joints[j].translation))
        fraction = min(offset / length, 1.0) if length > 0 else 0.5
        shares.append(TwistFraction(j, bone, fraction))
    return tuple(shares)
