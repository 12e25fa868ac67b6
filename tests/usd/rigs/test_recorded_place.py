"""What is written from a placed source stands over its rig once."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from support.placed import (
    composed,
    op_text,
    over,
    stage_text,
)
from support.suite import some_quick

from animtool import open_source
from animtool.core.errors import FormatError
from animtool.scene.bake.bake import bake
from animtool.scene.bake.options import BakeOptions
from animtool.scene.convert.takes import convert
from animtool.scene.sources.open import SourceOptions

WRITTEN = ("usda", "bvh")
PLACED = [
    pytest.param(where, kind, moves, up, suffix)
    for where, kind, moves, up, suffix in itertools.product(
        ("set", "char", "skel"), ("translate", "all"), (False, True), "YZ", WRITTEN
    )
    # A size that changes is no length of a rest pose, and a BVH states no up axis.
    if not (moves and kind == "all") and (suffix, up) != ("bvh", "Z")
]


@pytest.mark.parametrize(
    ("where", "kind", "moves", "up", "suffix"), some_quick(PLACED, 3)
)
def test_what_was_written_from_a_placed_source_rides_on_it_once(
    tmp_path: Path, where: str, kind: str, moves: bool, up: str, suffix: str
) -> None:
    source, written = tmp_path / "source.usda", tmp_path / f"written.{suffix}"
    ops = op_text(kind, moves, 0.01).replace("(90, 20, 10)", "(4, 20, 10)")
    source.write_text(stage_text(where, ops, up=up))
    if suffix == "bvh":
        convert(source, written)
    else:
        bake(source, written)
    layer = tmp_path / "layer.usda"
    bake(written, layer, BakeOptions(rig_layer=source))
    found = composed(over(layer, source))
    np.testing.assert_allclose(found, composed(source), atol=2e-6)


@pytest.mark.parametrize("up", "YZ")
@pytest.mark.parametrize("where", ["set", "char", "skel"])
def test_a_place_that_a_file_records_can_be_dropped(
    tmp_path: Path, where: str, up: str
) -> None:
    source, written = tmp_path / "source.usda", tmp_path / "written.usda"
    ops = op_text("all", False, 0.01).replace("(90, 20, 10)", "(4, 20, 10)")
    source.write_text(stage_text(where, ops, up=up))
    bake(source, written)
    drop = BakeOptions(placement="drop")
    report = bake(written, tmp_path / "one.usda", drop)
    assert "USD124" in [notice.code for notice in report.notices]
    bake(source, tmp_path / "other.usda", drop)
    one, other = (composed(tmp_path / f"{name}.usda") for name in ("one", "other"))
    np.testing.assert_allclose(one, other, atol=2e-6)
    # Nothing is left of it: it is recorded no more.
    assert open_source(tmp_path / "one.usda").rig.placement is None


@pytest.mark.parametrize("up", "YZ")
def test_each_take_of_a_library_has_its_own_place(tmp_path: Path, up: str) -> None:
    source, plain, other = (tmp_path / f"{name}.usda" for name in ("s", "p", "o"))
    ops = op_text("all", False, 0.01).replace("(90, 20, 10)", "(4, 20, 10)")
    source.write_text(stage_text("set", ops, up=up))
    plain.write_text(stage_text(up=up, size=2.0))
    ops = ops.replace("(300.0, 100.0, 0)", "(-50, 20, 10)")
    assert "(-50, 20, 10)" in ops
    other.write_text(stage_text("char", ops, up=up))
    library = tmp_path / "library.usda"
    bake([source, plain, other], library, BakeOptions(form="library"))
    for path in (source, plain, other):
        reading = SourceOptions(take=path.stem)
        for name, given, options in (
            ("take", library, BakeOptions(source=reading, rig_layer=source)),
            ("own", path, BakeOptions(rig_layer=source)),
        ):
            bake(given, tmp_path / f"{path.stem}-{name}.usda", options)
        found, truth = (
            composed(over(tmp_path / f"{path.stem}-{name}.usda", source))
            for name in ("take", "own")
        )
        np.testing.assert_allclose(found, truth, atol=2e-6)


def test_a_malformed_record_of_a_place_is_refused(tmp_path: Path) -> None:
    source, written = tmp_path / "source.usda", tmp_path / "written.usda"
    source.write_text(stage_text("set", op_text("translate", False, 0.01)))
    bake(source, written)
    text = written.read_text()
    assert text.count("quatd rotate = (1, 0, 0, 0)") == 2
    written.write_text(text.replace("rotate = (1, 0, 0, 0)", "rotate = (3, 0, 0, 0)"))
    with pytest.raises(FormatError) as caught:
        open_source(written)
    assert caught.value.code == "USD007"
