"""Chooses the C3D data layout: the stated counts that fit the file's size."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from animtool.core.record import dataclass
from animtool.formats.c3d.claims import Claim, Claims
from animtool.formats.c3d.sections import BLOCK_BYTES

# Costs in addition to those of contradicted claims: nonzero padding after the last
# frame (DIRTY), bytes after the last frame that are not padding (TRAILING), nonzero
# bytes before the first frame (SKIPPED), a count that no field states (UNSTATED), a
# number of frames solved from the file size (FITTED), and other counts solved from it
# (SOLVED).
DIRTY_COST = 0.75
TRAILING_COST = 3.0
SKIPPED_COST = 1.0
UNSTATED_COST = 0.5
FITTED_COST = 1.0
SOLVED_COST = 1.5
# Thresholds for positions: fraction of outliers, roughness of smooth motion, and
# roughness of noise.
MAX_OUTLIER_FRACTION, MAX_SMOOTH_ROUGHNESS, NOISE_ROUGHNESS = 0.1, 0.25, 0.5
# Cost difference that decides for a layout.
DECISIVE_COST_GAP = 0.2
# Maximum number of layouts whose values are examined.
MAX_JUDGED_LAYOUTS = 16
# Claims with less weight are hints.
MIN_CLAIM_WEIGHT = 0.5


@dataclass(frozen=True, slots=True)
class Layout:
    """Counts of points, analogue values and frames, and the start of the data."""

    begin: int  # offset of the first frame [byte]
    width: int  # size of a number [byte]
    points: int  # points per frame
    analog: int  # numbers after the points of a frame
    frames: int  # number of frames
    # Bytes after the last frame, except zeros up to a full block.
    trailing_bytes: int = 0
    cost: float = 0.0  # total cost of contradicted claims
    # Whether to use it only if the numbers look like positions.
    needs_evidence: bool = False
    is_solved: bool = False  # whether one of the counts is not stated by any field

    @property
    def numbers_per_frame(self) -> int:
        """Count of numbers per frame."""
        return 4 * self.points + self.analog

    @property
    def end(self) -> int:
        """Byte offset after the last frame."""
        return self.begin + self.width * self.numbers_per_frame * self.frames

    def __str__(self) -> str:
        """Describe the layout for messages."""
        kind = "floats" if self.width == 4 else "integers"
        return (
            f"{self.frames} frames of {self.points} points and {self.analog} "
            f"analogue values, {kind} from byte {self.begin}"
        )


@dataclass(frozen=True, slots=True)
class Evidence:
    """Plausibility of a layout's numbers as positions over frames."""

    outlier_fraction: float  # fraction of points that cannot be positions
    # Mean step between frames, relative to the spread of all positions; NaN if nothing
    # moves or no two frames are consecutive.
    roughness: float


@dataclass(frozen=True, slots=True)
class LayoutResult:
    """The layout to read, or the closest layouts if none fits the file."""

    layout: Layout | None  # the layout to read; None if no layout fits
    # The layout with the fewest contradictions among those that need more bytes than
    # the file has.
    truncated: Layout | None = None
    # Layouts that the evidence cannot decide between.
    ambiguous_layouts: tuple[Layout, ...] = ()


def choose_layout(
    claims: Claims,
    data: bytes,
    end_offsets: Sequence[int],
    measure_evidence: Callable[[Layout], Evidence],
) -> LayoutResult:
    """Return the layout that fits the file and contradicts the fewest claims.

    Args:
        claims: Values stated by the file.
        data: Content of the file.
        end_offsets: Byte offsets where the points may end; the last is the file size.
        measure_evidence: Returns the evidence for a layout.
    """
    cheapest: dict[tuple[float, ...], Layout] = {}
    truncated_layout: Layout | None = None
    padding = _count_padding(data)
    for layout in _combinations(claims, end_offsets[-1], padding):
        if layout.end > end_offsets[-1] or layout.begin > end_offsets[-1]:
            if not layout.is_solved and (
                truncated_layout is None or layout.cost < truncated_layout.cost
            ):
                truncated_layout = layout
            continue
        candidate = min(
            (_add_trailing_cost(layout, data, end) for end in end_offsets),
            key=_sort_key,
        )
        candidate = _add_skipped_cost(candidate, claims.parameters_end, data)
        key = _sort_key(candidate)[1:]
        if key not in cheapest or candidate.cost < cheapest[key].cost:
            cheapest[key] = candidate
    candidates = sorted(cheapest.values(), key=_sort_key)[:MAX_JUDGED_LAYOUTS]
    if truncated_layout is not None and truncated_layout.cost < MIN_CLAIM_WEIGHT:
        # All claims agree but the file is too small: it is truncated, unless other
        # claims match its size exactly.
        candidates = [
            layout
            for layout in candidates
            if layout.trailing_bytes == 0 and not layout.is_solved
        ]
    if not candidates:
        return LayoutResult(None, truncated_layout)
    if candidates[0].cost < MIN_CLAIM_WEIGHT:
        return LayoutResult(candidates[0])
    result = _choose_by_evidence(candidates, truncated_layout, measure_evidence)
    best = result.layout
    if best is None:
        return result
    if (
        best.trailing_bytes
        and truncated_layout is not None
        and truncated_layout.cost < best.cost - TRAILING_COST
    ):
        return LayoutResult(None, truncated_layout)
    return result


def _count_padding(data: bytes) -> int:
    """Return the number of zero bytes that pad the last block; 0 if it is partial."""
    if len(data) % BLOCK_BYTES:
        return 0
    last_block = data[-BLOCK_BYTES:]
    return min(BLOCK_BYTES - 1, len(last_block) - len(last_block.rstrip(b"\0")))


def contradicted_claims(
    claims: Claims, layout: Layout
) -> list[tuple[str, int, list[Claim]]]:
    """Return contradicted quantities: name, value and the contradicting claims."""
    contradictions = []
    for name in ("frames", "points", "analog", "width", "begin"):
        value = getattr(layout, name)
        opposing = [
            claim
            for claim in getattr(claims, name)
            if claim.weight >= MIN_CLAIM_WEIGHT and claim.value != value
        ]
        supporting = [claim for claim in getattr(claims, name) if claim.value == value]
        # A saturated count does not contradict a larger count that another claim
        # states.
        opposing = [
            c for c in opposing if c.cost(value) >= MIN_CLAIM_WEIGHT or not supporting
        ]
        if opposing:
            contradictions.append((name, value, opposing))
    return contradictions


def _sort_key(layout: Layout) -> tuple[float, ...]:
    return (
        layout.cost, layout.begin, layout.width, layout.points, layout.analog,
        layout.frames,
    )  # fmt: skip


def _combinations(claims: Claims, size: int, padding: int) -> Iterable[Layout]:
    """Yield layouts of all combinations of stated counts, or with one count solved.

    ``size`` is the file size, ``padding`` the number of zeros at the end [byte].
    """
    widths = _costed_values(claims.width, (2, 4))
    for (begin, begin_cost), (width, width_cost) in itertools.product(
        _costed_values(claims.begin), widths
    ):
        contradicts_width = width_cost >= MIN_CLAIM_WEIGHT and _claims_agree(
            claims.width
        )
        capacity = ((size - begin) // width, (size - begin - padding) // width)
        for points, analog, frames, count_cost, is_solved in _count_combinations(
            claims, *capacity
        ):
            cost = begin_cost + width_cost + count_cost
            needs_evidence = contradicts_width or is_solved
            yield Layout(
                begin, width, points, analog, frames, 0, cost, needs_evidence, is_solved
            )


def _count_combinations(
    claims: Claims, capacity: int, min_numbers: int
) -> Iterable[tuple[int, int, int, float, bool]]:
    """Yield point, analogue and frame counts, their cost, and whether one is solved.

    The data has space for ``capacity`` numbers, or ``min_numbers`` without the zeros
    at its end.
    """
    points, frames = _costed_values(claims.points), _costed_values(claims.frames)
    analog = _costed_values(claims.analog, claims.analog_candidates)
    claimed_values = {claim.value for claim in claims.analog}
    for (point_count, point_cost), (analog_count, analog_cost) in itertools.product(
        points, analog
    ):
        numbers_per_frame = 4 * point_count + analog_count
        is_unclaimed = analog_count not in claimed_values
        frame_counts = [(count, cost, False) for count, cost in frames]
        if numbers_per_frame and min_numbers > 0:
            fitting_count = -(-min_numbers // numbers_per_frame)
            frame_counts += _solve_frame_counts(claims, fitting_count)
        for frame_count, frame_cost, is_solved in frame_counts:
            yield (
                point_count,
                analog_count,
                frame_count,
                point_cost + analog_cost + frame_cost,
                is_unclaimed or is_solved,
            )
    for frame_count, frame_cost in frames:
        for point_count, point_cost in points if _can_solve(claims.analog) else ():
            analog_count = capacity // frame_count - 4 * point_count
            if analog_count >= 0:
                analog_cost = _claims_cost(claims.analog, analog_count)
                cost = point_cost + frame_cost + analog_cost + SOLVED_COST
                yield point_count, analog_count, frame_count, cost, True
        for analog_count, analog_cost in analog if _can_solve(claims.points) else ():
            point_count, remainder = divmod(capacity // frame_count - analog_count, 4)
            if point_count > 0 and remainder == 0:
                point_cost = _claims_cost(claims.points, point_count)
                cost = analog_cost + frame_cost + point_cost + SOLVED_COST
                yield point_count, analog_count, frame_count, cost, True


def _costed_values(
    claims: Sequence[Claim], other_values: Sequence[int] = ()
) -> list[tuple[int, float]]:
    """Return candidate values, each with the cost of the claims it contradicts."""
    claimed_values = {claim.value for claim in claims}
    unclaimed_cost = UNSTATED_COST if claims else 0.0
    return [(v, _claims_cost(claims, v)) for v in sorted(claimed_values)] + [
        (value, _claims_cost(claims, value) + unclaimed_cost)
        for value in sorted(set(other_values) - claimed_values)
    ]


def _claims_cost(claims: Sequence[Claim], value: int) -> float:
    return sum(claim.cost(value) for claim in claims)


def _claims_agree(claims: Sequence[Claim]) -> bool:
    """Return whether all claims except hints state the same value."""
    return len({c.value for c in claims if c.weight >= MIN_CLAIM_WEIGHT}) == 1


def _can_solve(claims: Sequence[Claim]) -> bool:
    """Return whether claims leave a value open, so that the file size may decide it."""
    decisive = [claim for claim in claims if claim.weight >= MIN_CLAIM_WEIGHT]
    return len(decisive) < 2 or not _claims_agree(claims)


def _solve_frame_counts(claims: Claims, count: int) -> list[tuple[int, float, bool]]:
    """Return frame counts solved from the file size: value, cost, and whether solved.

    Empty unless stated counts are saturated, wrap around, differ, or are missing.
    ``count`` is the number of frames that fit into the data.
    """
    frames = claims.frames
    if any(claim.value == count for claim in frames):
        return []
    cost = _claims_cost(frames, count)
    if not frames or any(c.is_saturated and count > c.value for c in frames):
        return [(count, cost + UNSTATED_COST, False)]
    if any(claim.can_wrap and claim.cost(count) < claim.weight for claim in frames):
        return [(count, cost, False)]
    return [] if _claims_agree(frames) else [(count, cost + FITTED_COST, True)]


def _add_skipped_cost(layout: Layout, parameters_end: int, data: bytes) -> Layout:
    """Return a layout with the cost of nonzero bytes before the first frame added."""
    gap_bytes = layout.begin - parameters_end
    if gap_bytes <= 0 or data.count(b"\0", parameters_end, layout.begin) == gap_bytes:
        return layout
    return replace(layout, cost=layout.cost + SKIPPED_COST)


def _add_trailing_cost(layout: Layout, data: bytes, end: int) -> Layout:
    """Add the number of bytes after the last frame and their cost to a layout."""
    unused_bytes = end - layout.end
    if unused_bytes < 0:
        return replace(
            layout, trailing_bytes=-unused_bytes, cost=layout.cost + TRAILING_COST
        )
    is_padding = unused_bytes < BLOCK_BYTES and end % BLOCK_BYTES == 0
    frame_bytes = layout.width * layout.numbers_per_frame
    if is_padding and data.count(b"\0", layout.end, end) == unused_bytes:
        # A last frame of zeros is probably padding.
        last_frame = layout.end - frame_bytes
        is_zero_frame = (
            0 < frame_bytes < BLOCK_BYTES - unused_bytes
            and data.count(b"\0", last_frame, layout.end) == frame_bytes
        )
        return (
            replace(layout, cost=layout.cost + DIRTY_COST) if is_zero_frame else layout
        )
    if unused_bytes == 0:
        return layout
    return replace(
        layout,
        trailing_bytes=unused_bytes,
        cost=layout.cost + (DIRTY_COST if is_padding else TRAILING_COST),
    )


def _choose_by_evidence(
    candidates: Sequence[Layout],
    truncated_layout: Layout | None,
    measure_evidence: Callable[[Layout], Evidence],
) -> LayoutResult:
    """Return the layout whose numbers look most like positions."""
    all_evidence = [measure_evidence(layout) for layout in candidates]
    min_outlier_fraction = min(evidence.outlier_fraction for evidence in all_evidence)
    # NaN is not measured.
    measured = [one.roughness for one in all_evidence if one.roughness >= 0]
    min_roughness = min(measured, default=0.0)
    scored_layouts = []
    for layout, evidence in zip(candidates, all_evidence, strict=True):
        if layout.is_solved and layout.trailing_bytes:
            continue
        if layout.needs_evidence and not (
            evidence.outlier_fraction <= MAX_OUTLIER_FRACTION
            and evidence.roughness <= MAX_SMOOTH_ROUGHNESS
        ):
            continue
        if layout.trailing_bytes >= BLOCK_BYTES and _is_noise(layout, evidence):
            continue
        penalty = 4.0 * (evidence.outlier_fraction > min_outlier_fraction + 0.02)
        penalty += 4.0 * (evidence.roughness > 3.0 * min_roughness + 0.02)
        scored_layouts.append(replace(layout, cost=layout.cost + penalty))
    if not scored_layouts:
        return LayoutResult(
            None, truncated_layout, () if truncated_layout else tuple(candidates[:3])
        )
    scored_layouts.sort(key=_sort_key)
    best = scored_layouts[0]
    rivals = [
        layout
        for layout in scored_layouts
        if layout.cost < best.cost + DECISIVE_COST_GAP
        and _interpretation_key(layout) != _interpretation_key(best)
    ]
    if rivals:
        return LayoutResult(None, truncated_layout, (best, *rivals[:2]))
    return LayoutResult(best, truncated_layout)


def _is_noise(layout: Layout, evidence: Evidence) -> bool:
    """Return whether the numbers of a layout look like noise, not like positions."""
    # A single point may be rough: its spread can be small.
    return evidence.outlier_fraction > MAX_OUTLIER_FRACTION or (
        layout.points > 1 and evidence.roughness > NOISE_ROUGHNESS
    )


def _interpretation_key(layout: Layout) -> tuple[int, ...]:
    """Return the layout values that determine which number is which coordinate."""
    return layout.begin, layout.width, layout.points, layout.numbers_per_frame
