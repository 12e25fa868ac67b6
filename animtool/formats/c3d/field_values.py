"""Collects the layout values that header and parameters of a C3D file state."""

from __future__ import annotations

import math
from collections.abc import Iterable

from animtool.core.record import dataclass
from animtool.formats.c3d.sections import BLOCK_BYTES, Sections

# Saturated 16-bit counts: a take that states one of these may be longer.
SATURATED_COUNTS = (32767, 65535)
WORD_RANGE = 65536


@dataclass(frozen=True, slots=True)
class FieldValue:
    """A value of a layout quantity, stated by one field of the file."""

    source: str  # the field, as named in messages
    value: int  # the stated value
    # Cost of a layout that contradicts it; values below 0.5 are hints, not mentioned in
    # messages.
    weight: float
    is_saturated: bool = False  # whether the field cannot state a larger value
    # Whether the field has 16 bits and wraps to 0 for longer takes.
    can_wrap: bool = False

    def cost(self, value: int) -> float:
        """Return the cost of a layout value; 0 if it agrees with the stated value."""
        if value == self.value or (self.is_saturated and value > self.value):
            return 0.0
        has_wrapped = value >= WORD_RANGE and (value - self.value) % WORD_RANGE == 0
        if self.can_wrap and has_wrapped:
            return 0.25
        return self.weight


@dataclass(frozen=True, slots=True)
class FieldValues:
    """All layout values that a file states, by quantity."""

    data_offset: tuple[FieldValue, ...]  # offset of the first frame [byte]
    # Size of a number [byte]: 2 for integers, 4 for floats.
    number_bytes: tuple[FieldValue, ...]
    point_count: tuple[FieldValue, ...]  # points per frame
    # Analogue values per frame, all samples of all channels.
    analog_count: tuple[FieldValue, ...]
    frame_count: tuple[FieldValue, ...]  # number of frames
    # Further analogue counts to try that no field states.
    other_analog_counts: tuple[int, ...] = ()
    # End of the parameters [byte]; the data start there or later.
    parameters_end: int = 0


def collect_field_values(sections: Sections) -> FieldValues:
    """Return all layout values that a file states."""
    analog_counts, other_analog_counts = _stated_analog_counts(sections)
    return FieldValues(
        tuple(_stated_offsets(sections)),
        tuple(_stated_number_sizes(sections)),
        tuple(_stated_point_counts(sections)),
        analog_counts,
        tuple(_stated_frame_counts(sections)),
        other_analog_counts,
        BLOCK_BYTES * (sections.end_block - 1),
    )


def unsigned_word(sections: Sections, group: str, name: str) -> int | None:
    """Return a parameter's unsigned 16-bit number, or a larger one stored as float."""
    value = sections.number(group, name)
    if value is None or not math.isfinite(value):
        return None
    return int(value) if value >= WORD_RANGE else int(value) & (WORD_RANGE - 1)


def trial_frame_range(sections: Sections) -> tuple[int | None, int | None]:
    """Return the first and last frame numbers of the trial."""
    first_frame, last_frame = (
        _join_words(sections.numbers("TRIAL", f"ACTUAL_{name}_FIELD"))
        for name in ("START", "END")
    )
    return first_frame, last_frame


def _join_words(low_and_high_words: list[float]) -> int | None:
    """Return a number stored as two 16-bit words, low word first."""
    if not low_and_high_words or not all(map(math.isfinite, low_and_high_words)):
        return None
    low_word, high_word = ([*low_and_high_words, 0.0])[:2]
    return (int(low_word) & 0xFFFF) + ((int(high_word) & 0xFFFF) << 16)


def _stated_offsets(sections: Sections) -> Iterable[FieldValue]:
    candidates = (
        ("header word 9", sections.header.data_block, 1.0),
        ("POINT:DATA_START", unsigned_word(sections, "POINT", "DATA_START"), 0.75),
        # Without parameters this is the end of the header.
        ("the end of the parameters", sections.end_block, 0.25),
    )
    for source, block, weight in candidates:
        if block is not None and block >= 2:
            yield FieldValue(source, BLOCK_BYTES * (block - 1), weight)


def _stated_number_sizes(sections: Sections) -> Iterable[FieldValue]:
    candidates = (
        ("header scale", sections.header.scale, 0.75),
        ("POINT:SCALE", sections.number("POINT", "SCALE"), 1.0),
    )
    for source, scale, weight in candidates:
        if scale is not None and math.isfinite(scale) and scale != 0:
            yield FieldValue(source, 4 if scale < 0 else 2, weight)


def _stated_point_counts(sections: Sections) -> Iterable[FieldValue]:
    yield FieldValue("header word 2", sections.header.point_count, 1.0)
    used_points = unsigned_word(sections, "POINT", "USED")
    if used_points is not None:
        yield FieldValue("POINT:USED", used_points, 1.0)
    labels = sections.texts("POINT", "LABELS")
    while labels and not labels[-1]:
        labels.pop()
    if labels:
        # Many writers only label the first 255 points.
        yield FieldValue(
            "POINT:LABELS", len(labels), 0.25, is_saturated=len(labels) == 255
        )


def _stated_analog_counts(
    sections: Sections,
) -> tuple[tuple[FieldValue, ...], tuple[int, ...]]:
    """Return stated analogue values per frame, and further counts to try."""
    header_count = sections.header.analog_count
    samples_per_frame = sections.header.samples_per_frame
    stated_counts = [FieldValue("header word 3", header_count, 1.0)]
    used_channels = unsigned_word(sections, "ANALOG", "USED")
    rates = [sections.number(group, "RATE") for group in ("ANALOG", "POINT")]
    samples_per_frame_from_rates = _analog_samples_per_frame(
        rates[0], rates[1] or sections.header.rate
    )
    if used_channels == 0:
        stated_counts.append(FieldValue("ANALOG:USED", 0, 0.75))
    elif used_channels is not None:
        word_source = "ANALOG:USED x header word 10"
        rate_source = "ANALOG:USED x ANALOG:RATE / POINT:RATE"
        if samples_per_frame:
            stated_counts.append(
                FieldValue(word_source, used_channels * samples_per_frame, 0.75)
            )
        if samples_per_frame_from_rates:
            stated_counts.append(
                FieldValue(
                    rate_source, used_channels * samples_per_frame_from_rates, 0.75
                )
            )
    channel_counts = {
        used_channels or 0,
        header_count,
        len(sections.texts("ANALOG", "LABELS")),
    }
    sample_counts = {1, samples_per_frame, samples_per_frame_from_rates or 0}
    counts = {0, *(c * f for c in channel_counts for f in sample_counts)}
    return tuple(stated_counts), tuple(
        sorted(counts - {v.value for v in stated_counts})
    )


def _analog_samples_per_frame(
    analog_rate: float | None, point_rate: float | None
) -> int | None:
    """Return analogue samples per frame from the rates; None if not an integer."""
    if not analog_rate or not point_rate or not point_rate > 0:
        return None
    ratio = analog_rate / point_rate
    is_in_range = 0.5 < ratio < WORD_RANGE
    is_integer = is_in_range and abs(ratio - round(ratio)) < 1e-3 * ratio
    return round(ratio) if is_integer else None


def _stated_frame_counts(sections: Sections) -> Iterable[FieldValue]:
    header = sections.header
    if not (header.first_frame == 0 and header.last_frame == 0):
        count = (header.last_frame - header.first_frame + 1) % WORD_RANGE
        is_saturated = (
            header.last_frame in SATURATED_COUNTS or count in SATURATED_COUNTS
        )
        if count:
            yield FieldValue(
                "header words 4 and 5", count, 1.0, is_saturated, can_wrap=True
            )
    start, end = trial_frame_range(sections)
    if end is not None:
        count = end - (header.first_frame if start is None else start) + 1
        is_saturated = end in SATURATED_COUNTS or count in SATURATED_COUNTS
        if count > 0:
            yield FieldValue("TRIAL:ACTUAL_END_FIELD", count, 0.5, is_saturated)
    long_frames = sections.number("POINT", "LONG_FRAMES")
    if long_frames is not None and math.isfinite(long_frames) and long_frames >= 1:
        count = int(long_frames)
        yield FieldValue("POINT:LONG_FRAMES", count, 0.5, count in SATURATED_COUNTS)
    frame_count = unsigned_word(sections, "POINT", "FRAMES")
    if frame_count:
        is_saturated = frame_count in SATURATED_COUNTS
        yield FieldValue(
            "POINT:FRAMES",
            frame_count,
            0.5,
            is_saturated,
            can_wrap=frame_count < WORD_RANGE,
        )
