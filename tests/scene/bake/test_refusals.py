"""What a bake refuses before the work, `validate` refuses too, and nothing else."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from support.cli import animtool

TAKE = "source: {file: walk.bvh, units: cm}\n"
SYSTEM = (
    "range: [1, 2]\nsystems:\n"
    "- rope: {name: cord, from: [0, 1, 0], to: [1, 1, 0], segments: 4, pins: [0]}\n"
)
OUTPUTS = [
    "{file: o.usdc}",
    "{file: o.mot}",
    "{file: o.foo}",
    "{file: o.rig.yaml}",
    "{file: o.usdc, as: split}",
    "{file: o.usdz, as: split}",
    "{file: o.usdz, chunk: 2}",
    "{file: o.usdc, as: layer}",
    "{file: o.usdc, bones: true}",
    "{file: o.usdc, deform: true}",
    "{file: o.usdc, deform: true, bones: true}",
    "{file: o.usdc, velocities: true}",
    "{file: o.usdc, reduce: 1mm, samples: [0, .5]}",
    "{file: o.usdc, prim_path: no path}",
    "{file: o.usdc, rig_layer: bare.usda}",
    "{file: o.usdc, keep_stopped: true}",
    "[{file: a.usdc}, {file: a.usdc}]",
    "[{file: a.usdc, bones: true}, {file: b.mot}]",
]


@pytest.mark.parametrize("body", [TAKE, SYSTEM], ids=["take", "system"])
@pytest.mark.parametrize("output", OUTPUTS)
def test_validate_refuses_what_a_bake_refuses(
    output: str, body: str, walk: Path, tmp_path: Path
) -> None:
    shutil.copy(walk, tmp_path / "walk.bvh")
    (tmp_path / "bare.usda").write_text('#usda 1.0\ndef Xform "a" {}\n')
    scene = tmp_path / "s.scene.yaml"
    scene.write_text(f"scene: animtool/1\n{body}output: {output}\n")
    checked = animtool("validate", scene)
    baked = animtool("bake", scene)
    assert (checked.code != 0) == (baked.code != 0), checked.stdout + baked.stderr
