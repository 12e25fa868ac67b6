"""BVH files: read to the end, and some of them baked."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
from support.bvh import random_rows, small_bvh

from animtool.cli.main import run as animtool
from animtool.core.errors import AnimtoolError
from animtool.formats.bvh.read import read_bvh
from fuzz.mutations import pick, spoil

ABOUT = "BVH files, read; one in twenty is baked too"

_NOT_FINITE = re.compile(r"[\s(,\[-](inf|nan)\b")


def make(folder: Path) -> Callable[[np.random.Generator], str]:
    """Return what runs a case in a folder."""
    path, output = folder / "take.bvh", folder / "take.usda"
    seeds = [small_bvh(random_rows(count)).encode() for count in (1, 2, 12)]

    def run(rng: np.random.Generator) -> str:
        path.write_bytes(spoil(rng, pick(rng, seeds)))
        if rng.random() < 0.05:
            return _baked(path, output)
        try:
            for block in read_bvh(path).blocks:
                assert np.isfinite(block.translations.values).all()
                assert np.isfinite(block.rotations.values).all()
        except AnimtoolError as error:
            return error.code
        return "read"

    return run


def _baked(path: Path, output: Path) -> str:
    output.unlink(missing_ok=True)
    code = animtool(["bake", str(path), "-o", str(output)])
    assert code in {0, 3}, f"exit {code}"
    assert output.exists() == (code == 0)
    if code:
        return "refused by bake"
    assert not _NOT_FINITE.search(output.read_text("utf-8")), "not finite"
    return "baked"
