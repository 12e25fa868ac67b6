"""Finds the fingers of a hand, and the phalanx of each of their joints."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from animtool.retarget.roles import DIGITS, END, MITTEN_ROLE
from animtool.retarget.structure import SkeletonTree


def finger_roles(body: SkeletonTree, hands: Sequence[int], side: str) -> dict[int, str]:
    """Return the role of each joint below the joints of a hand, by joint index."""
    paths: list[list[int]] = []
    finger_roots = [child for hand in hands for child in body.limb_children(hand)]
    stack = [[child] for child in finger_roots[::-1] if child not in hands]
    while stack:
        path = stack.pop()
        children = body.limb_children(path[-1])
        if not children:
            paths.append(path)
        stack += [[*path, child] for child in children[::-1]]
    if not paths:
        return {}
    digits = _digits_of_paths(body, paths, hands[-1])
    # Shared joints belong to the shorter finger, and to a finger before a thumb.
    order = sorted(
        range(len(paths)), key=lambda i: (len(paths[i]), digits[i] == "thumb", i)
    )
    joints_by_path: dict[int, list[int]] = {}
    assigned_joints: set[int] = set()
    for i in order:
        joints_by_path[i] = [j for j in paths[i] if j not in assigned_joints]
        assigned_joints |= set(paths[i])
    thumb_paths = (joints_by_path[i] for i in order if digits[i] == "thumb")
    thumb_length = next(map(len, thumb_paths), 3)
    role_by_joint: dict[int, str] = {}
    for i in order:
        if digits[i]:
            path = joints_by_path[i]
            role_by_joint |= _phalanx_roles(body, path, digits[i], side, thumb_length)
    return role_by_joint


def _digits_of_paths(
    body: SkeletonTree, paths: Sequence[list[int]], hand: int
) -> list[str]:
    """Return the finger of each joint path, by its names, else by its position."""
    digits = []
    for path in paths:
        names = [role.split("_")[0] for j in path for role in body.votes[j]]
        count_by_digit = Counter(n for n in names if n in {*DIGITS, MITTEN_ROLE})
        digits.append(count_by_digit.most_common(1)[0][0] if count_by_digit else "")
    if any(digits):
        return digits
    return _digits_by_position(body, paths, hand)


def _digits_by_position(
    body: SkeletonTree, paths: Sequence[list[int]], hand: int
) -> list[str]:
    """Return each path's finger by knuckle order; the thumb is nearest the wrist."""
    path_count = len(paths)
    if path_count <= 2 and max(map(len, paths)) < 3:
        # A mitten next to a thumb, which is shorter or begins first.
        thumb_index = min(range(path_count), key=lambda i: (len(paths[i]), -i))
        digits = [MITTEN_ROLE] * path_count
        if path_count > 1:
            digits[thumb_index] = "thumb"
        return digits
    if path_count == 1:
        return ["index"]
    wrist = body.positions[hand]
    # All metacarpals begin near the wrist; the third joint from the end does not.
    knuckles = np.array([body.positions[path[max(len(path) - 3, 0)]] for path in paths])
    fingertips = np.array([body.positions[path[-1]] for path in paths])
    knuckle_offsets = knuckles - wrist
    mean_direction = np.asarray(knuckle_offsets.mean(axis=0))
    mean_direction /= max(float(np.linalg.norm(mean_direction)), 1e-30)
    directions = fingertips - knuckles
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-30)
    mean_finger_direction = directions.sum(axis=0)
    mean_finger_direction /= max(float(np.linalg.norm(mean_finger_direction)), 1e-30)
    largest_extent = max(float(np.abs(knuckle_offsets @ mean_direction).max()), 1e-30)
    finger_scores = knuckle_offsets @ mean_direction / largest_extent
    finger_scores = finger_scores + directions @ mean_finger_direction
    thumb_index = int(np.argmin(finger_scores))
    finger_indices = [i for i in range(path_count) if i != thumb_index]
    knuckle_center = knuckles[finger_indices].mean(axis=0)
    across_palm = knuckles[thumb_index] - knuckle_center
    across_palm -= mean_direction * (across_palm @ mean_direction)
    finger_indices.sort(
        key=lambda i: -float((knuckles[i] - knuckle_center) @ across_palm)
    )
    digits = [""] * path_count
    digits[thumb_index] = "thumb"
    for i, digit in zip(finger_indices, DIGITS[1:], strict=False):
        digits[i] = digit
    return digits


def _phalanx_roles(
    body: SkeletonTree, path: Sequence[int], digit: str, side: str, thumb_length: int
) -> dict[int, str]:
    """Return the role of each joint of a finger, such as ``index_1_l``.

    Numbers in names determine the first phalanx; else the joint count does.
    """
    if digit == MITTEN_ROLE:
        return {j: f"{MITTEN_ROLE}_{side}" for j in path}
    start_numbers = [
        int(role.split("_")[1]) - i
        for i, j in enumerate(path)
        for role in body.votes[j]
        if role.startswith(f"{digit}_")
    ]
    if start_numbers:
        counts = Counter(start_numbers)
        best_start = min(counts, key=lambda start: (-counts[start], start))
    else:
        # A finger with one joint more than the thumb begins with its metacarpal, and so
        # does a finger of four joints whose last joint carries a bone.
        has_last_bone = body.tip_lengths[path[-1]] > 0
        has_metacarpal = len(path) > 3 and (has_last_bone or len(path) > thumb_length)
        best_start = int(not has_metacarpal)
    role_by_joint = {}
    for i, j in enumerate(path):
        phalanx = i + best_start
        if phalanx > 3:
            role_by_joint[j] = END
        elif phalanx >= (digit == "thumb"):
            role_by_joint[j] = f"{digit}_{phalanx}_{side}"
    return role_by_joint
