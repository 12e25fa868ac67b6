"""C3D data layout: the combination of stated counts that fits the file's size."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from animtool.core.record import dataclass
from animtool.formats.c3d.claims import Claim, Claims
from animtool.formats.c3d.sections import BLOCK_BYTES

# Costs in addition to those of contradicted claims: padding after the last frame that
# is not zero (DIRTY), bytes after the last frame that are not padding (TRAILING), bytes
# before the first frame that are not zero (SKIPPED), a count that no field states
# (UNSTATED), a number of frames solved from the file size (FITTED), and other counts
# solved from it (SOLVED).
DIRTY, TRAILING, SKIPPED, UNSTATED, FITTED, SOLVED = 0.75, 3.0, 1.0, 0.5, 1.0, 1.5
# Evidence of positions: largest fraction of outliers, and largest mean step of smooth
# motion and smallest of noise.
MAX_OUTLIERS, MAX_SMOOTH_ROUGHNESS, NOISE = 0.1, 0.25, 0.5
# Difference of scores that decides for a combination.
DECISIVE_COST_GAP = 0.2
# Number of combinations whose values are judged.
MAX_JUDGED_LAYOUTS = 16
# Claims with less weight are hints.
MIN_CLAIM_WEIGHT = 0.5


@dataclass(frozen=True, slots=True)
class Layout:
    """Counts of points, analogue values and frames, and the start of the data.

    Attributes:
        begin: Offset of the first frame [byte].
        width: Size of a number [byte].
        points: Points per frame.
        analog: Numbers after the points of a frame.
        frames: Number of frames.
        trailing: Bytes after the last frame, except zeros up to a full block.
        cost: Total cost of contradicted claims.
        needs_evidence: Whether it is used only if its numbers look like positions.
        solved: Whether one of its counts is not stated by any field.
    """

    begin: int
    width: int
    points: int
    analog: int
    frames: int
    trailing: int = 0
    cost: float = 0.0
    needs_evidence: bool = False
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
    """Plausibility of a layout's numbers as positions over frames.

    Attributes:
        outliers: Fraction of points that cannot be positions.
        rough: Mean step between frames relative to the spread of all positions; NaN if
            nothing moves or no two frames are consecutive.
    """

    outliers: float
    rough: float


@dataclass(frozen=True, slots=True)
class LayoutResult:
    """The chosen layout, or why none fits.

    Attributes:
        layout: The layout to read; None if none fits.
        short: The layout with the least contradictions that needs more bytes than the
            file has.
        rivals: Layouts that the evidence cannot decide between.
    """

    layout: Layout | None
    short: Layout | None = None
    ambiguous_rates: tuple[Layout, ...] = ()


def choose_layout(
    claims: Claims,
    data: bytes,
    ends: Sequence[int],
    evidence_of: Callable[[Layout], Evidence],
) -> LayoutResult:
    """Return the combination of claims that fits the file at the lowest cost.

    Args:
        claims: Values stated by the file.
        data: Content of the file.
        ends: Offsets at which the points may end [byte]; the last is the file size.
        evidence_of: Returns the evidence for a layout.
    """
    cheapest: dict[tuple[int, ...], Layout] = {}
    truncated_layout: Layout | None = None
    zero_bytes = _trailing_zeros(data)
    for layout in _combinations(claims, ends[-1], zero_bytes):
        if layout.end > ends[-1] or layout.begin > ends[-1]:
            if not layout.solved and (
                truncated_layout is None or layout.cost < truncated_layout.cost
            ):
                truncated_layout = layout
            continue
        candidate = min(
            (_with_trailing(layout, data, end) for end in ends), key=_layout_order
        )
        candidate = _with_skipped(candidate, claims.after, data)
        key = (
            candidate.begin,
            candidate.width,
            candidate.points,
            candidate.analog,
            candidate.frames,
        )
        if key not in cheapest or candidate.cost < cheapest[key].cost:
            cheapest[key] = candidate
    candidates = sorted(cheapest.values(), key=_layout_order)[:MAX_JUDGED_LAYOUTS]
    if truncated_layout is not None and truncated_layout.cost < MIN_CLAIM_WEIGHT:
        # If all claims agree but the file is too small, it is truncated, unless other
        # claims fill it.
        candidates = [
            layout_
            for layout_ in candidates
            if layout_.trailing == 0 and not layout_.solved
        ]
    if not candidates:
        return LayoutResult(None, truncated_layout)
    if candidates[0].cost < MIN_CLAIM_WEIGHT:
        return LayoutResult(candidates[0])
    outcome = _choose_by_evidence(candidates, truncated_layout, evidence_of)
    best = outcome.layout
    if best is None:
        return outcome
    if (
        best.trailing
        and truncated_layout is not None
        and truncated_layout.cost < best.cost - TRAILING
    ):
        return LayoutResult(None, truncated_layout)
    return outcome


def _trailing_zeros(data: bytes) -> int:
    """Return the number of trailing zero bytes, if the last block is full."""
    if len(data) % BLOCK_BYTES:
        return 0
    last_block = data[-BLOCK_BYTES:]
    return min(BLOCK_BYTES - 1, len(last_block) - len(last_block.rstrip(b"\0")))


def contradicted_claims(
    claims: Claims, layout: Layout
) -> list[tuple[str, int, list[Claim]]]:
    """Return quantities read against claims: name, value and those claims."""
    contradictions = []
    for name in ("frames", "points", "analog", "width", "begin"):
        value = getattr(layout, name)
        opposing = [
            claim
            for claim in getattr(claims, name)
            if claim.weight >= MIN_CLAIM_WEIGHT and claim.value != value
        ]
        supporting = [claim for claim in getattr(claims, name) if claim.value == value]
        # Full 16-bit counts do not contradict a larger count that another claim states.
        opposing = [
            c for c in opposing if c.cost(value) >= MIN_CLAIM_WEIGHT or not supporting
        ]
        if opposing:
            contradictions.append((name, value, opposing))
    return contradictions


def _layout_order(layout: Layout) -> tuple[float, ...]:
    return (
        layout.cost, layout.begin, layout.width, layout.points, layout.analog,
        layout.frames,
    )  # fmt: skip


def _combinations(claims: Claims, size: int, padding: int) -> Iterable[Layout]:
    """Yield combinations of stated counts, one of them solved from the size.

    ``size`` is that of the file, ``padding`` that of the zeros at its end [byte].
    """
    widths = _with_costs(claims.width, (2, 4))
    for (begin, by_b), (width, by_w) in itertools.product(
        _with_costs(claims.begin), widths
    ):
        against_width = by_w >= MIN_CLAIM_WEIGHT and _all_agree(claims.width)
        capacity = ((size - begin) // width, (size - begin - padding) // width)
        for p, a, f, counts, is_solved in _count_combinations(claims, *capacity):
            cost, needs_evidence = by_b + by_w + counts, against_width or is_solved
            yield Layout(begin, width, p, a, f, 0, cost, needs_evidence, is_solved)


def _count_combinations(
    claims: Claims, capacity: int, min_numbers: int
) -> Iterable[tuple[int, int, int, float, bool]]:
    """Yield points, analogue values, frames, cost, and whether one is solved.

    The data has space for ``capacity`` numbers, or ``min_numbers`` without the zeros
    at its end.
    """
    points, frames = _with_costs(claims.points), _with_costs(claims.frames)
    analog = _with_costs(claims.analog, claims.candidates)
    claimed = {claim.value for claim in claims.analog}
    for (p, by_p), (a, by_a) in itertools.product(points, analog):
        row, is_unclaimed = 4 * p + a, a not in claimed
        for f, by_f in frames:
            yield p, a, f, by_p + by_a + by_f, is_unclaimed
        frame_counts = (
            _counts_from_size(claims, -(-min_numbers // row))
            if row and min_numbers > 0
            else ()
        )
        for f, by_f, is_solved in frame_counts:
            yield p, a, f, by_p + by_a + by_f, is_unclaimed or is_solved
    for f, by_f in frames:
        for p, by_p in points if _may_solve(claims.analog) else ():
            a = capacity // f - 4 * p
            if a >= 0:
                cost = by_p + by_f + _claims_cost(claims.analog, a) + SOLVED
                yield p, a, f, cost, True
        for a, by_a in analog if _may_solve(claims.points) else ():
            p, remainder = divmod(capacity // f - a, 4)
            if p > 0 and remainder == 0:
                cost = by_a + by_f + _claims_cost(claims.points, p) + SOLVED
                yield p, a, f, cost, True


def _with_costs(
    claims: Sequence[Claim], other_values: Sequence[int] = ()
) -> list[tuple[int, float]]:
    """Return candidate values, each with the cost of contradicted claims."""
    claimed = {claim.value for claim in claims}
    unclaimed_cost = UNSTATED if claims else 0.0
    return [(value, _claims_cost(claims, value)) for value in sorted(claimed)] + [
        (value, _claims_cost(claims, value) + unclaimed_cost)
        for value in sorted(set(other_values) - claimed)
    ]


def _claims_cost(claims: Sequence[Claim], value: int) -> float:
    return sum(claim.cost(value) for claim in claims)


def _all_agree(claims: Sequence[Claim]) -> bool:
    """Return whether all claims with weight state one value."""
    return (
        len({claim.value for claim in claims if claim.weight >= MIN_CLAIM_WEIGHT}) == 1
    )


def _may_solve(claims: Sequence[Claim]) -> bool:
    """Return whether a value may be solved from the size: no claims settle it."""
    decisive = [claim for claim in claims if claim.weight >= MIN_CLAIM_WEIGHT]
    return len(decisive) < 2 or not _all_agree(claims)


def _counts_from_size(claims: Claims, count: int) -> list[tuple[int, float, bool]]:
    """Return frame counts solved from the file size, with cost and a flag.

    That is, if stated counts are full 16-bit values, wrap around, differ, or are
    missing. ``count`` is the number of frames that fit into the data.
    """
    frames = claims.frames
    if any(claim.value == count for claim in frames):
        return []
    cost = _claims_cost(frames, count)
    if not frames or any(claim.full and count > claim.value for claim in frames):
        return [(count, cost + UNSTATED, False)]
    if any(claim.wraps and claim.cost(count) < claim.weight for claim in frames):
        return [(count, cost, False)]
    return [] if _all_agree(frames) else [(count, cost + FITTED, True)]


def _with_skipped(layout: Layout, after: int, data: bytes) -> Layout:
    """Return a layout with the cost of skipped nonzero bytes."""
    gap = layout.begin - after
    if gap <= 0 or data.count(b"\0", after, layout.begin) == gap:
        return layout
    return replace(layout, cost=layout.cost + SKIPPED)


def _with_trailing(layout: Layout, data: bytes, end: int) -> Layout:
    """Return a layout with its count of unused bytes, and their cost."""
    unused_bytes = end - layout.end
    if unused_bytes < 0:
        return replace(layout, trailing=-unused_bytes, cost=layout.cost + TRAILING)
    is_padding = unused_bytes < BLOCK_BYTES and end % BLOCK_BYTES == 0
    size = layout.width * layout.row
    if is_padding and data.count(b"\0", layout.end, end) == unused_bytes:
        # A last frame of zeros is more likely padding, too.
        last_frame = layout.end - size
        zeros = (
            0 < size < BLOCK_BYTES - unused_bytes
            and data.count(b"\0", last_frame, layout.end) == size
        )
        return replace(layout, cost=layout.cost + DIRTY) if zeros else layout
    if unused_bytes == 0:
        return layout
    return replace(
        layout,
        trailing=unused_bytes,
        cost=layout.cost + (DIRTY if is_padding else TRAILING),
    )


def _choose_by_evidence(
    candidates: Sequence[Layout],
    truncated_layout: Layout | None,
    evidence_of: Callable[[Layout], Evidence],
) -> LayoutResult:
    """Return the best of several layouts after judging their numbers."""
    with_evidence = [(layout, evidence_of(layout)) for layout in candidates]
    outliers = min(evidence.outliers for _, evidence in with_evidence)
    smallest_step = min(
        (e.rough for _, e in with_evidence if e.rough >= 0), default=0.0
    )
    scored = []
    for layout, evidence in with_evidence:
        if layout.solved and layout.trailing:
            continue
        if layout.needs_evidence and not (
            evidence.outliers <= MAX_OUTLIERS and evidence.rough <= MAX_SMOOTH_ROUGHNESS
        ):
            continue
        if layout.trailing >= BLOCK_BYTES and _is_noise(layout, evidence):
            continue
        penalty = 4.0 * (evidence.outliers > outliers + 0.02)
        penalty += 4.0 * (evidence.rough > 3.0 * smallest_step + 0.02)
        scored.append(replace(layout, cost=layout.cost + penalty))
    if not scored:
        return LayoutResult(
            None, truncated_layout, () if truncated_layout else tuple(candidates[:3])
        )
    scored.sort(key=_layout_order)
    best = scored[0]
    rivals = [
        layout
        for layout in scored
        if layout.cost < best.cost + DECISIVE_COST_GAP
        and _row_key(layout) != _row_key(best)
    ]
    if rivals:
        return LayoutResult(None, truncated_layout, (best, *rivals[:2]))
    return LayoutResult(best, truncated_layout)


def _is_noise(layout: Layout, evidence: Evidence) -> bool:
    """Return whether numbers look like noise; a single static point always does."""
    return evidence.outliers > MAX_OUTLIERS or (
        layout.points > 1 and evidence.rough > NOISE
    )


def _row_key(layout: Layout) -> tuple[int, ...]:
    """Return the values that assign numbers to coordinates."""
    return layout.begin, layout.width, layout.points, layout.row
