"""Signs of quaternions in what is written, whichever way it is written."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Vt
from support.small_takes import small

from animtool.core.shot import FrameRange
from animtool.maths import so3
from animtool.motion.motion import Channel
from animtool.motion.take import Take, TakeStream
from animtool.scene.bake.bake import bake
from animtool.scene.bake.options import BakeOptions
from animtool.scene.sources.open import OpenTake

BLOCK = 3
WAYS = {
    "stage": BakeOptions(),
    "split": BakeOptions(form="split"),
    "root": BakeOptions(root_motion=True),
    "slow": BakeOptions(fps=Fraction(8)),
    "range": BakeOptions(start=Fraction(1), frame_range=FrameRange(1, 12, 3)),
    "samples": BakeOptions(samples=(Fraction(-1, 4), Fraction(1, 4))),
    "kept": BakeOptions(fps=Fraction(8), keep_samples=True),
    "sparse": BakeOptions(sparse=True),
    "reduced": BakeOptions(reduce=0.05),
}


def flipped(take: Take, seed: int) -> Iterator:
    """Yield blocks of wide rotations, the signs of any quaternion at random."""
    rng = np.random.default_rng(seed)
    shape = take.motion.rotations.values.shape
    wide = so3.multiply(
        take.motion.rotations.values, so3.exp(rng.normal(0, 1.2, (*shape[:2], 3)))
    )
    wide *= rng.choice([-1.0, 1.0], shape[:2])[..., None]
    channel = Channel(take.motion.rotations.rest, take.motion.rotations.animated, wide)
    motion = replace(take.motion, rotations=channel)
    for first in range(0, take.clock.count, BLOCK):
        yield motion.select(slice(first, first + BLOCK))


def written(take: Take, seed: int, output: Path, options: BakeOptions) -> Path:
    """Bake a take that arrives in such blocks."""
    source = output.with_suffix(".bvh")
    source.touch()
    stream = replace(TakeStream.of(take), blocks=flipped(take, seed))
    bake(OpenTake(source, stream), output, options)
    return output.with_suffix(".anim.usdc") if options.form == "split" else output


def sign_flips(path: Path) -> int:
    """Return how many quaternions are beyond a right angle from the one before."""
    layer, flips = Sdf.Layer.FindOrOpen(str(path)), 0

    def count(at: Sdf.Path) -> None:
        nonlocal flips
        spec = layer.GetAttributeAtPath(at) if at.IsPropertyPath() else None
        if spec is None or "quat" not in str(spec.typeName):
            return
        rows = [layer.QueryTimeSample(at, t) for t in layer.ListTimeSamplesForPath(at)]
        found = np.array([_numbers(row) for row in rows])
        flips += int(((found[1:] * found[:-1]).sum(axis=-1) < 0).sum())

    layer.Traverse("/", count)
    return flips


def _numbers(row: object) -> list[list[float]]:
    several = row if hasattr(row, "__len__") else [row]
    return [[q.GetReal(), *q.GetImaginary()] for q in several]


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("way", WAYS)
def test_signs_continue_in_what_is_written(way: str, seed: int, tmp_path: Path) -> None:
    path = written(small(14), seed, tmp_path / "take.usdc", WAYS[way])
    assert sign_flips(path) == 0


@pytest.mark.parametrize("seed", [1, 2])
def test_signs_continue_in_a_layer_over_a_split_bake(seed: int, tmp_path: Path) -> None:
    written(small(14), seed, tmp_path / "rig.usda", BakeOptions(form="split"))
    rig = tmp_path / "rig.rig.usda"
    options = BakeOptions(rig_layer=rig, fps=Fraction(8))
    assert sign_flips(written(small(14), seed, tmp_path / "layer.usdc", options)) == 0


def test_a_library_has_takes_of_continuous_signs(tmp_path: Path) -> None:
    sources = {tmp_path / "a.bvh": small(9), tmp_path / "b.bvh": small(7)}
    opened = []
    for path, take in sources.items():
        path.touch()
        stream = replace(TakeStream.of(take), blocks=flipped(take, 4))
        opened.append(OpenTake(path, stream))
    bake(opened, tmp_path / "library.usdc")
    assert sign_flips(tmp_path / "library.usdc") == 0


def test_the_count_of_flips_sees_one(tmp_path: Path) -> None:
    path = written(small(14), 1, tmp_path / "take.usda", BakeOptions())
    layer = Sdf.Layer.FindOrOpen(str(path))
    at = "/small/Rig/Anim.rotations"
    row = layer.QueryTimeSample(at, 5.0)
    layer.SetTimeSample(at, 5.0, Vt.QuatfArray([-q for q in row]))
    layer.Save()
    assert sign_flips(path) > 0
