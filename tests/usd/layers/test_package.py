from __future__ import annotations

import zipfile
from pathlib import Path

import pytest
from pxr import Usd, UsdGeom, UsdSkel
from support.cli import animtool

from animtool.core.errors import AnimtoolError
from animtool.report.compare import compare
from animtool.scene.bake.bake import bake
from animtool.scene.bake.options import BakeOptions


def test_a_package_is_the_bake_in_one_file(walk: Path, tmp_path: Path) -> None:
    for name in "ab":
        (tmp_path / name).mkdir()
        bake(walk, tmp_path / name / "my walk.usdz", BakeOptions(bones=True))
    one, other = (tmp_path / name / "my walk.usdz" for name in "ab")
    assert one.read_bytes() == other.read_bytes()
    assert [path.name for path in one.parent.iterdir()] == [one.name]
    with zipfile.ZipFile(one) as archive:
        assert archive.testzip() is None
        (entry,) = archive.infolist()
        assert entry.filename == "my_walk.usdc"
        assert entry.compress_type == zipfile.ZIP_STORED
        # Readers map its files into memory, at multiples of 64 bytes.
        header = one.read_bytes()[entry.header_offset :][:30]
        sizes = int.from_bytes(header[26:28], "little")
        sizes += int.from_bytes(header[28:30], "little")
        assert (entry.header_offset + 30 + sizes) % 64 == 0
    assert compare(walk, one).within(1e-6, 1e-3, 1e-6)
    stage = Usd.Stage.Open(str(one))
    kinds = [prim.GetTypeName() for prim in stage.Traverse()]
    assert kinds.count("Skeleton") == kinds.count("SkelAnimation") == 1
    bones = stage.GetPrimAtPath("/my_walk/Rig/Bones") or next(
        prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)
    )
    assert UsdGeom.Imageable(bones).ComputePurpose() == UsdGeom.Tokens.default_
    assert UsdSkel.BindingAPI(bones).GetSkeletonRel().GetTargets()
    assert animtool("validate", one).code == 0


def test_systems_are_packed_too(root: Path, tmp_path: Path) -> None:
    output = tmp_path / "rope.usdz"
    bake(root / "samples/rope/rope.scene.yaml", output)
    stage = Usd.Stage.Open(str(output))
    curves = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.BasisCurves)]
    assert len(curves[0].GetAttribute("points").GetTimeSamples()) > 10
    assert [path.name for path in tmp_path.iterdir()] == [output.name]


@pytest.mark.parametrize(
    "options", [BakeOptions(form="split"), BakeOptions(chunk=4, deform=True)]
)
def test_what_is_several_files_is_no_package(
    walk: Path, tmp_path: Path, options: BakeOptions
) -> None:
    with pytest.raises(AnimtoolError) as caught:
        bake(walk, tmp_path / "walk.usdz", options)
    assert caught.value.code == "OUT004"
    assert not list(tmp_path.iterdir())


def test_meshes_of_rigs_have_display_colours(root: Path, tmp_path: Path) -> None:
    output = tmp_path / "speech.usda"
    bake(root / "samples/speech/speech.clip.yaml", output)
    stage = Usd.Stage.Open(str(output))
    meshes = [UsdGeom.Mesh(p) for p in stage.Traverse() if p.IsA(UsdGeom.Mesh)]
    colors = [mesh.GetDisplayColorAttr().Get() for mesh in meshes]
    assert all(len(color) == 1 for color in colors)
    assert len({tuple(color[0]) for color in colors}) == len(colors) > 1
