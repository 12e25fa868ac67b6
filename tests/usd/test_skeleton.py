from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom

from animtool.formats.bvh import read_bvh
from animtool.scene.bake import bake
from animtool.scene.options import BakeOptions
from animtool.usd.skeleton import bone_segments


def test_bones_face_outwards_and_belong_to_one_joint(
    walk: Path, tmp_path: Path
) -> None:
    output = tmp_path / "walk.usda"
    bake(walk, output, BakeOptions(bones=True))
    stage = Usd.Stage.Open(str(output))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/walk/Rig/Bones"))
    assert mesh.GetPurposeAttr().Get() == "guide"
    points = np.array(mesh.GetPointsAttr().Get(), float)
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 8, 3)
    for bone in faces:
        center = points[np.unique(bone)].mean(axis=0)
        a, b, c = (points[bone[:, i]] for i in range(3))
        outward = np.sum(np.cross(b - a, c - a) * (a - center), axis=-1)
        assert (outward > 0).all()
    joints = np.array(mesh.GetPrim().GetAttribute("primvars:skel:jointIndices").Get())
    assert (joints.reshape(-1, 6) == joints.reshape(-1, 6)[:, :1]).all()


def test_every_length_is_a_bone(walk: Path) -> None:
    rig = read_bvh(walk).collect().rig
    segments, owners = bone_segments(rig)
    tips = sum(len(joint.tips) for joint in rig.joints)
    lengths = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=-1)
    zero = sum(not np.any(j.translation) for j in rig.joints if j.parent >= 0)
    assert len(segments) == len(rig.joints) - len(rig.roots) + tips - zero
    assert lengths.min() > 0
    assert set(owners.tolist()) <= set(range(len(rig.joints)))
