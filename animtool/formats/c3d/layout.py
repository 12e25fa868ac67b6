"""C3D data layout: the combination of stated counts that fits the file's size."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from animtool.core.record import dataclass
from animtool.formats.c3d.claims import Claim, Claims
from animtool.formats.c3d.sections import BLOCK

# Costs, beside those of the claims that are contradicted: bytes behind the last frame
# that are padding but not zero, bytes there that are none, bytes before the first frame
# that are not zero, a count that nothing states, a number of frames that only the size
# of the file gives, and other counts that only it gives.
DIRTY, REST, SKIPPED, OTHER, FITTED, SOLVED = 0.75, 3.0, 1.0, 0.5, 1.0, 1.5
# Evidence of positions: fraction of odd points, and steps of smooth ones and of noise.
MAX_OUTLIERS, SMOOTH, NOISE = 0.1, 0.25, 0.5
# What decides for one combination against another.
DECISIVE = 0.2
# Number of combinations whose values are judged.
MAX_JUDGED = 16
# Claims of less weight are hints.
HEAVY = 0.5


@dataclass(frozen=True, slots=True)
class Layout:
    """Counts of points, analogue values and frames, and where the data begins.

    Attributes:
        begin: Byte of the first frame.
        width: Bytes of a number.
        points: Points of a frame.
        analog: Numbers behind the points of a frame.
        frames: Frames.
        rest: Bytes behind the last frame, but for zeros up to a full block.
        cost: What is contradicted, summed.
        proof: It is read only where its numbers look like positions.
        solved: One of its counts is stated nowhere.
    """

    begin: int
    width: int
    points: int
    analog: int
    frames: int
    rest: int = 0
    cost: float = 0.0
    proof: bool = False
    solved: bool = False

    @property
    def row(self) -> int:
        """Count of numbers per frame."""
        return 4 * self.points + self.analog

    @property
    def end(self) -> int:
        """Byte offset after the last frame."""
        return self.begin + self.width * self.row * self.frames

    def __str__(self) -> str:
        """Return the counts as text."""
        kind = "floats" if self.width == 4 else "integers"
        return (
            f"{self.frames} frames of {self.points} points and {self.analog} "
            f"analogue values, {kind} from byte {self.begin}"
        )


@dataclass(frozen=True, slots=True)
class Evidence:
    """How plausible the numbers of a layout are as positions over frames.

    Attributes:
        outliers: Fraction of points that can be no positions.
        rough: Mean step from frame to frame over the spread of all positions; NaN where
            nothing moves or no two frames follow each other.
    """

    outliers: float
    rough: float


@dataclass(frozen=True, slots=True)
class LayoutResult:
    """The chosen layout, or why none fits.

    Attributes:
        layout: The combination that is read; None if none fits.
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
) -> LayoutResult:
    """Return the combination of claims that fits the file at the lowest cost.

    Args:
        claims: What the file states.
        data: The file.
        ends: Bytes at which the points may end; the last is the size of the file.
        judge: Looks at the numbers of a combination.
    """
    cheapest: dict[tuple[int, ...], Layout] = {}
    short: Layout | None = None
    tail = _tail(data)
    for layout in _combinations(claims, ends[-1], tail):
        if layout.end > ends[-1] or layout.begin > ends[-1]:
            if not layout.solved and (short is None or layout.cost < short.cost):
                short = layout
            continue
        candidate = min((_filled(layout, data, end) for end in ends), key=_order)
        candidate = _skipping(candidate, claims.after, data)
        key = (
            candidate.begin,
            candidate.width,
            candidate.points,
            candidate.analog,
            candidate.frames,
        )
        if key not in cheapest or candidate.cost < cheapest[key].cost:
            cheapest[key] = candidate
    ranked = sorted(cheapest.values(), key=_order)[:MAX_JUDGED]
    if short is not None and short.cost < HEAVY:
        # Where all claims agree but the file is too small, it is truncated, unless
        # other claims fill it.
        ranked = [each for each in ranked if each.rest == 0 and not each.solved]
    if not ranked:
        return LayoutResult(None, short)
    if ranked[0].cost < HEAVY:
        return LayoutResult(ranked[0])
    outcome = _decide(ranked, short, judge)
    best = outcome.layout
    if best is None:
        return outcome
    if best.rest and short is not None and short.cost < best.cost - REST:
        return LayoutResult(None, short)
    return outcome


def _tail(data: bytes) -> int:
    """Return the number of trailing zero bytes, if the last block is full."""
    if len(data) % BLOCK:
        return 0
    last = data[-BLOCK:]
    return min(BLOCK - 1, len(last) - len(last.rstrip(b"\0")))


def contradicted(claims: Claims, layout: Layout) -> list[tuple[str, int, list[Claim]]]:
    """Return quantities read against claims: name, value and those claims."""
    contradictions = []
    for name in ("frames", "points", "analog", "width", "begin"):
        value = getattr(layout, name)
        against = [
            claim
            for claim in getattr(claims, name)
            if claim.weight >= HEAVY and claim.value != value
        ]
        stated = [claim for claim in getattr(claims, name) if claim.value == value]
        # Counts that end at 16 bits contradict nothing where another states the rest.
        against = [c for c in against if c.cost(value) >= HEAVY or not stated]
        if against:
            contradictions.append((name, value, against))
    return contradictions


def _order(layout: Layout) -> tuple[float, ...]:
    return (
        layout.cost, layout.begin, layout.width, layout.points, layout.analog,
        layout.frames,
    )  # fmt: skip


def _combinations(claims: Claims, size: int, tail: int) -> Iterable[Layout]:
    """Yield combinations of stated counts, one of them solved from the size.

    size, tail: Of the file, and of the zeros that it ends in [byte].
    """
    widths = _priced(claims.width, (2, 4))
    for (begin, by_b), (width, by_w) in itertools.product(
        _priced(claims.begin), widths
    ):
        flipped = by_w >= HEAVY and _agreed(claims.width)
        room = ((size - begin) // width, (size - begin - tail) // width)
        for p, a, f, counts, solved in _counts(claims, *room):
            cost, proof = by_b + by_w + counts, flipped or solved
            yield Layout(begin, width, p, a, f, 0, cost, proof, solved)


def _counts(
    claims: Claims, room: int, least: int
) -> Iterable[tuple[int, int, int, float, bool]]:
    """Yield points, analogue values, frames, cost, and whether one is solved.

    room, least: Numbers for which there is room, with and without zeros at the end.
    """
    points, frames = _priced(claims.points), _priced(claims.frames)
    analog = _priced(claims.analog, claims.others)
    stated = {claim.value for claim in claims.analog}
    for (p, by_p), (a, by_a) in itertools.product(points, analog):
        row, tried = 4 * p + a, a not in stated
        for f, by_f in frames:
            yield p, a, f, by_p + by_a + by_f, tried
        fitted = _fitted(claims, -(-least // row)) if row and least > 0 else ()
        for f, by_f, solved in fitted:
            yield p, a, f, by_p + by_a + by_f, tried or solved
    for f, by_f in frames:
        for p, by_p in points if _open(claims.analog) else ():
            a = room // f - 4 * p
            if a >= 0:
                cost = by_p + by_f + _cost(claims.analog, a) + SOLVED
                yield p, a, f, cost, True
        for a, by_a in analog if _open(claims.points) else ():
            p, more = divmod(room // f - a, 4)
            if p > 0 and more == 0:
                cost = by_a + by_f + _cost(claims.points, p) + SOLVED
                yield p, a, f, cost, True


def _priced(
    claims: Sequence[Claim], others: Sequence[int] = ()
) -> list[tuple[int, float]]:
    """Return candidate values, each with the cost of contradicted claims."""
    stated = {claim.value for claim in claims}
    extra = OTHER if claims else 0.0
    return [(value, _cost(claims, value)) for value in sorted(stated)] + [
        (value, _cost(claims, value) + extra) for value in sorted(set(others) - stated)
    ]


def _cost(claims: Sequence[Claim], value: int) -> float:
    return sum(claim.cost(value) for claim in claims)


def _agreed(claims: Sequence[Claim]) -> bool:
    """Return whether all claims with weight state one value."""
    return len({claim.value for claim in claims if claim.weight >= HEAVY}) == 1


def _open(claims: Sequence[Claim]) -> bool:
    """Return whether a value may be solved from the size: no claims settle it."""
    decisive = [claim for claim in claims if claim.weight >= HEAVY]
    return len(decisive) < 2 or not _agreed(claims)


def _fitted(claims: Claims, count: int) -> list[tuple[int, float, bool]]:
    """Return frame counts that fit the size, their cost, and if solved.

    That is where stated counts end at 16 bits, begin again at 0 there, differ, or where
    nothing is stated.

    count: Frames for which there is room.
    """
    frames = claims.frames
    if any(claim.value == count for claim in frames):
        return []
    cost = _cost(frames, count)
    if not frames or any(claim.full and count > claim.value for claim in frames):
        return [(count, cost + OTHER, False)]
    if any(claim.wraps and claim.cost(count) < claim.weight for claim in frames):
        return [(count, cost, False)]
    return [] if _agreed(frames) else [(count, cost + FITTED, True)]


def _skipping(layout: Layout, after: int, data: bytes) -> Layout:
    """Return a layout with the cost of skipped bytes that are not zero."""
    gap = layout.begin - after
    if gap <= 0 or data.count(b"\0", after, layout.begin) == gap:
        return layout
    return replace(layout, cost=layout.cost + SKIPPED)


def _filled(layout: Layout, data: bytes, end: int) -> Layout:
    """Return a layout with its count of unused bytes, and their cost."""
    rest = end - layout.end
    if rest < 0:
        return replace(layout, rest=-rest, cost=layout.cost + REST)
    padding = rest < BLOCK and end % BLOCK == 0
    size = layout.width * layout.row
    if padding and data.count(b"\0", layout.end, end) == rest:
        # A last frame of zeros is rather padding, too.
        last = layout.end - size
        zeros = 0 < size < BLOCK - rest and data.count(b"\0", last, layout.end) == size
        return replace(layout, cost=layout.cost + DIRTY) if zeros else layout
    if rest == 0:
        return layout
    return replace(layout, rest=rest, cost=layout.cost + (DIRTY if padding else REST))


def _decide(
    ranked: Sequence[Layout],
    truncated_layout: Layout | None,
    judge: Callable[[Layout], Evidence],
) -> LayoutResult:
    """Return the best of several layouts after judging their numbers."""
    judged = [(layout, judge(layout)) for layout in ranked]
    outliers = min(evidence.outliers for _, evidence in judged)
    rough = min((e.rough for _, e in judged if e.rough >= 0), default=0.0)
    scored = []
    for layout, evidence in judged:
        if layout.solved and layout.rest:
            continue
        if layout.proof and not (
            evidence.outliers <= MAX_OUTLIERS and evidence.rough <= SMOOTH
        ):
            continue
        if layout.rest >= BLOCK and _is_noise(layout, evidence):
            continue
        penalty = 4.0 * (evidence.outliers > outliers + 0.02)
        penalty += 4.0 * (evidence.rough > 3.0 * rough + 0.02)
        scored.append(replace(layout, cost=layout.cost + penalty))
    if not scored:
        return LayoutResult(
            None, truncated_layout, () if truncated_layout else tuple(ranked[:3])
        )
    scored.sort(key=_order)
    best = scored[0]
    rivals = [
        layout
        for layout in scored
        if layout.cost < best.cost + DECISIVE and _rows(layout) != _rows(best)
    ]
    if rivals:
        return LayoutResult(None, truncated_layout, (best, *rivals[:2]))
    return LayoutResult(best, truncated_layout)


def _is_noise(layout: Layout, evidence: Evidence) -> bool:
    """Return whether numbers look like noise; a single static point always does."""
    return evidence.outliers > MAX_OUTLIERS or (
        layout.points > 1 and evidence.rough > NOISE
    )


def _rows(layout: Layout) -> tuple[int, ...]:
    """Return the values that decide which number is which coordinate."""
    return layout.begin, layout.width, layout.points, layout.row
