"""Writes a take as text: a header, and rows formatted on demand."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from animtool import _kernels
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.motion.quaternion_order import python_order_warning
from animtool.motion.take import Take

CHUNK_ROWS = 4096


@dataclass(frozen=True, slots=True)
class TakeText:
    """Header, rows and notices of a text file that is about to be written."""

    header: Iterable[str]  # lines above the rows
    rows: Iterator[bytes]  # formatted on demand
    notices: list[Fault]  # warnings about data that the format cannot store

    @property
    def parts(self) -> Iterator[bytes]:
        """Byte chunks to write in order; can be iterated once."""
        yield "".join(f"{line}\n" for line in self.header).encode()
        yield from self.rows


def format_rows(
    values: FloatArray, decimals: Sequence[int], *, uses_tabs: bool = False
) -> Iterator[bytes]:
    """Yield formatted rows ``(F, C)`` in chunks, separated by blanks or tabs.

    ``decimals`` are the maximum decimals of each column.
    """
    decimal_counts = np.array(decimals, np.int64)
    for begin in range(0, len(values), CHUNK_ROWS):
        row_block = np.ascontiguousarray(values[begin : begin + CHUNK_ROWS])
        text = _kernels.format_bvh_rows(row_block, decimal_counts)
        yield text.replace(b" ", b"\t") if uses_tabs else text


def write_text(
    take: Take,
    path: Path | str,
    build_text: Callable[[Take], TakeText],
    *,
    overwrite: bool,
) -> list[Fault]:
    """Write a take as a text file; return notices about lost data."""
    from animtool.core.files.output import check_outputs, write_parts

    path = Path(path)
    check_outputs([path], [], overwrite=overwrite)
    take_text = build_text(take)
    write_parts(path, take_text.parts)
    order_notices = python_order_warning(take.rig, take.motion, str(path))
    return [*take_text.notices, *order_notices]
