from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool

from animtool.formats.bvh.write import write_bvh
from animtool.maths import so3
from animtool.motion import Channel, Motion
from animtool.scene.sources import open_source
from animtool.units import UpAxis, up_from_up


@pytest.fixture(scope="module")
def lying(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a walk along Z up, rest pose included."""
    walk = open_source(root / "samples/walk/walk.bvh").collect()
    turn = np.array(up_from_up(UpAxis.Z, UpAxis.Y))
    joints = tuple(
        replace(j, translation=tuple(so3.rotate(turn, np.array(j.translation))))
        for j in walk.rig.joints
    )
    places = so3.rotate(turn, walk.motion.translations.dense())
    turns = walk.motion.rotations.dense()
    turns = so3.multiply(so3.multiply(turn, turns), so3.conjugate(turn))
    motion = Motion(*(Channel.from_dense(v) for v in (places, so3.align_signs(turns))))
    path = tmp_path_factory.mktemp("lying") / "z.bvh"
    take = replace(walk, rig=replace(walk.rig, joints=joints), motion=motion)
    write_bvh(take, path)
    return path


@pytest.mark.parametrize("command", ["info", "bake"])
def test_a_take_along_z_is_named(
    command: str, lying: Path, root: Path, tmp_path: Path
) -> None:
    output = ["-o", str(tmp_path / "a.usdc")] if command == "bake" else []
    done = animtool(command, str(lying), *output)
    assert done.code == 0, done.stderr
    assert done.stderr.count("MOT214") == 1
    assert "--up Z" in done.stderr
    output = ["-o", str(tmp_path / "b.usdc")] if command == "bake" else []
    stated = animtool(command, str(lying), "--up", "Z", *output)
    assert (stated.code, stated.stderr.count("MOT214")) == (0, 0)
    output = ["-o", str(tmp_path / "c.usdc")] if command == "bake" else []
    upright = animtool(command, str(root / "samples/walk/walk.bvh"), *output)
    assert (upright.code, upright.stderr.count("MOT214")) == (0, 0)
