from __future__ import annotations

from pathlib import Path

import numpy as np
from preview.pages import ReadPage
from support.skinned_rig import write_pair

from animtool.preview.build import make_page
from animtool.preview.options import PreviewOptions
from animtool.scene.bake.bake import bake

PLAIN = PreviewOptions(findings=False)


def hidden_stage(folder: Path, *, mesh: bool) -> Path:
    """Return a stage whose character, or a mesh of it, is hidden in two frames."""
    from pxr import Usd, UsdGeom, UsdSkel

    baked = folder / "hero.usda"
    bake(write_pair(folder), baked)
    stage = Usd.Stage.Open(str(baked))
    kind = UsdGeom.Mesh if mesh else UsdSkel.Root
    prim = next(p for p in stage.Traverse() if p.IsA(kind))
    attr = UsdGeom.Imageable(prim).CreateVisibilityAttr()
    first = stage.GetStartTimeCode()
    for frame, word in ((0, "inherited"), (1, "invisible"), (3, "inherited")):
        attr.Set(word, first + frame)
    stage.Save()
    return baked


def test_a_character_is_hidden_when_its_stage_hides_it(tmp_path: Path) -> None:
    page = ReadPage(make_page([hidden_stage(tmp_path, mesh=False)], PLAIN).html())
    seen = page.values(page.manifest["takes"][0]["visible"])[:, 0]
    assert np.flatnonzero(seen == 0).tolist() == [1, 2]
    assert all(mesh.get("visible") is None for mesh in page.manifest["meshes"])


def test_a_mesh_of_a_character_is_hidden_alone(tmp_path: Path) -> None:
    page = ReadPage(make_page([hidden_stage(tmp_path, mesh=True)], PLAIN).html())
    assert page.manifest["takes"][0]["visible"] is None
    hidden = [m["visible"] for m in page.manifest["meshes"] if m.get("visible")]
    assert len(hidden) == 1
    assert np.flatnonzero(page.values(hidden[0])[:, 0] == 0).tolist() == [1, 2]


def test_a_scene_whose_meshes_are_points_has_its_skeleton(tmp_path: Path) -> None:
    clip = write_pair(tmp_path)
    scene = tmp_path / "points.scene.yaml"
    scene.write_text(
        f"scene: animtool/1\nsource: {{file: {clip.name}}}\noutput: {{deform: true}}\n"
    )
    manifest = make_page([scene], PLAIN).manifest
    assert manifest["takes"][0]["moving"]["r"]
    assert any(mesh["cache"] is not None for mesh in manifest["meshes"])
    assert all(mesh["take"] is None for mesh in manifest["meshes"])
