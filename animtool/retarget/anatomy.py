"""Finds the role of each joint of a skeleton, from names and geometry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from itertools import compress

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, counted, listed, warning
from animtool.core.record import dataclass
from animtool.retarget.fingers import finger_roles
from animtool.retarget.names import (
    ParsedName,
    Preset,
    best_preset,
    find_preset,
    matched_name_count,
    parse_names,
    role_votes,
)
from animtool.retarget.roles import (
    ARM_ROLES,
    CONTROL,
    END,
    LEG_ROLES,
    ROLES,
    SIDES,
    TWIST,
    Anatomy,
    RoleSource,
    base_role,
)
from animtool.retarget.structure import (
    LimbShape,
    SkeletonTree,
    find_left_direction,
    find_limb_pairs,
    find_up_direction,
    split_limb,
)
from animtool.rig.skeleton import Rig

_LIMB_ROLES = {"arm": ARM_ROLES, "leg": LEG_ROLES}
_SHAPE_BY_LIMB = {
    f"{name}_{side}": LimbShape(
        (*(f"{role}_{side}" for role in roles), *[""] * (5 - len(roles))), *lengths
    )
    for side in SIDES
    for name, roles, lengths in (
        ("arm", ARM_ROLES, (1.1, 0.5, 0.5, True)),
        ("leg", LEG_ROLES, (1.02, 0.25, 0.45, False)),
    )
}
# Confidence in a role by its evidence.
_CONFIDENCE_BY_EVIDENCE = {
    RoleSource.PRESET: 1.0,
    RoleSource.NAME: 0.9,
    RoleSource.STRUCTURE: 0.7,
    RoleSource.NONE: 0.0,
}
MAX_LISTED_JOINTS = 4
# A part of the foot that extends less far forward than this fraction of the longest toe
# is a heel, not a toe.
_MIN_TOE_FRACTION = 0.4
# Minimum number of joints of a second body.
MIN_BODY_JOINTS = 8


@dataclass(slots=True)
class _RoleSearch:
    """State of the search that assigns a role to each joint of a skeleton."""

    body: SkeletonTree
    roles: list[str]
    # Lowest known joint, by limb.
    tip_by_limb: dict[str, int] = field(default_factory=dict)
    # Kinds of limbs whose joints have no names that tell the side.
    unsided_limbs: list[str] = field(default_factory=list)
    has_guessed_sides: bool = False  # whether sides come from the order of the file

    def set_role(self, joint: int, role: str) -> None:
        """Assign a role to a joint that has none yet."""
        if joint >= 0 and not self.roles[joint]:
            self.roles[joint] = role


def find_anatomy(
    rig: Rig,
    *,
    preset: str | None = None,
    positions: FloatArray | None = None,
    uses_names: bool = True,
) -> Anatomy:
    """Return the role of each joint of a skeleton.

    Args:
        rig: J joints.
        preset: Naming convention of the joints; None detects it.
        positions: Joint positions in a standing pose ``(J, 3)`` [m], world;
            None is the rest pose. Only sides and fingers depend on it, and only if
            names do not tell.
        uses_names: Whether names are used.
    """
    source_names = [joint.source_name or joint.name for joint in rig.joints]
    if preset is None:
        # Roles stated by the file precede guesses from names.
        named_joints = zip(rig.joints, source_names, strict=True)
        source_names = [joint.humanoid or name for joint, name in named_joints]
    parsed_names = parse_names(source_names, rig.parents)
    chosen_preset: Preset | None = None
    preset_warnings: list[Fault] = []
    if preset is not None:
        chosen_preset = find_preset(preset)
        preset_warnings = _preset_warning(
            chosen_preset, rig, source_names, parsed_names
        )
    elif uses_names:
        chosen_preset = best_preset(source_names, parsed_names)
    votes: list[dict[str, float]] = [{} for _ in source_names]
    if uses_names:
        votes = role_votes(parsed_names, chosen_preset)
    joint_kinds = [name.kind if uses_names else "" for name in parsed_names]
    body = SkeletonTree.of(rig, votes, joint_kinds)
    search = _RoleSearch(body, [""] * len(source_names))
    notices = [*preset_warnings, *_ignore_smaller_trees(search)]
    _find_limbs(search)
    up = find_up_direction(body, search.tip_by_limb)
    if up is None and positions is not None:
        search.body = replace(body, positions=positions)
        up = find_up_direction(search.body, search.tip_by_limb)
    is_rest_pose = search.body is body
    tips = search.tip_by_limb
    left_axis = find_left_direction(search.body, tips, up, is_rest_pose=is_rest_pose)
    _assign_sides_by_position(search, left_axis)
    _assign_trunk(search)
    for limb in tips:
        _assign_limb(search, limb)
    _assign_other_roles(search)
    notices += _anatomy_warnings(search)
    evidence = [_role_source(role, votes[j]) for j, role in enumerate(search.roles)]
    confidence = tuple(_CONFIDENCE_BY_EVIDENCE[source] for source in evidence)
    preset_name = chosen_preset.name if chosen_preset else ""
    return Anatomy(
        tuple(search.roles), tuple(evidence), confidence, preset_name, tuple(notices)
    )


# A preset with fewer than this fraction of the names of another one is a wrong choice.
MIN_MATCH_FRACTION = 0.5


def _preset_warning(
    preset: Preset, rig: Rig, names: Sequence[str], parsed_names: Sequence[ParsedName]
) -> list[Fault]:
    """Return a warning if another convention has many more of the names (MAP113)."""
    best = best_preset(names, parsed_names)
    count = matched_name_count(preset, parsed_names)
    best_count = 0 if best is None else matched_name_count(best, parsed_names)
    if best is None or count >= MIN_MATCH_FRACTION * best_count:
        return []
    message = f"preset {preset.name!r} has {count or 'none'} of the names of the "
    message += f"{counted(len(names), 'joint')} of {rig.name!r}, and {best.name!r} "
    message += f"{best_count}"
    hint = f"write {best.name} in place of {preset.name}, or leave the preset out"
    return [warning("MAP113", message, hint)]


def joints_of_part(rig: Rig, part_name: str) -> tuple[str, list[str]]:
    """Return the part of the body that a name means, and the rig's joints of that part.

    Both are empty for a name without a known meaning, or if the rig has no such part.
    A name without a side means both sides.
    """
    role, roles = _role_of_name(part_name), []
    if role:
        # Many rigs call their hips the pelvis.
        roles = [role, "hips"] if base_role(role) == "pelvis" else [role]
    elif role := _role_of_name(f"{part_name}_l"):
        roles = [f"{base_role(role)}_{side}" for side in SIDES]
        role = base_role(role)
    if not role:
        return "", []
    anatomy = find_anatomy(rig)
    joints = [rig.names[j] for each in roles for j in anatomy.chain(each)]
    side_texts = {"_l": "left ", "_r": "right "}
    return side_texts.get(role[-2:], "") + base_role(role).replace("_", " "), joints


def _role_of_name(name: str) -> str:
    """Return the role that a name means, by the words of many conventions; else ""."""
    if name in ROLES:
        return name
    (votes,) = role_votes(parse_names([name], np.array([-1])), None)
    return max(votes, key=lambda role: votes[role], default="")


def _role_source(role: str, votes: Mapping[str, float]) -> RoleSource:
    """Return the evidence for a joint's role: its name, or its position in the tree."""
    if not role or role in {TWIST, END, CONTROL}:
        return RoleSource.NONE
    weight = votes.get(role, 0.0)
    if weight == 0.0:
        return RoleSource.STRUCTURE
    return RoleSource.PRESET if weight == 1.0 else RoleSource.NAME


def _ignore_smaller_trees(search: _RoleSearch) -> list[Fault]:
    """Ignore all joint trees but the largest; warn if another looks like a body."""
    body = search.body
    roots = body.rig.roots
    if len(roots) == 1:
        # Bodies below one root: their hips are not below each other.
        hips = [j for j, votes in enumerate(body.votes) if "hips" in votes]
        roots = [
            j
            for j in hips
            if set(hips).isdisjoint(body.rig.upwards(j)[1:])
            and body.subtree_sizes[j] >= MIN_BODY_JOINTS
        ]
    if len(roots) < 2:
        return []
    main_hips = max(roots, key=lambda j: body.subtree_sizes[j])
    other_roots = [
        j for j in roots if j != main_hips and body.subtree_sizes[j] >= MIN_BODY_JOINTS
    ]
    for j in range(len(search.roles)):
        ancestors = body.rig.upwards(j)
        if main_hips not in ancestors and not set(ancestors).isdisjoint(roots):
            search.roles[j] = CONTROL
    if not other_roots:
        return []
    joint_names = body.rig.names
    other_names = listed([repr(joint_names[j]) for j in other_roots], MAX_LISTED_JOINTS)
    message = f"{len(other_roots) + 1} skeletons in one file: that of "
    message += f"{joint_names[main_hips]!r} is mapped, {other_names} are skipped"
    hint = "export the others to separate files"
    return [warning("MAP103", message, hint)]


def _find_limbs(search: _RoleSearch) -> None:
    """Find the end joint of each limb, by names or by the tree."""
    body = search.body
    for limb, roles in _LIMB_ROLES.items():
        for side in SIDES:
            tip = _find_named_tip(search, {f"{role}_{side}" for role in roles})
            if tip >= 0:
                search.tip_by_limb[f"{limb}_{side}"] = tip
    for limb, joint_pair in zip(("leg", "arm"), find_limb_pairs(body), strict=True):
        assigned_joints = {
            j for tip in search.tip_by_limb.values() for j in body.rig.upwards(tip)
        }
        assigned_joints |= {j for j, role in enumerate(search.roles) if role}
        has_name = any(f"{limb}_{side}" in search.tip_by_limb for side in SIDES)
        if joint_pair and not has_name and assigned_joints.isdisjoint(joint_pair):
            search.unsided_limbs.append(limb)
            for side, limb_root in zip(SIDES, joint_pair, strict=True):
                search.tip_by_limb[f"{limb}_{side}"] = body.longest_path(limb_root)[-1]


def _find_named_tip(search: _RoleSearch, limb_roles: set[str]) -> int:
    """Return the joint with the most limb roles named along its path, or -1."""
    body = search.body
    best_joint, best_score = -1, 0.0
    for j, votes in enumerate(body.votes):
        if search.roles[j] or limb_roles.isdisjoint(votes):
            continue
        named_roles_above = [
            limb_roles & body.votes[k].keys() for k in body.rig.upwards(j)
        ]
        named_joint_count = sum(map(bool, named_roles_above))
        score = len(set().union(*named_roles_above)) + 0.01 * named_joint_count
        if score > best_score:
            best_joint, best_score = j, score
    return best_joint


def _assign_sides_by_position(search: _RoleSearch, left_direction: FloatArray) -> None:
    """Assign left and right by limb positions, or by file order if these coincide.

    ``left_direction``: the body's left ``(3,)``.
    """
    body, tip_by_limb = search.body, search.tip_by_limb
    for limb in search.unsided_limbs:
        tip_names = [f"{limb}_{side}" for side in SIDES]
        tips = [tip_by_limb[name] for name in tip_names]
        common_joint = body.lowest_common_ancestor(tips)
        chains = [body.path(common_joint, tip)[1:] for tip in tips]
        # Hands and feet may cross; where limbs begin they do not.
        for slice_end in (2, None):
            left_middle, right_middle = (
                body.positions[chain[:slice_end]].mean(axis=0) for chain in chains
            )
            signed_distance = float((left_middle - right_middle) @ left_direction)
            if abs(signed_distance) > 0.01 * body.size:
                break
        if abs(signed_distance) <= 1e-3 * max(body.size, 1e-30):
            search.has_guessed_sides = True
        elif signed_distance < 0:
            tip_by_limb |= {tip_names[0]: tips[1], tip_names[1]: tips[0]}


def _assign_trunk(search: _RoleSearch) -> None:
    """Assign roles to hips, spine, neck, head, and the joints above the hips."""
    body, tip_by_limb = search.body, search.tip_by_limb
    legs = [tip_by_limb[f"leg_{s}"] for s in SIDES if f"leg_{s}" in tip_by_limb]
    arms = [tip_by_limb[f"arm_{s}"] for s in SIDES if f"arm_{s}" in tip_by_limb]
    head = _find_by_name(search, "head")
    chest = body.lowest_common_ancestor(arms) if len(arms) == 2 else -1
    if head < 0 and chest >= 0:
        head = _find_head(search, chest)
    upper_joints = [j for j in (chest, head) if j >= 0]
    fork = -1
    if legs and upper_joints:
        fork = body.lowest_common_ancestor([*legs, *upper_joints])
    leg_fork = body.lowest_common_ancestor(legs) if len(legs) == 2 else fork
    hips = _find_hips(search, fork, leg_fork)
    search.set_role(hips, "hips")
    spine_start = max(fork, hips) if fork < 0 else fork
    if spine_start < 0 and upper_joints:
        spine_start = body.rig.upwards(upper_joints[-1])[-1]
    for j in body.rig.upwards(hips)[1:] if hips >= 0 else ():
        if fork <= j < hips or j < spine_start:
            search.set_role(j, "root")
    for j in body.path(spine_start, leg_fork) if leg_fork > spine_start else ():
        search.set_role(j, "pelvis")
    if upper_joints:
        if spine_start not in body.rig.upwards(upper_joints[-1]):
            spine_start = max(hips, 0)
        _assign_spine(search, spine_start, chest, head)


def _assign_spine(search: _RoleSearch, first_joint: int, chest: int, head: int) -> None:
    """Assign roles to the joints from the leg-trunk fork up to chest and head."""
    body = search.body
    if chest not in body.rig.upwards(head):
        for j in body.path(first_joint, chest):
            search.set_role(j, "spine")
    search.set_role(head, "head")
    last_joint = head if head >= 0 else chest
    path = body.path(first_joint, last_joint)
    neck_indices = [i for i, j in enumerate(path) if "neck" in body.votes[j]]
    after_chest = path.index(chest) + 1 if chest in path else len(path)
    after_chest = neck_indices[0] if neck_indices else after_chest
    for i, j in enumerate(path):
        search.set_role(j, "spine" if i < after_chest else "neck")


def _find_by_name(search: _RoleSearch, role: str) -> int:
    """Return the topmost of the joints whose names suggest a role most, or -1."""
    weights = [
        0.0 if search.roles[j] else votes.get(role, 0.0)
        for j, votes in enumerate(search.body.votes)
    ]
    best_index = int(np.argmax(weights)) if weights else -1
    return best_index if best_index >= 0 and weights[best_index] > 0 else -1


def _find_hips(search: _RoleSearch, fork: int, leg_fork: int) -> int:
    """Return the named hips if near the leg-trunk fork, else the fork."""
    body = search.body
    named_hips = _find_by_name(search, "hips")
    if fork < 0:
        return named_hips if named_hips >= 0 else leg_fork
    joints_near_fork = {*body.rig.upwards(fork), *body.path(fork, max(leg_fork, fork))}
    candidates = [j for j in joints_near_fork if "hips" in body.votes[j]]
    weight = max((body.votes[j]["hips"] for j in candidates), default=0.0)
    top_candidates = [j for j in candidates if body.votes[j]["hips"] == weight]
    return max(top_candidates, key=lambda j: (j == fork, j), default=fork)


def _find_head(search: _RoleSearch, chest: int) -> int:
    """Return the first fork of the longest chain above the chest, or its end."""
    body = search.body
    arms = {j for s in SIDES for j in body.rig.upwards(search.tip_by_limb[f"arm_{s}"])}
    branches = [j for j in body.limb_children(chest) if j not in arms]
    if not branches:
        return -1
    branch_sizes = [
        body.lengths[j] + body.reach[j] + 1e-3 * body.subtree_sizes[j] for j in branches
    ]
    path = body.longest_path(branches[int(np.argmax(branch_sizes))])
    forks = [j for j in path if len(body.limb_children(j)) > 1]
    return forks[0] if forks else path[-1]


def _assign_limb(search: _RoleSearch, limb: str) -> None:
    """Assign roles to the joints of an arm or leg and to its fingers."""
    body, limb_kind, side = search.body, *limb.split("_")
    tip = search.tip_by_limb[limb]
    other_tips = [j for name, j in search.tip_by_limb.items() if name != limb]
    used_joints = {j for other in other_tips for j in body.rig.upwards(other)}
    used_joints |= {j for j, role in enumerate(search.roles) if role}
    path = [j for j in body.rig.upwards(tip) if j not in used_joints]
    path = [*path[::-1], *body.longest_path(tip)[1:]]
    if not path:
        return
    branch = -1
    if limb_kind == "arm":
        path, branch = _split_hand(search, path, side)
    else:
        path = _split_toes(search, path)
    joint_roles = split_limb(body, path, _SHAPE_BY_LIMB[limb], branch)
    for j, role_of_joint in zip(path, joint_roles, strict=True):
        search.set_role(j, "" if body.joint_kinds[j] == CONTROL else role_of_joint)
    hand_joints = list(compress(path, (r == f"hand_{side}" for r in joint_roles)))
    if limb_kind == "arm" and hand_joints:
        for j, role in finger_roles(body, hand_joints, side).items():
            search.set_role(j, "" if body.joint_kinds[j] == CONTROL else role)
    if limb_kind == "leg":
        _assign_toes(search, side)


def _split_hand(
    search: _RoleSearch, path: list[int], side: str
) -> tuple[list[int], int]:
    """Return an arm's joints down to the hand, and the joint where the fingers fork."""
    votes = search.body.votes
    hand_indices = [i for i, j in enumerate(path) if f"hand_{side}" in votes[j]]
    if hand_indices:
        return path[: hand_indices[-1] + 1], path[hand_indices[-1]]
    branch, branch_count = search.body.widest_branching(path)
    if branch_count < 2:
        return path, -1
    return path[: path.index(branch) + 1], branch


def _split_toes(search: _RoleSearch, path: list[int]) -> list[int]:
    """Return a leg's chain without the toes if the foot has several."""
    body = search.body
    likely_roles = [
        max(body.votes[j], key=body.votes[j].__getitem__, default="") for j in path
    ]
    toe_indices = [i for i, role in enumerate(likely_roles) if base_role(role) == "toe"]
    last_named_index = max((i for i, j in enumerate(path) if body.votes[j]), default=2)
    forks = [i for i, j in enumerate(path) if len(body.limb_children(j)) > 1]
    candidates = [*toe_indices, *(i for i in forks if i >= max(last_named_index, 2))]
    return path[: candidates[0] + 1] if candidates else path


def _assign_toes(search: _RoleSearch, side: str) -> None:
    """Assign the toe role to every toe chain of a foot that has several."""
    body, role = search.body, f"toe_{side}"
    feet = [j for j, name in enumerate(search.roles) if name == f"foot_{side}"]
    if not feet:
        return
    toe_roots = [
        j
        for j in body.limb_children(feet[-1])
        if search.roles[j] in {"", role} and not body.joint_kinds[j]
    ]
    if len(toe_roots) < 2:
        return
    last_joints = [body.longest_path(j)[-1] for j in toe_roots]
    toe_ends = body.positions[last_joints] + body.last_bones[last_joints]
    directions = toe_ends - body.positions[feet[-1]]
    lengths = np.linalg.norm(directions, axis=1)
    longest_index = int(np.argmax(lengths))
    longest_toe, length = directions[longest_index], float(lengths[longest_index])
    forward_lengths = directions @ longest_toe / max(length, 1e-30)
    is_toe = forward_lengths > _MIN_TOE_FRACTION * forward_lengths.max()
    toes = list(compress(toe_roots, is_toe))
    for toe in toes if len(toes) > 1 else ():
        for j in range(toe, len(search.roles)):
            is_plain_joint = not body.joint_kinds[j] and not body.is_tip(j)
            if is_plain_joint and toe in body.rig.upwards(j):
                search.set_role(j, role)


def _assign_other_roles(search: _RoleSearch) -> None:
    """Assign face roles; mark other joints as twist, end or control joints."""
    body = search.body
    for j, votes in enumerate(body.votes):
        for role in votes:
            if base_role(role) in {"jaw", "eye"} and role not in search.roles:
                search.set_role(j, role)
    for j, kind in enumerate(body.joint_kinds):
        is_leaf = not body.children[j]
        if not search.roles[j] and (kind or (is_leaf and body.is_tip(j))):
            search.roles[j] = kind or END


MISSING_LEG_TEXTS = ("whole left leg", "whole right leg")


def _missing_legs_text(roles: Sequence[str]) -> str:
    """Return the missing legs of a skeleton as text; empty if both are complete."""
    complete_sides = [
        {f"{role}_{side}" for role in ("thigh", "shin", "foot")} <= {*roles}
        for side in "lr"
    ]
    if any(complete_sides):
        return "" if all(complete_sides) else MISSING_LEG_TEXTS[complete_sides[0]]
    return "whole legs" if {"thigh_l", "thigh_r"} & {*roles} else "legs"


def _anatomy_warnings(search: _RoleSearch) -> list[Fault]:
    """Return warnings about missing or ambiguous parts, with the fallback used."""
    body, rig, roles = search.body, search.body.rig, search.roles
    hands = [j for j, role in enumerate(roles) if base_role(role) == "hand"]
    fingerless_hands = [
        repr(rig.names[j]) for j in hands if body.size > 0 and body.reach[j] <= 0
    ]
    warnings = []
    # Without any limb it is no body: a lamp, a snake.
    missing_legs = _missing_legs_text(roles) if search.tip_by_limb else ""
    if missing_legs:
        hint = "root motion is scaled like the rest of the body, and no feet are held"
        if missing_legs in MISSING_LEG_TEXTS:
            hint = "only the other foot is held"
        warnings.append(("MAP101", f"{rig.name!r} has no {missing_legs}", hint))
    if len(rig.joints) > 1 and body.size <= 0:
        message = f"all offsets of {rig.name!r} are zero: it has no rest pose"
        warnings.append(("MAP102", message, "joints are mapped by name only"))
    if fingerless_hands:
        hands_text = listed(fingerless_hands, MAX_LISTED_JOINTS)
        message = f"the rest pose of {rig.name!r} does not show where {hands_text} end"
        hint = "the hand is assumed to continue the forearm"
        warnings.append(("MAP104", message, hint))
    if search.has_guessed_sides:
        message = f"left and right cannot be told apart in {rig.name!r}"
        hint = "the first limb of the file is assumed to be the left one; check the map"
        warnings.append(("MAP105", message, hint))
    return [warning(code, message, hint) for code, message, hint in warnings]
