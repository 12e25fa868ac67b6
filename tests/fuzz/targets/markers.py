"""Files of markers: read, or refused with a code."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from support.c3d_bytes import DEC, INTEL, SGI, C3dFile

from animtool.core.clock import Clock
from animtool.core.errors import AnimtoolError
from animtool.formats.marker_files import open_markers, write_markers
from animtool.motion.markers import Markers
from fuzz.mutations import pick, spoil

ABOUT = "C3D, TRC and npz files of markers, read"


def make(folder: Path) -> Callable[[np.random.Generator], str]:
    """Return what runs a case in a folder."""
    points = np.random.default_rng(5).normal(size=(5, 3, 3))
    points[2, 1] = np.nan
    names = ("A", "B", "C")
    seeds = [
        (".c3d", C3dFile(points, list(names), scale=s, processor=p).build())
        for s in (-0.1, 0.1)
        for p in (INTEL, DEC, SGI)
    ]
    markers = Markers(names, Clock(120, 1, 1, 5), points)
    for suffix in (".trc", ".npz", ".c3d"):
        path = folder / f"seed{suffix}"
        write_markers(markers, path, overwrite=True)
        seeds.append((suffix, path.read_bytes()))

    def run(rng: np.random.Generator) -> str:
        suffix, data = pick(rng, seeds)
        path = folder / f"take{suffix}"
        path.write_bytes(spoil(rng, data))
        try:
            found = open_markers(path)
        except AnimtoolError as error:
            return error.code
        assert not np.isinf(found.positions).any()
        return "read"

    return run
