"""TRC files: read by their Time and by a rate, written and read again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from animtool.core.errors import AnimtoolError
from animtool.formats.trc.read import read_trc
from animtool.formats.trc.write import write_trc
from fuzz.mutations import pick, spoil

ABOUT = "TRC files of markers: read, written and read again"

HEAD = (
    "PathFileType\t4\t(X/Y/Z)\ta.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\n"
    "100\t100\t5\t2\tmm\n"
    "Frame#\tTime\tLASI\t\t\tRASI\t\t\n"
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n\n"
)
# A gap, a marker that is missing, further columns, other rates and uneven times.
TIMES = (
    "1 0.00,2 0.01,3 0.02,9 0.08,10 0.09",
    "1 0.00,2 0.02,3 0.04,4 0.06,5 0.08",
    "101 0.000,102 0.009,103 0.021,104 0.030,105 0.062",
)


def _seeds() -> list[bytes]:
    seeds = []
    for times in TIMES:
        rows = []
        for i, row in enumerate(times.split(",")):
            cells = [*row.split(), *[f"{100 + i}.5"] * 5, "" if i == 2 else "7.25"]
            rows.append("\t".join([*cells, *["1.5"] * 3 * (i % 2)]))
        text = HEAD + "\n".join(rows) + "\n"
        seeds += [text, text.replace("\t", ","), text.replace("\t", ";")]
        seeds += [
            text.replace(".", ","),
            text.replace("\t\t\t", " ").replace("\t", " "),
        ]
    return [text.encode() for text in seeds]


def make(folder: Path) -> Callable[[np.random.Generator], str]:
    """Return what runs a case in a folder."""
    path, written = folder / "take.trc", folder / "written.trc"
    seeds = _seeds()

    def run(rng: np.random.Generator) -> str:
        path.write_bytes(spoil(rng, pick(rng, seeds)))
        try:
            markers = read_trc(path, fps=60 if rng.integers(4) == 0 else None)
            assert not np.isinf(markers.positions).any()
            assert len(markers.positions) == markers.clock.count
            write_trc(markers, written, overwrite=True)
            again = read_trc(written)
        except AnimtoolError as error:
            return error.code
        assert again.positions.shape == markers.positions.shape
        return "read"

    return run
