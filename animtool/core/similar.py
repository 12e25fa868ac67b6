"""Similar and duplicate names, in linear time."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

# Names that are looked at, and of them those that are compared letter by letter.
MAX_NAMES, MAX_COMPARED = 2000, 40
# Less alike names are other words: position and restitution are at 0.63.
CUTOFF = 0.65
# Nobody misspells a longer one.
LONGEST = 120


def similar(name: str, names: Iterable[str], cutoff: float = CUTOFF) -> str | None:
    """Return the name most similar to another, above a cutoff 0 to 1, or None.

    Of many names the first 2000 are looked at, and of these the 40 that share most
    pairs of letters. One of more than 120 letters is like no other.

    >>> similar("ebow", ["hand", "elbow"]), similar("ebow", ["hip"])
    ('elbow', None)
    """
    if len(name) > LONGEST:
        return None
    near = [known for known in islice(names, MAX_NAMES) if len(known) <= LONGEST]
    if len(near) > MAX_COMPARED:
        pairs = _pairs(name)
        near.sort(key=lambda known: len(pairs & _pairs(known)), reverse=True)
    from difflib import get_close_matches  # every command imports this module

    matches = get_close_matches(name, near[:MAX_COMPARED], 1, cutoff)
    return matches[0] if matches else None


def by_likeness(name: str, names: Iterable[str]) -> list[str]:
    """Return names, sorted by the letter pairs they share with another.

    >>> by_likeness("arms", ["hip", "arm", "forearm"])
    ['arm', 'forearm', 'hip']
    """
    pairs = _pairs(name.lower())

    def unlike(known: str) -> float:
        known_pairs = _pairs(known.lower())
        return -2 * len(pairs & known_pairs) / max(len(pairs) + len(known_pairs), 1)

    return sorted(names, key=unlike)


def distinct(names: Iterable[str]) -> list[str]:
    """Return distinct names: later duplicates get a numeric suffix.

    >>> distinct(["a", "b", "a", "a_2", "a"])
    ['a', 'b', 'a_2', 'a_2_2', 'a_3']
    """
    taken: dict[str, None] = {}
    numbers: dict[str, int] = {}
    for name in names:
        unique = name
        while unique in taken:
            # All lower numbers are taken, and stay so.
            numbers[name] = numbers.get(name, 1) + 1
            unique = f"{name}_{numbers[name]}"
        taken[unique] = None
    return list(taken)


def _pairs(text: str) -> set[str]:
    return {text[i : i + 2] for i in range(len(text) - 1)}
