"""Chooses the C3D data layout: the stated counts that fit the file's size."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from animtool.core.record import dataclass
from animtool.formats.c3d.field_values import FieldValue, FieldValues
from animtool.formats.c3d.sections import BLOCK_BYTES

# Costs in addition to those of contradicted values: nonzero padding after the last
# frame, bytes after the last frame that are not padding, nonzero bytes before the first
# frame, a count that no field states, a number of frames solved from the file size, and
# another count solved from it.
NONZERO_PADDING_COST = 0.75
TRAILING_BYTES_COST = 3.0
NONZERO_GAP_COST = 1.0
UNSTATED_COUNT_COST = 0.5
FITTED_FRAMES_COST = 1.0
SOLVED_COUNT_COST = 1.5
# Thresholds for positions: fraction of outliers, roughness of smooth motion, and
# roughness of noise.
MAX_OUTLIER_FRACTION, MAX_SMOOTH_ROUGHNESS, NOISE_ROUGHNESS = 0.1, 0.25, 0.5
# Cost difference that decides for a layout.
DECISIVE_COST_GAP = 0.2
# Maximum number of layouts whose values are examined.
MAX_EXAMINED_LAYOUTS = 16
# Stated values with less weight are hints.
MIN_DECISIVE_WEIGHT = 0.5


@dataclass(frozen=True, slots=True)
class Layout:
    """Counts of points, analogue values and frames, and the start of the data."""

    data_offset: int  # offset of the first frame [byte]
    number_bytes: int  # size of a number [byte]
    point_count: int  # points per frame
    analog_count: int  # numbers after the points of a frame
    frame_count: int  # number of frames
    # Bytes after the last frame, except zeros up to a full block.
    trailing_bytes: int = 0
    cost: float = 0.0  # total cost of contradicted values
    # Whether to use it only if the numbers look like positions.
    needs_evidence: bool = False
    is_solved: bool = False  # whether one of the counts is not stated by any field

    @property
    def numbers_per_frame(self) -> int:
        """Number of stored numbers per frame."""
        return 4 * self.point_count + self.analog_count

    @property
    def end(self) -> int:
        """Byte offset after the last frame."""
        return (
            self.data_offset
            + self.number_bytes * self.numbers_per_frame * self.frame_count
        )

    def __str__(self) -> str:
        """Return counts, number type and start of the data as text for messages."""
        kind = "floats" if self.number_bytes == 4 else "integers"
        return (
            f"{self.frame_count} frames of {self.point_count} points and "
            f"{self.analog_count} analogue values, {kind} from byte {self.data_offset}"
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
    truncated_layout: Layout | None = None
    # Layouts that the evidence cannot decide between.
    ambiguous_layouts: tuple[Layout, ...] = ()


def choose_layout(
    fields: FieldValues,
    data: bytes,
    end_offsets: Sequence[int],
    measure_evidence: Callable[[Layout], Evidence],
) -> LayoutResult:
    """Return the layout that fits the file and contradicts the fewest stated values.

    Args:
        fields: Values stated by the file.
        data: Content of the file.
        end_offsets: Byte offsets where the points may end; the last is the file size.
        measure_evidence: Returns the evidence for a layout.
    """
    cheapest_layouts: dict[tuple[float, ...], Layout] = {}
    truncated_layout: Layout | None = None
    padding = _count_padding(data)
    for layout in _combinations(fields, end_offsets[-1], padding):
        if layout.end > end_offsets[-1] or layout.data_offset > end_offsets[-1]:
            if not layout.is_solved and (
                truncated_layout is None or layout.cost < truncated_layout.cost
            ):
                truncated_layout = layout
            continue
        candidate = min(
            (_add_trailing_cost(layout, data, end) for end in end_offsets),
            key=_sort_key,
        )
        candidate = _add_skipped_cost(candidate, fields.parameters_end, data)
        key = _sort_key(candidate)[1:]
        if key not in cheapest_layouts or candidate.cost < cheapest_layouts[key].cost:
            cheapest_layouts[key] = candidate
    candidates = sorted(cheapest_layouts.values(), key=_sort_key)[:MAX_EXAMINED_LAYOUTS]
    if truncated_layout is not None and truncated_layout.cost < MIN_DECISIVE_WEIGHT:
        # All stated values agree but the file is too small: it is truncated, unless
        # other stated values match its size exactly.
        candidates = [
            layout
            for layout in candidates
            if layout.trailing_bytes == 0 and not layout.is_solved
        ]
    if not candidates:
        return LayoutResult(None, truncated_layout)
    if candidates[0].cost < MIN_DECISIVE_WEIGHT:
        return LayoutResult(candidates[0])
    result = _choose_by_evidence(candidates, truncated_layout, measure_evidence)
    best_layout = result.layout
    if (
        best_layout is None
        or not best_layout.trailing_bytes
        or truncated_layout is None
    ):
        return result
    if truncated_layout.cost < best_layout.cost - TRAILING_BYTES_COST:
        return LayoutResult(None, truncated_layout)
    return result


def _count_padding(data: bytes) -> int:
    """Return the number of zero bytes that pad the last block; 0 if it is partial."""
    if len(data) % BLOCK_BYTES:
        return 0
    last_block = data[-BLOCK_BYTES:]
    return min(BLOCK_BYTES - 1, len(last_block) - len(last_block.rstrip(b"\0")))


def find_contradictions(
    fields: FieldValues, layout: Layout
) -> list[tuple[str, int, list[FieldValue]]]:
    """Return each contradicted quantity: name, value and the stated values."""
    contradictions = []
    for name in (
        "frame_count", "point_count", "analog_count", "number_bytes", "data_offset",
    ):  # fmt: skip
        value, stated_values = getattr(layout, name), getattr(fields, name)
        is_supported = any(v.value == value for v in stated_values)
        # A saturated count does not contradict a larger count that is also stated.
        contradicting_values = [
            v
            for v in stated_values
            if v.weight >= MIN_DECISIVE_WEIGHT
            and v.value != value
            and (v.cost(value) >= MIN_DECISIVE_WEIGHT or not is_supported)
        ]
        if contradicting_values:
            contradictions.append((name, value, contradicting_values))
    return contradictions


def _sort_key(layout: Layout) -> tuple[float, ...]:
    return (
        layout.cost, layout.data_offset, layout.number_bytes, layout.point_count,
        layout.analog_count, layout.frame_count,
    )  # fmt: skip


def _combinations(
    fields: FieldValues, file_size: int, padding: int
) -> Iterable[Layout]:
    """Yield layouts of all combinations of stated counts, or with one count solved.

    ``file_size`` and ``padding``, the number of zeros at the end, are in [byte].
    """
    number_sizes = _values_with_costs(fields.number_bytes, (2, 4))
    for (offset, offset_cost), (size, bytes_cost) in itertools.product(
        _values_with_costs(fields.data_offset), number_sizes
    ):
        contradicts_size = bytes_cost >= MIN_DECISIVE_WEIGHT and _values_agree(
            fields.number_bytes
        )
        data_size = file_size - offset
        capacity = data_size // size, (data_size - padding) // size
        for counts, count_cost, is_solved in _count_combinations(fields, *capacity):
            cost = offset_cost + bytes_cost + count_cost
            needs_evidence = contradicts_size or is_solved
            yield Layout(offset, size, *counts, 0, cost, needs_evidence, is_solved)


def _count_combinations(
    fields: FieldValues, capacity: int, min_numbers: int
) -> Iterable[tuple[tuple[int, int, int], float, bool]]:
    """Yield point, analogue and frame counts, their cost, and whether one is solved.

    The data has space for ``capacity`` numbers, or ``min_numbers`` without the zeros
    at its end.
    """
    costed_points = _values_with_costs(fields.point_count)
    costed_frames = _values_with_costs(fields.frame_count)
    costed_analog = _values_with_costs(fields.analog_count, fields.other_analog_counts)
    stated_counts = {v.value for v in fields.analog_count}
    for (point_count, point_cost), (analog_count, analog_cost) in itertools.product(
        costed_points, costed_analog
    ):
        numbers_per_frame = 4 * point_count + analog_count
        is_unstated = analog_count not in stated_counts
        frame_counts = [(count, cost, False) for count, cost in costed_frames]
        if numbers_per_frame and min_numbers > 0:
            fitting_count = -(-min_numbers // numbers_per_frame)
            frame_counts += _solve_frame_counts(fields, fitting_count)
        for frame_count, frame_cost, is_solved in frame_counts:
            cost = point_cost + analog_cost + frame_cost
            counts = (point_count, analog_count, frame_count)
            yield counts, cost, is_unstated or is_solved
    points_to_solve = costed_points if _can_solve(fields.analog_count) else []
    analog_to_solve = costed_analog if _can_solve(fields.point_count) else []
    for frame_count, frame_cost in costed_frames:
        for point_count, point_cost in points_to_solve:
            analog_count = capacity // frame_count - 4 * point_count
            if analog_count >= 0:
                analog_cost = _total_cost(fields.analog_count, analog_count)
                cost = point_cost + frame_cost + analog_cost + SOLVED_COUNT_COST
                yield (point_count, analog_count, frame_count), cost, True
        for analog_count, analog_cost in analog_to_solve:
            point_count, remainder = divmod(capacity // frame_count - analog_count, 4)
            if point_count > 0 and remainder == 0:
                point_cost = _total_cost(fields.point_count, point_count)
                cost = analog_cost + frame_cost + point_cost + SOLVED_COUNT_COST
                yield (point_count, analog_count, frame_count), cost, True


def _values_with_costs(
    values: Sequence[FieldValue], other_values: Sequence[int] = ()
) -> list[tuple[int, float]]:
    """Return candidate values, each with the cost of stated values it contradicts."""
    stated_values = {v.value for v in values}
    unstated_cost = UNSTATED_COUNT_COST if values else 0.0
    return [(v, _total_cost(values, v)) for v in sorted(stated_values)] + [
        (value, _total_cost(values, value) + unstated_cost)
        for value in sorted(set(other_values) - stated_values)
    ]


def _total_cost(values: Sequence[FieldValue], value: int) -> float:
    return sum(v.cost(value) for v in values)


def _values_agree(values: Sequence[FieldValue]) -> bool:
    """Return whether all stated values except hints are equal."""
    return len({v.value for v in values if v.weight >= MIN_DECISIVE_WEIGHT}) == 1


def _can_solve(values: Sequence[FieldValue]) -> bool:
    """Return whether the file size may decide a count: stated once or unequally."""
    decisive_values = [v for v in values if v.weight >= MIN_DECISIVE_WEIGHT]
    return len(decisive_values) < 2 or not _values_agree(values)


def _solve_frame_counts(
    fields: FieldValues, fitting_count: int
) -> list[tuple[int, float, bool]]:
    """Return frame counts solved from the file size: value, cost, and whether solved.

    Empty unless stated counts are saturated, wrap around, differ, or are missing.
    ``fitting_count`` is the number of frames that fit into the data.
    """
    stated_values = fields.frame_count
    if any(v.value == fitting_count for v in stated_values):
        return []
    cost = _total_cost(stated_values, fitting_count)
    if not stated_values or any(
        c.is_saturated and fitting_count > c.value for c in stated_values
    ):
        return [(fitting_count, cost + UNSTATED_COUNT_COST, False)]
    if any(v.can_wrap and v.cost(fitting_count) < v.weight for v in stated_values):
        return [(fitting_count, cost, False)]
    if _values_agree(stated_values):
        return []
    return [(fitting_count, cost + FITTED_FRAMES_COST, True)]


def _add_skipped_cost(layout: Layout, parameters_end: int, data: bytes) -> Layout:
    """Return a layout with the cost of nonzero bytes skipped before the first frame."""
    gap_start, gap_bytes = parameters_end, layout.data_offset - parameters_end
    if gap_bytes <= 0 or data.count(b"\0", gap_start, layout.data_offset) == gap_bytes:
        return layout
    return replace(layout, cost=layout.cost + NONZERO_GAP_COST)


def _add_trailing_cost(layout: Layout, data: bytes, end: int) -> Layout:
    """Return a layout with its trailing bytes before ``end``, and their cost added."""
    unused_bytes = end - layout.end
    is_padding = 0 <= unused_bytes < BLOCK_BYTES and end % BLOCK_BYTES == 0
    frame_bytes = layout.number_bytes * layout.numbers_per_frame
    if is_padding and data.count(b"\0", layout.end, end) == unused_bytes:
        # A last frame of zeros is probably padding.
        last_frame_start = layout.end - frame_bytes
        is_zero_frame = (
            0 < frame_bytes < BLOCK_BYTES - unused_bytes
            and data.count(b"\0", last_frame_start, layout.end) == frame_bytes
        )
        padding_cost = NONZERO_PADDING_COST if is_zero_frame else 0.0
        return replace(layout, cost=layout.cost + padding_cost)
    if unused_bytes == 0:
        return layout
    cost = layout.cost + (NONZERO_PADDING_COST if is_padding else TRAILING_BYTES_COST)
    return replace(layout, trailing_bytes=abs(unused_bytes), cost=cost)


def _choose_by_evidence(
    candidates: Sequence[Layout],
    truncated_layout: Layout | None,
    measure_evidence: Callable[[Layout], Evidence],
) -> LayoutResult:
    """Return the layout whose numbers look most like positions."""
    all_evidence = [measure_evidence(layout) for layout in candidates]
    min_outlier_fraction = min(evidence.outlier_fraction for evidence in all_evidence)
    # NaN is not measured.
    roughnesses = [
        evidence.roughness for evidence in all_evidence if evidence.roughness >= 0
    ]
    min_roughness = min(roughnesses, default=0.0)
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
    best_layout = scored_layouts[0]
    rival_layouts = [
        layout
        for layout in scored_layouts
        if layout.cost < best_layout.cost + DECISIVE_COST_GAP
        and _interpretation_key(layout) != _interpretation_key(best_layout)
    ]
    if rival_layouts:
        return LayoutResult(None, truncated_layout, (best_layout, *rival_layouts[:2]))
    return LayoutResult(best_layout, truncated_layout)


def _is_noise(layout: Layout, evidence: Evidence) -> bool:
    """Return whether the numbers of a layout look like noise, not like positions."""
    # A single point may be rough: its spread can be small.
    return evidence.outlier_fraction > MAX_OUTLIER_FRACTION or (
        layout.point_count > 1 and evidence.roughness > NOISE_ROUGHNESS
    )


def _interpretation_key(layout: Layout) -> tuple[int, ...]:
    """Return the counts of a layout that decide which numbers are coordinates."""
    return (
        layout.data_offset,
        layout.number_bytes,
        layout.point_count,
        layout.numbers_per_frame,
    )
