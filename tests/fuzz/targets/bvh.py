"""BVH files: read to the end, and some of them baked."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from support.bvh import random_rows, small_bvh

from animtool.errors import AnimtoolError
from animtool.formats.bvh.read import read_bvh
from fuzz.mutations import pick, spoil

ABOUT = "BVH files, read; every tenth is baked too"


def make(folder: Path) -> Callable[[np.random.Generator], str]:
    """Return what runs a case in a folder."""
    path = folder / "take.bvh"
    seeds = [small_bvh(random_rows(count)).encode() for count in (1, 2, 12)]

    def run(rng: np.random.Generator) -> str:
        path.write_bytes(spoil(rng, pick(rng, seeds)))
        try:
            for block in read_bvh(path).blocks:
                assert np.isfinite(block.translations.values).all()
                assert np.isfinite(block.rotations.values).all()
        except AnimtoolError as error:
            return error.code
        return "read"

    return run
