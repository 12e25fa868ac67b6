"""Where the points of a C3D file are: the combination of claims that fills the file."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from animtool.formats.c3d.claims import WORD, Claim, Claims
from animtool.formats.c3d.sections import BLOCK

# Costs, beside those of the claims that are contradicted: bytes behind the last frame
# that are padding but not zero, bytes that are none, a count that nothing states, and
# one that only the size of the file gives.
DIRTY, REST, OTHER, SOLVED = 0.75, 2.5, 0.5, 1.5
# What decides for one combination against another.
DECISIVE = 0.2
# Combinations whose numbers are looked at.
MAX_JUDGED = 16
# Claims of less weight are hints.
TOLD = 0.5


@dataclass(frozen=True, slots=True)
class Layout:
    """A combination of counts.

    Attributes:
        begin: Byte of the first frame.
        width: Bytes of a number.
        points: Points of a frame.
        analog: Numbers behind the points of a frame.
        frames: Frames.
        rest: Bytes behind the last frame, but for zeros up to a full block.
        cost: What is contradicted, summed.
        proof: It is read only where its numbers look like positions.
    """

    begin: int
    width: int
    points: int
    analog: int
    frames: int
    rest: int = 0
    cost: float = 0.0
    proof: bool = False

    @property
    def row(self) -> int:
        """Numbers of a frame."""
        return 4 * self.points + self.analog

    @property
    def end(self) -> int:
        """Byte behind the last frame."""
        return self.begin + self.width * self.row * self.frames

    def __str__(self) -> str:
        """Return the counts in words."""
        kind = "floats" if self.width == 4 else "integers"
        return (
            f"{self.frames} frames of {self.points} points and {self.analog} analogue "
            f"numbers, {kind} from byte {self.begin} on"
        )


@dataclass(frozen=True, slots=True)
class Evidence:
    """How much the numbers of a layout look like positions over frames.

    Attributes:
        odd: Fraction of points that can be no positions.
        rough: Mean step from frame to frame over the spread of all positions.
    """

    odd: float
    rough: float


@dataclass(frozen=True, slots=True)
class Outcome:
    """The layout, or why there is none.

    Attributes:
        layout: The combination that is read; None where there is none.
        short: The one that contradicts least and needs more bytes than there are.
        rivals: Combinations between which nothing decides.
    """

    layout: Layout | None
    short: Layout | None = None
    rivals: tuple[Layout, ...] = ()


def choose_layout(
    claims: Claims,
    data: bytes,
    ends: Sequence[int],
    judge: Callable[[Layout], Evidence],
) -> Outcome:
    """Return the combination of claims that fills the file and contradicts least.

    Args:
        claims: What the file states.
        data: The file.
        ends: Bytes at which the points may end; the last is the size of the file.
        judge: Looks at the numbers of a combination.
    """
    held: dict[tuple[int, ...], Layout] = {}
    short: Layout | None = None
    for layout in _combinations(claims, ends[-1]):
        if layout.end > ends[-1] or layout.begin > ends[-1]:
            if not layout.proof and (short is None or layout.cost < short.cost):
                short = layout
            continue
        found = min((_filled(layout, data, end) for end in ends), key=_order)
        key = (found.begin, found.width, found.points, found.analog, found.frames)
        if key not in held or found.cost < held[key].cost:
            held[key] = found
    ranked = sorted(held.values(), key=_order)[:MAX_JUDGED]
    if short is not None and short.cost < TOLD:
        # What the file says with one voice, and has no room for, is cut short, unless
        # something else that it says fills it.
        ranked = [each for each in ranked if each.rest == 0 and not each.proof]
    if not ranked:
        return Outcome(None, short)
    if ranked[0].cost < TOLD:
        return Outcome(ranked[0])
    outcome = _decide(ranked, short, judge)
    best = outcome.layout
    if best is None:
        return outcome
    if best.rest and short is not None and short.cost < best.cost - REST:
        return Outcome(None, short)
    return Outcome(_trimmed(claims, best, data))


def _trimmed(claims: Claims, layout: Layout, data: bytes) -> Layout:
    """Return a layout without frames that are padding, where only the size has them."""
    size = layout.width * layout.row
    stated = {claim.value for claim in claims.frames}
    padded = layout.end % BLOCK == 0 and layout.end == len(data)
    frames = layout.frames
    while padded and frames > 1 and frames not in stated:
        begin = layout.begin + size * (frames - 1)
        if len(data) - begin >= BLOCK or data.count(b"\0", begin, begin + size) < size:
            break
        frames -= 1
    return replace(layout, frames=frames)


def contradicted(claims: Claims, layout: Layout) -> list[tuple[str, int, list[Claim]]]:
    """Return what is read against what is stated: quantity, value and the claims."""
    found = []
    for name in ("frames", "points", "analog", "width", "begin"):
        value = getattr(layout, name)
        against = [
            claim
            for claim in getattr(claims, name)
            if claim.weight >= TOLD and claim.value != value
        ]
        stated = [claim for claim in getattr(claims, name) if claim.value == value]
        # Counts that end at 16 bits contradict nothing where another states the rest.
        against = [c for c in against if c.cost(value) >= TOLD or not stated]
        if against:
            found.append((name, value, against))
    return found


def _order(layout: Layout) -> tuple[float, ...]:
    return (
        layout.cost, layout.begin, layout.width, layout.points, layout.analog,
        layout.frames,
    )  # fmt: skip


def _combinations(claims: Claims, size: int) -> Iterable[Layout]:
    """Yield combinations of what is stated, and of what the size gives for one."""
    widths = _priced(claims.width, (2, 4))
    for (begin, at), (width, of) in itertools.product(_priced(claims.begin), widths):
        room, flipped = (size - begin) // width, of >= TOLD and _agreed(claims.width)
        points = _priced(claims.points)
        analog = _priced(claims.analog, claims.others)
        frames = _priced(claims.frames)

        def layout(
            p: int, a: int, f: int, cost: float, proof: bool, at: int = begin,
            width: int = width, base: float = at + of, flipped: bool = flipped,
        ) -> Layout:  # fmt: skip
            return Layout(at, width, p, a, f, 0, base + cost, proof or flipped)

        for (p, by_p), (a, by_a) in itertools.product(points, analog):
            for f, by_f in [*frames, *_held(claims, room, 4 * p + a)]:
                yield layout(p, a, f, by_p + by_a + by_f, proof=False)
        for f, by_f in frames:
            numbers = room // f
            for p, by_p in points if _open(claims.analog) else ():
                a = numbers - 4 * p
                if a >= 0:
                    cost = by_p + by_f + _cost(claims.analog, a) + SOLVED
                    yield layout(p, a, f, cost, proof=True)
            for a, by_a in analog if _open(claims.points) else ():
                p, more = divmod(numbers - a, 4)
                if p > 0 and more == 0:
                    cost = by_a + by_f + _cost(claims.points, p) + SOLVED
                    yield layout(p, a, f, cost, proof=True)


def _priced(
    claims: Sequence[Claim], others: Sequence[int] = ()
) -> list[tuple[int, float]]:
    """Return values that are tried, each with what it contradicts."""
    stated = {claim.value for claim in claims}
    extra = OTHER if claims else 0.0
    return [(value, _cost(claims, value)) for value in sorted(stated)] + [
        (value, _cost(claims, value) + extra) for value in sorted(set(others) - stated)
    ]


def _cost(claims: Sequence[Claim], value: int) -> float:
    return sum(claim.cost(value) for claim in claims)


def _agreed(claims: Sequence[Claim]) -> bool:
    """Return whether all that is stated with weight is one value."""
    return len({claim.value for claim in claims if claim.weight >= TOLD}) == 1


def _open(claims: Sequence[Claim]) -> bool:
    """Return whether the size may give a value: nothing settles it."""
    told = [claim for claim in claims if claim.weight >= TOLD]
    return len(told) < 2 or not _agreed(claims)


def _held(claims: Claims, room: int, row: int) -> list[tuple[int, float]]:
    """Return how many frames there is room for, where the stated counts leave it open.

    That is where one of them ends at 16 bits, begins again at 0 there, or where
    nothing is stated.
    """
    held = room // row if row else 0
    if held <= 0:
        return []
    full = [claim.value for claim in claims.frames if claim.full]
    if not claims.frames or any(held > value for value in full):
        return [(held, _cost(claims.frames, held) + OTHER)]
    wrapped = {
        claim.value + WORD * ((held - claim.value) // WORD)
        for claim in claims.frames
        if claim.wraps and held >= WORD
    }
    return [
        (count, _cost(claims.frames, count))
        for count in sorted(wrapped - {claim.value for claim in claims.frames})
    ]


def _filled(layout: Layout, data: bytes, end: int) -> Layout:
    """Return a layout with the bytes that it leaves, and what they cost."""
    rest = end - layout.end
    if rest < 0:
        return replace(layout, rest=-rest, cost=layout.cost + REST)
    if rest == 0:
        return layout
    padding = rest < BLOCK and end % BLOCK == 0
    if padding and data.count(b"\0", layout.end, end) == rest:
        return layout
    return replace(layout, rest=rest, cost=layout.cost + (DIRTY if padding else REST))


def _decide(
    ranked: Sequence[Layout],
    short: Layout | None,
    judge: Callable[[Layout], Evidence],
) -> Outcome:
    """Return the best of several, after a look at their numbers."""
    seen = [(layout, judge(layout)) for layout in ranked]
    odd = min(evidence.odd for _, evidence in seen)
    rough = min(evidence.rough for _, evidence in seen)
    scored = []
    for layout, evidence in seen:
        if layout.proof and (evidence.odd > 0.1 or evidence.rough > 0.25):
            continue
        penalty = 4.0 * (evidence.odd > odd + 0.02)
        penalty += 4.0 * (evidence.rough > 3.0 * rough + 0.02)
        scored.append(replace(layout, cost=layout.cost + penalty))
    if not scored:
        return Outcome(None, short, tuple(ranked[:3]))
    scored.sort(key=_order)
    best = scored[0]
    rivals = [
        layout
        for layout in scored
        if layout.cost < best.cost + DECISIVE and _rows(layout) != _rows(best)
    ]
    if rivals:
        return Outcome(None, short, (best, *rivals[:2]))
    return Outcome(best, short)


def _rows(layout: Layout) -> tuple[int, ...]:
    """Return what decides which number is which coordinate."""
    return layout.begin, layout.width, layout.points, layout.row
