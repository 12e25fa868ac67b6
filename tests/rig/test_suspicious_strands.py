"""Strands whose points go from tip to root."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from animtool.rig.file import load_rig

RIG = """\
rig: animtool/1
name: hero
units: {length: UNIT}
joints:
- {name: hips, type: free}
- {name: head, parent: hips, type: ball, translate: [0, 60, 0]}
meshes:
- name: body
  points: a.npz
  faces: a.npz
SKIN
attach:
- {name: "long 'hair'", kind: strands, joint: JOINT, points: a.npz#hair}
"""
SKIN = """\
  skin: {method: linear, joints: [hips, head], indices: a.npz, weights: a.npz}
"""


def codes(
    folder: Path, hair: np.ndarray, joint: str = "head", skin: str = SKIN
) -> list[str]:
    # A square at the height of the head, of 11 by 11 points 1 apart.
    x, z = np.meshgrid(np.arange(11.0), np.arange(11.0))
    points = np.stack([x.ravel(), np.full(121, 60.0), z.ravel()], axis=1)
    np.savez(
        folder / "a.npz",
        points=points,
        faces=np.array([[0, 1, 12, 11]]),
        indices=np.tile([0, 1], (121, 1)),
        weights=np.tile([0.1, 0.9], (121, 1)),
        hair=hair,
    )
    found = []
    for unit in ("cm", "m"):
        text = RIG.replace("UNIT", unit).replace("JOINT", joint)
        (folder / "a.rig.yaml").write_text(text.replace("SKIN\n", skin))
        rig = load_rig(folder / "a.rig.yaml")
        found.append([one.code for one in rig.notices if one.code == "RIG119"])
    assert found[0] == found[1]
    return found[0]


@pytest.mark.parametrize("count", [1, 40])
def test_reversed_strands(tmp_path: Path, count: int) -> None:
    roots = np.random.default_rng(1).integers(0, 11, (count, 3)) * [1.0, 0, 1]
    heights = np.linspace(60.1, 70, 8)[:, None] * [0, 1, 0]
    hair = roots[:, None] + heights
    assert codes(tmp_path, hair) == []
    assert codes(tmp_path, hair[:, ::-1]) == ["RIG119"]
    assert codes(tmp_path, hair[:, ::-1], skin="") == ["RIG119"]
    # Hair that is on the surface with both ends, or with none.
    flat = hair[:, ::-1].copy()
    flat[:, 0, 1] = 60.1
    assert codes(tmp_path, flat) == []
    assert codes(tmp_path, hair[:, ::-1] + [0, 20, 0]) == []
    # A joint below moves its surface with it.
    assert codes(tmp_path, hair[:, ::-1], "hips") == ["RIG119"]


def test_tips_on_another_part_of_the_body(tmp_path: Path) -> None:
    roots = np.arange(5.0)[:, None] * [1, 0, 1]
    hair = roots[:, None] + np.linspace(60.1, 70, 8)[:, None] * [0, 1, 0]
    skin = SKIN.replace("[hips, head]", "[head, hips]")
    assert codes(tmp_path, hair[:, ::-1], skin=skin) == []
