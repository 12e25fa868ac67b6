"""The fingers of a hand: which is which, and which joint of it each joint is."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from animtool.retarget.roles import DIGITS, END, MITTEN
from animtool.retarget.structure import Body


def finger_roles(body: Body, hands: Sequence[int], side: str) -> dict[int, str]:
    """Return the roles of the joints below the joints of a hand."""
    ways = _ways(body, hands)
    if not ways:
        return {}
    digits = _digits(body, ways, hands[-1])
    # What two fingers share is of the shorter one, and of a finger before a thumb.
    order = sorted(
        range(len(ways)), key=lambda i: (len(ways[i]), digits[i] == "thumb", i)
    )
    owned: dict[int, list[int]] = {}
    taken: set[int] = set()
    for i in order:
        owned[i] = [j for j in ways[i] if j not in taken]
        taken |= set(ways[i])
    thumb = next((len(owned[i]) for i in order if digits[i] == "thumb"), 3)
    roles: dict[int, str] = {}
    for i in order:
        if digits[i]:
            roles |= _phalanges(body, owned[i], digits[i], side, thumb)
    return roles


def _ways(body: Body, hands: Sequence[int]) -> list[list[int]]:
    """Return the way to the last joint of each finger, without the hand."""
    ways: list[list[int]] = []
    below = [child for hand in hands for child in body.limb_children(hand)]
    stack = [[child] for child in below[::-1] if child not in hands]
    while stack:
        way = stack.pop()
        below = body.limb_children(way[-1])
        if not below:
            ways.append(way)
        stack += [[*way, child] for child in below[::-1]]
    return ways


def _digits(body: Body, ways: Sequence[list[int]], hand: int) -> list[str]:
    """Return the digit of each way, by names where they say it, else by place."""
    digits = []
    for way in ways:
        named = Counter(
            role.split("_")[0]
            for j in way
            for role in body.votes[j]
            if role.split("_")[0] in {*DIGITS, MITTEN}
        )
        digits.append(named.most_common(1)[0][0] if named else "")
    if any(digits):
        return digits
    return _digits_by_place(body, ways, hand)


def _digits_by_place(body: Body, ways: Sequence[list[int]], hand: int) -> list[str]:
    """Return digits in the order of the knuckles, the thumb's nearest the wrist."""
    count = len(ways)
    if count <= 2 and max(map(len, ways)) < 3:
        # All fingers in one, next to a thumb that is shorter or begins first.
        thumb = min(range(count), key=lambda i: (len(ways[i]), -i))
        return ["thumb" if i == thumb and count > 1 else MITTEN for i in range(count)]
    if count == 1:
        return ["index"]
    wrist = body.positions[hand]
    # Metacarpals all begin near the wrist: the third joint from the end does not.
    knuckles = np.array([body.positions[way[max(len(way) - 3, 0)]] for way in ways])
    ends = np.array([body.positions[way[-1]] for way in ways])
    offsets = knuckles - wrist
    along = np.asarray(offsets.mean(axis=0))
    along /= max(float(np.linalg.norm(along)), 1e-30)
    ways_out = ends - knuckles
    ways_out /= np.maximum(np.linalg.norm(ways_out, axis=1, keepdims=True), 1e-30)
    mean_out = ways_out.sum(axis=0)
    mean_out /= max(float(np.linalg.norm(mean_out)), 1e-30)
    size = max(float(np.abs(offsets @ along).max()), 1e-30)
    likeness = (offsets @ along) / size + ways_out @ mean_out
    thumb = int(np.argmin(likeness))
    rest = [i for i in range(count) if i != thumb]
    center = knuckles[rest].mean(axis=0)
    across = knuckles[thumb] - center
    across -= along * (across @ along)
    rest.sort(key=lambda i: -float((knuckles[i] - center) @ across))
    digits = [""] * count
    digits[thumb] = "thumb"
    for i, digit in zip(rest, DIGITS[1:], strict=False):
        digits[i] = digit
    return digits


def _phalanges(
    body: Body, way: Sequence[int], digit: str, side: str, thumb: int
) -> dict[int, str]:
    """Return the role of each joint of a finger."""
    if digit == MITTEN:
        return {j: f"{MITTEN}_{side}" for j in way}
    anchors = [
        int(role.split("_")[1]) - i
        for i, j in enumerate(way)
        for role in body.votes[j]
        if role.startswith(f"{digit}_")
    ]
    if anchors:
        counts = Counter(anchors)
        first = min(counts, key=lambda start: (-counts[start], start))
    else:
        # A finger with a joint more than the thumb begins with its metacarpal, and so
        # does one of four joints of which the last carries a bone.
        extra = len(way) > 3 and (body.tips[way[-1]] > 0 or len(way) > thumb)
        first = int(not extra)
    roles = {}
    for i, j in enumerate(way):
        number = i + first
        if number > 3:
            roles[j] = END
        elif number >= (digit == "thumb"):
            roles[j] = f"{digit}_{number}_{side}"
    return roles
