"""Whether enough of a take is paired for its motion to be that of the rig."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, counted, listed
from animtool.core.quantities import length_text
from animtool.retarget.map import JointMap
from animtool.retarget.roles import (
    CONTROL,
    END,
    FINGERS,
    MITTEN,
    TWIST,
    base_role,
)
from animtool.rig.skeleton import Rig

# Bones that a whole limb has.
LIMBS = {"arm": ("upper_arm", "forearm", "hand"), "leg": ("thigh", "shin", "foot")}
# Least share of the joints that move in a take that are paired [1].
PAIRED = 1 / 3
# Joints that say nothing of how a body moves: some takes have hundreds of them.
_DETAIL = {*FINGERS, MITTEN, "toe", "jaw", "eye", TWIST, END, CONTROL}
_ENDS = {"head", "hand", "foot"}
MAX_NAMED = 6
# Share of its length at rest that a bone keeps at most that has none [1].
NO_LENGTH = 1e-4


def lacking_pairs(
    source: Rig, found: JointMap, follows: IntArray, moving: Collection[int]
) -> Fault | None:
    """Return why a take does not fit a rig (MAP010); None where it does.

    Args:
        source: The skeleton of the take, of J joints.
        found: Which joints follow which.
        follows: Which joint of the source each of the target follows ``(K,)``.
        moving: Joints of the source that move; where none does, all count.
    """
    roles = found.source.roles
    used = {pair.source for pair in found.pairs} | {*follows.tolist()}
    used |= {j for chain in found.chains for j in chain.source}
    limbs = _limbs(roles)
    whole = [name for name, joints in limbs.items() if used.issuperset(joints)]
    body = _body(source, roles)
    counts = [j for j in body if j in moving] or body
    paired = [j for j in counts if j in used]
    if len(paired) >= PAIRED * len(counts) and (whole or not limbs):
        return None
    message = (
        f"{len(paired)} of {counted(len(counts), 'moving joint')} of {source.name!r} "
        f"are paired"
    )
    if limbs and not whole:
        message += f", and none of its limbs ({listed(sorted(limbs), MAX_NAMED)})"
    hint = "write a map file, or bring what is paired all the same with --force-fit, "
    hint += "in a pass force_fit: true"
    return Fault("MAP010", message, hint=hint)


def collapsed(source: Rig, found: JointMap, longest: FloatArray) -> Fault | None:
    """Return which limbs of a take have bones without length (MAP011); None for none.

    Args:
        source: The skeleton of the take, of J joints.
        found: Which joints follow which.
        longest: How far its joints get from their parents, at most ``(J,)`` [m].
    """
    roles = found.source.roles
    lengths = np.linalg.norm(source.rest_translations, axis=1)
    lost = (longest <= NO_LENGTH * lengths) & (lengths > 0) & (source.parents >= 0)
    bones = sorted(
        {
            j
            for joints in _limbs(roles).values()
            for bottom, top in ((joints[-1], joints[0]),)
            for j in source.upwards(bottom)
            if lost[j] and j != top and top in source.upwards(j)
        }
    )
    if not bones:
        return None
    names = listed([repr(source.names[j]) for j in bones], MAX_NAMED)
    message = (
        f"{counted(len(bones), 'limb bone')} of {source.name!r} have no length in any "
        f"frame, and up to {length_text(float(lengths[bones].max()))} at rest: {names} "
        "are at their parents"
    )
    hint = "of a BVH, --positions offsets lets OFFSETs hold; --force-fit, in a pass "
    hint += "force_fit: true, takes it as it is"
    return Fault("MAP011", message, hint=hint)


def nothing_paired(source: Rig, roles: tuple[str, ...], target: Rig) -> Fault | None:
    """Return that nothing of a body is paired (MAP010); None for what is no body."""
    limbs = _limbs(roles)
    if not limbs:
        return None
    message = f"no joint of {source.name!r} maps to one of {target.name!r}, and none "
    message += f"of its limbs ({listed(sorted(limbs), MAX_NAMED)})"
    return Fault("MAP010", message, hint="choose another rig, or write a map file")


def _limbs(roles: tuple[str, ...]) -> dict[str, list[int]]:
    """Return the joints of the limbs that a skeleton has whole, by name."""
    found = {}
    for name, bones in LIMBS.items():
        for side, text in (("l", "left"), ("r", "right")):
            own = [f"{bone}_{side}" for bone in bones]
            if {*own} <= {*roles}:
                found[f"{text} {name}"] = [roles.index(role) for role in own]
    return found


def _body(rig: Rig, roles: tuple[str, ...]) -> list[int]:
    """Return the joints of a skeleton without fingers, toes, face and twists."""
    made = []
    for j, role in enumerate(roles):
        ends = {base_role(roles[k]) for k in rig.upwards(j)[1:]} & _ENDS
        if base_role(role) not in _DETAIL and not (ends and not role):
            made.append(j)
    return made
