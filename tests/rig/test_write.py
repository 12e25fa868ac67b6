"""A rig written and read again is the same rig."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from animtool.rig.file import load_rig
from animtool.rig.write import rig_text

RIGS = sorted((Path(__file__).parents[2] / "rigs").glob("*/*.rig.yaml"))


@pytest.mark.parametrize("path", RIGS, ids=lambda path: path.stem)
def test_shipped_rigs_come_back(path: Path, tmp_path: Path) -> None:
    rig = load_rig(path)
    again = tmp_path / "again.rig.yaml"
    again.write_text(rig_text(rig), "utf-8")
    for arrays in path.parent.glob("*.npz"):
        shutil.copy(arrays, tmp_path)
    back = load_rig(again)
    assert back.names == rig.names
    assert back.controls == rig.controls
    assert (back.chains, back.colliders) == (rig.chains, rig.colliders)
    assert [replace(a, pins=None, points=None) for a in back.attach] == [
        replace(a, pins=None, points=None) for a in rig.attach
    ]
    for ours, theirs in zip(rig.joints, back.joints, strict=True):
        assert ours == theirs
    assert rig_text(back) == rig_text(rig)


def test_meshes_shapes_and_bind_come_back(tmp_path: Path) -> None:
    points = np.zeros((4, 3))
    np.savez(
        tmp_path / "body.npz",
        points=points,
        faces=np.zeros((2, 3), np.int64),
        indices=np.zeros((4, 1), np.int64),
        weights=np.ones((4, 1)),
        wide=points,
        half=points,
    )
    (tmp_path / "a.rig.yaml").write_text(
        """rig: animtool/1
name: "1"
units: {length: in, angle: rad}
joints:
- {name: "a b", type: free, translate: [1, 2.5, 0]}
- {name: wheel, parent: "a b", type: pin, axis: [1, 1, 0], limits: [-1.5, 2]}
bind: {wheel: {translate: [0, 0, 3]}}
meshes:
- {name: body, points: body.npz, faces: body.npz,
   skin: {joints: [wheel], indices: body.npz, weights: body.npz}}
shapes:
- {name: wide, mesh: body, deltas: body.npz#wide,
   inbetweens: [{at: .5, deltas: body.npz#half}]}
- {name: both, mesh: body, deltas: body.npz#wide, combine: [wide]}
""",
        "utf-8",
    )
    rig = load_rig(tmp_path / "a.rig.yaml")
    (tmp_path / "b.rig.yaml").write_text(rig_text(rig), "utf-8")
    assert load_rig(tmp_path / "b.rig.yaml") == rig
