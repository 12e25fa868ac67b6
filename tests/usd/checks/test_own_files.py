"""No finding on what animtool writes of the shipped rigs and samples."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.cli import animtool
from support.suite import some_quick

from animtool.usd.checks import check_layer

ROOT = Path(__file__).parents[3]
RIGS = sorted(ROOT.glob("rigs/*/*.rig.yaml"))
SAMPLES = sorted([*ROOT.glob("samples/*/*.clip.yaml"), *ROOT.glob("samples/*/*.bvh")])


def messages(path: Path) -> list[str]:
    return [str(fault) for fault in check_layer(path)]


@pytest.mark.parametrize(
    "rig", some_quick(RIGS, 3, 1), ids=lambda path: path.parent.name
)
def test_a_shipped_rig_has_no_finding(rig: Path, tmp_path: Path) -> None:
    output = tmp_path / "rig.usdc"
    assert animtool("convert", rig, output, "--physics").code == 0
    assert messages(output) == []
    assert messages(tmp_path / "rig.physics.usda") == []


@pytest.mark.parametrize(
    "sample", some_quick(SAMPLES, 3), ids=lambda path: path.parent.name
)
def test_a_shipped_sample_has_no_finding(sample: Path, tmp_path: Path) -> None:
    output = tmp_path / "sample.usdc"
    assert animtool("bake", sample, "-o", output).code == 0
    assert messages(output) == []


def test_layers_of_all_forms_have_no_finding(walk: Path, tmp_path: Path) -> None:
    split, layer = tmp_path / "split.usda", tmp_path / "layer.usdc"
    assert animtool("bake", walk, "-o", split, "--split").code == 0
    rig = tmp_path / "split.rig.usda"
    assert animtool("bake", walk, "-o", layer, "--rig-layer", rig).code == 0
    library = tmp_path / "library.usda"
    assert animtool("bake", walk, layer, "-o", library).code == 0
    stride = ROOT / "samples/stride/stride.clip.yaml"
    points = tmp_path / "points.usda"
    done = animtool("bake", stride, "-o", points, "--deform", "--chunk", "10")
    assert done.code == 0, done.stderr
    paths = [split, rig, tmp_path / "split.anim.usdc", layer, library, points]
    for path in paths:
        assert messages(path) == []
