"""Finds rows of zeros between rows of motion, as lost tracking leaves them."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, Severity, counted
from animtool.core.record import dataclass
from animtool.maths.runs import runs

# The step to a row of zeros is longer than this multiple of the step before it [1]: a
# motion that passes through zeros arrives there in steps like the others.
MIN_JUMP_RATIO = 5.0
# With fewer values other than 0 in the row before, a wheel or a car may jump from 360
# degrees to 0 [1].
MIN_NONZERO_VALUES = 6
MAX_LISTED_RUNS = 10


@dataclass(slots=True)
class ZeroRun:
    """A run of rows of zeros: first and last row index, and the line of the first."""

    first: int
    last: int
    line: int


class ZeroRows:
    """Collects the runs of zeros in a file's rows, block by block.

    The zeros a file begins with, and a single row of them at its end, are poses.
    """

    def __init__(self) -> None:
        self._runs: list[ZeroRun] = []
        self._row_count = 0
        self._tail = np.zeros((0, 0))

    def add(self, rows: FloatArray, lines: IntArray) -> None:
        """Add rows ``(F, C)``, with their line numbers ``(F,)``."""
        is_zero = np.logical_not(rows.any(axis=1))
        for start, end in runs(is_zero):
            first, last = self._row_count + start, self._row_count + end - 1
            if self._runs and self._runs[-1].last == first - 1:
                self._runs[-1].last = last
            elif self._is_jump(rows[max(0, start - 2) : start]):
                self._runs.append(ZeroRun(first, last, int(lines[start])))
        self._row_count += len(rows)
        self._tail = self._last_rows(rows[-2:])

    def _last_rows(self, rows: FloatArray) -> FloatArray:
        """Return rows of this block, after those of the previous one if too few."""
        missing_count = min(2 - len(rows), len(self._tail))
        if missing_count <= 0:
            return rows.copy()
        return np.concatenate([self._tail[-missing_count:], rows])

    def _is_jump(self, rows_before: FloatArray) -> bool:
        """Return whether the step from the rows before to zeros is a jump."""
        rows = self._last_rows(rows_before)
        if len(rows) < 2 or np.count_nonzero(rows[1]) < MIN_NONZERO_VALUES:
            return False
        step = float(np.nanmax(np.abs(rows[1] - rows[0]), initial=0.0))
        return float(np.nanmax(np.abs(rows[1]), initial=0.0)) > MIN_JUMP_RATIO * step

    def warnings(self, path: str) -> list[Fault]:
        """Return a warning about the runs (TAKE013)."""
        zero_runs = [
            run
            for run in self._runs
            if run.first < run.last or run.last < self._row_count - 1
        ]
        if not zero_runs:
            return []
        listed_runs = zero_runs[:MAX_LISTED_RUNS]
        texts = [
            f"{run.first + 1}-{run.last + 1}"
            if run.last > run.first
            else f"{run.last + 1}"
            for run in listed_runs
        ]
        ellipsis = " …" if len(zero_runs) > len(listed_runs) else ""
        row_count = sum(run.last - run.first + 1 for run in zero_runs)
        verb = "is" if row_count == 1 else "are"
        message = (
            f"{counted(row_count, 'row')} within the motion {verb} all zeros "
            f"({', '.join(texts)}{ellipsis}): tracking was lost there"
        )
        hint = "write nan for these zeros to interpolate them, or cut the take there"
        if len(zero_runs) == 1 and zero_runs[0].last == self._row_count - 1:
            hint = "delete these rows"
        lines = tuple(run.line for run in listed_runs)
        return [Fault("TAKE013", message, path, lines, hint, Severity.WARNING)]
