"""Whether numbers of a C3D file look like positions over frames."""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.formats.c3d.layout import (
    Evidence,
    Layout,
)
from animtool.formats.c3d.sections import (
    Processor,
)

# Number and length of the runs of consecutive frames that are examined.
SAMPLED_RUNS = 8
RUN_FRAMES = 8
# Range of captured positions, in any unit; other magnitudes are not positions.
MAX_COORDINATE = 1e6
MIN_COORDINATE = 1e-12
MAX_WORD = 32768.0


def evidence_of(layout: Layout, data: bytes, processor: Processor) -> Evidence:
    """Return how plausible a layout's numbers are as positions over frames."""
    if layout.points == 0:
        return Evidence(0.0, math.nan)
    length = min(RUN_FRAMES, layout.frames)
    begins = np.linspace(0, layout.frames - length, SAMPLED_RUNS).astype(np.int64)
    size = layout.width * layout.row
    runs = []
    for begin in sorted(set(begins.tolist())):
        at = layout.begin + size * begin
        run_bytes = data[at : at + size * length]
        point_numbers = 4 * layout.points
        rows = processor.rows(run_bytes, layout.width, layout.row, point_numbers)
        runs.append(rows.reshape(length, layout.points, 4))
    return _evidence(np.array(runs), layout.width)


def _evidence(runs: FloatArray, width: int) -> Evidence:
    """Return the plausibility of runs of frames ``(R, L, M, 4)``."""
    positions, words = runs[..., :3], runs[..., 3]
    with np.errstate(invalid="ignore", over="ignore"):
        sizes = np.abs(positions)
        invalid_word = ~np.isfinite(words) | (words < -1.5) | (words > MAX_WORD)
        if width == 4:
            out_of_range = ~(sizes < MAX_COORDINATE)
            tiny = (sizes > 0) & (sizes < MIN_COORDINATE)
            invalid_word |= (out_of_range | tiny).any(axis=-1)
        visible = ~invalid_word & (words > -0.5) & (sizes > 0).any(axis=-1)
    if not visible.any():
        return Evidence(float(invalid_word.mean()), 1.0)
    spread = float(np.sqrt(positions[visible].var(axis=0).sum()))
    visible_pair = visible[:, 1:] & visible[:, :-1]
    if not visible_pair.any() or spread == 0.0:
        return Evidence(float(invalid_word.mean()), math.nan)
    positions = np.where(visible[..., None], positions, 0.0)
    steps = np.linalg.norm(np.diff(positions, axis=1), axis=-1)[visible_pair]
    return Evidence(float(invalid_word.mean()), float(steps.mean()) / spread)
