"""The map from the joints of one skeleton to those of another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from animtool._types import FloatArray
from animtool.errors import Fault, OptionError
from animtool.mocap.retarget.anatomy import anatomy
from animtool.mocap.retarget.roles import (
    END,
    ROLES,
    TWIST,
    Anatomy,
    Found,
    base_role,
)
from animtool.rig.skeleton import Rig

# By names and structure; by names alone; by structure alone; or joints of the same name
# or role one to one, for takes that only want other names.
MapMode = Literal["auto", "names", "structure", "rename"]
# Where the last bone of a chain leads to, the first of them that there is.
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
# Twist joints hang on the bones that their name or place says.
_TWISTED = ("upper_arm", "forearm", "thigh", "shin")


@dataclass(frozen=True, slots=True)
class JointPair:
    """A joint of the source and the joint of the target that it moves."""

    source: int  # index of the joint
    target: int  # index of the joint
    role: str  # of `ROLES`; empty where a file or a name alone pairs them
    found: Found  # the less sure of the two
    confidence: float  # 0 to 1


@dataclass(frozen=True, slots=True)
class JointChain:
    """Joints of a role on both sides, where either has several.

    Where a joint begins is its distance from the first one along the chain, as a share
    of the chain's length with its last bone: 0 for the first.
    """

    role: str
    source: tuple[int, ...]
    target: tuple[int, ...]
    source_at: tuple[float, ...]  # 0 to 1, below 1
    target_at: tuple[float, ...]  # 0 to 1, below 1


@dataclass(frozen=True, slots=True)
class TwistShare:
    """A joint of the target that takes a share of a bone's twist."""

    joint: int  # index in the target
    bone: int  # index in the target of the joint whose bone is twisted
    share: float  # of the twist from the bone's begin (0) to its end (1)


@dataclass(frozen=True, slots=True)
class JointMap:
    """Which joints of a target follow which of a source."""

    pairs: tuple[JointPair, ...]  # in the order of the target's joints
    chains: tuple[JointChain, ...]
    twists: tuple[TwistShare, ...]
    unmapped_source: tuple[int, ...]  # joints that move nothing
    unmapped_target: tuple[int, ...]  # joints that stay at rest
    source: Anatomy
    target: Anatomy
    notices: tuple[Fault, ...] = ()

    def by_role(self, role: str) -> JointPair | None:
        """Return the first pair of a role; None where it is not mapped."""
        return next((pair for pair in self.pairs if pair.role == role), None)


def map_joints(
    source: Rig,
    target: Rig,
    *,
    preset: str | None = None,
    target_preset: str | None = None,
    mode: MapMode = "auto",
    source_positions: FloatArray | None = None,
    target_positions: FloatArray | None = None,
) -> JointMap:
    """Return which joints of a target follow which of a source.

    Args:
        source: The skeleton of a take, of J joints.
        target: The rig that it goes onto, of K joints.
        preset: The convention of the source's names; None finds it.
        target_preset: That of the target's names.
        mode: What joints are told by.
        source_positions: Of the source's joints in a pose of a person who stands
            ``(J, 3)`` [m], where its rest pose is none.
        target_positions: Of the target's joints ``(K, 3)`` [m].

    Raises:
        OptionError: There is no such preset (MAP003), or nothing is mapped (MAP004).
    """
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
    pairs: dict[int, JointPair] = {}
    chains: list[JointChain] = []
    if mode == "rename":
        _pair_same_names(source, target, pairs)
    for role in ROLES:
        _pair_role((source, target), anatomies, role, mode, pairs, chains)
    twists = _twists(target, anatomies[1], pairs)
    if not pairs:
        message = f"no joint of {source.name!r} maps to one of {target.name!r}"
        hint = "name a preset of each, or write a map file"
        raise OptionError(Fault("MAP004", message, hint=hint))
    used = {pair.source for pair in pairs.values()}
    used |= {j for chain in chains for j in chain.source}
    moved = {*pairs, *(twist.joint for twist in twists)}
    return JointMap(
        tuple(pairs[j] for j in sorted(pairs)),
        tuple(chains),
        twists,
        _left(source, anatomies[0], used),
        _left(target, anatomies[1], moved),
        *anatomies,
        (*anatomies[0].notices, *anatomies[1].notices),
    )


def _left(rig: Rig, known: Anatomy, used: set[int]) -> tuple[int, ...]:
    """Return the joints that are not mapped and are no mere ends of bones."""
    return tuple(
        j for j in range(len(rig.joints)) if j not in used and known.roles[j] != END
    )


def _pair_same_names(source: Rig, target: Rig, pairs: dict[int, JointPair]) -> None:
    for j, name in enumerate(target.names):
        if name in source.names:
            pairs[j] = JointPair(source.index(name), j, "", Found.NAME, 1.0)


def _pair_role(
    rigs: tuple[Rig, Rig],
    anatomies: tuple[Anatomy, Anatomy],
    role: str,
    mode: MapMode,
    pairs: dict[int, JointPair],
    chains: list[JointChain],
) -> None:
    """Pair the joints of one role, and note the chain where there are several."""
    taken = {pair.source for pair in pairs.values()}
    ours, theirs = (
        [j for j in known.chain(role) if mode != "names" or _by_name(known, j)]
        for known in anatomies
    )
    theirs = [j for j in theirs if j not in pairs]
    if mode == "rename":
        ours = [j for j in ours if j not in taken]
    if not ours or not theirs:
        return
    several = len(ours) > 1 or len(theirs) > 1
    at = [
        _places(rig, known, chain)
        for rig, known, chain in zip(rigs, anatomies, (ours, theirs), strict=True)
    ]
    if several and mode != "rename":
        chains.append(
            JointChain(role, tuple(ours), tuple(theirs), tuple(at[0]), tuple(at[1]))
        )
    for i, j in enumerate(theirs):
        if mode == "rename" and i >= len(ours):
            break
        shared = len(ours) == len(theirs) or mode == "rename"
        k = ours[i] if shared else ours[_nearest(at[0], at[1][i])]
        sure = [(anatomies[0], k), (anatomies[1], j)]
        known, index = min(sure, key=lambda each: each[0].confidence[each[1]])
        pairs[j] = JointPair(k, j, role, known.found[index], known.confidence[index])


def _by_name(known: Anatomy, joint: int) -> bool:
    return known.found[joint] in {Found.NAME, Found.PRESET, Found.FILE}


def _nearest(at: Sequence[float], place: float) -> int:
    """Return the last joint that begins at a place or above, or next to it."""
    return int(np.argmin(np.abs(np.asarray(at) - place)))


def _places(rig: Rig, known: Anatomy, chain: Sequence[int]) -> list[float]:
    """Return where the joints of a chain begin, as shares of its length."""
    steps = [0.0, *(_distance(rig, a, b) for a, b in pairwise(chain))]
    total = sum(steps) + _bone(rig, known, chain[-1])
    if total <= 0 or max(steps) <= 0:
        return [i / len(chain) for i in range(len(chain))]
    return [float(at) / total for at in np.cumsum(steps)]


def _distance(rig: Rig, upper: int, lower: int) -> float:
    """Return the length of the way down from one joint to another [m]."""
    way = rig.upwards(lower)
    way = way[: way.index(upper)] if upper in way else [lower]
    return float(np.linalg.norm(rig.rest_translations[way], axis=1).sum())


def _bone(rig: Rig, known: Anatomy, joint: int) -> float:
    """Return the length of a joint's bone: to the next role, or else its end [m]."""
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
    target: Rig, known: Anatomy, pairs: Mapping[int, JointPair]
) -> tuple[TwistShare, ...]:
    """Return the shares of twist of joints that lie along a bone."""
    shares = []
    for j, role in enumerate(known.roles):
        bone = target.joints[j].parent
        if role != TWIST or j in pairs or bone < 0:
            continue
        if base_role(known.roles[bone]) not in _TWISTED:
            continue
        length = _bone(target, known, bone)
        own = float(np.linalg.norm(target.joints[j].translation))
        share = min(own / length, 1.0) if length > 0 else 0.5
        shares.append(TwistShare(j, bone, share))
    return tuple(shares)
