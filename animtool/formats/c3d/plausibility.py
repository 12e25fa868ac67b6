"""Measures whether numbers of a C3D file look like positions over frames."""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.formats.c3d.layout import Evidence, Layout
from animtool.formats.c3d.sections import Processor

# Number and length of the spans of consecutive frames that are examined.
SPAN_COUNT = 8
SPAN_FRAMES = 8
# Range of captured positions, in any unit; other magnitudes are not positions.
MAX_COORDINATE = 1e6
MIN_COORDINATE = 1e-12
MAX_STATUS_WORD = 32768.0


def measure_evidence(layout: Layout, data: bytes, processor: Processor) -> Evidence:
    """Measure whether a layout's numbers look like positions, in sampled frames."""
    if layout.point_count == 0:
        return Evidence(0.0, math.nan)
    span_frames = min(SPAN_FRAMES, layout.frame_count)
    first_frames = np.linspace(0, layout.frame_count - span_frames, SPAN_COUNT).astype(
        np.int64
    )
    frame_bytes = layout.number_bytes * layout.numbers_per_frame
    spans = []
    for first_frame in sorted(set(first_frames.tolist())):
        offset = layout.data_offset + frame_bytes * first_frame
        numbers = processor.rows(
            data[offset : offset + frame_bytes * span_frames],
            layout.number_bytes,
            layout.numbers_per_frame,
            4 * layout.point_count,
        )
        spans.append(numbers.reshape(span_frames, layout.point_count, 4))
    return _measure_spans(np.array(spans), layout.number_bytes)


def _measure_spans(spans: FloatArray, number_bytes: int) -> Evidence:
    """Return outlier fraction and roughness of spans of frames ``(R, L, M, 4)``."""
    positions, words = spans[..., :3], spans[..., 3]
    with np.errstate(invalid="ignore", over="ignore"):
        magnitudes = np.abs(positions)
        is_outlier = ~np.isfinite(words) | (words < -1.5) | (words > MAX_STATUS_WORD)
        if number_bytes == 4:
            is_out_of_range = ~(magnitudes < MAX_COORDINATE)
            is_tiny = (magnitudes > 0) & (magnitudes < MIN_COORDINATE)
            is_outlier |= (is_out_of_range | is_tiny).any(axis=-1)
        is_visible = ~is_outlier & (words > -0.5) & (magnitudes > 0).any(axis=-1)
    if not is_visible.any():
        return Evidence(float(is_outlier.mean()), 1.0)
    spread = float(np.sqrt(positions[is_visible].var(axis=0).sum()))
    is_visible_pair = is_visible[:, 1:] & is_visible[:, :-1]
    if not is_visible_pair.any() or spread == 0.0:
        return Evidence(float(is_outlier.mean()), math.nan)
    positions = np.where(is_visible[..., None], positions, 0.0)
    step_lengths = np.linalg.norm(np.diff(positions, axis=1), axis=-1)[is_visible_pair]
    return Evidence(float(is_outlier.mean()), float(step_lengths.mean()) / spread)
