"""Layers over what is shown, and the colours that they give."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from preview.pages import ReadPage

from animtool.core.errors import AnimtoolError
from animtool.preview.build import make_page
from animtool.preview.options import PreviewOptions
from animtool.scene.bake.bake import bake

LOOK = """#usda 1.0
over "head"
{
    over "Rig"
    {
        over "face"
        {
            color3f[] primvars:displayColor = [%s] (
                interpolation = "vertex"
            )
        }
        over "eyeball_l"
        {
            color3f[] primvars:displayColor = [(0, 1, 0.5)]
        }
    }
}
"""


@pytest.mark.slow(1)
def test_a_look_colours_what_is_baked(root: Path, tmp_path: Path) -> None:
    baked, look = tmp_path / "head.usdc", tmp_path / "look.usda"
    bake(root / "samples/speech/speech.clip.yaml", baked)
    plain = make_page([baked], PreviewOptions(findings=False)).manifest
    count = ReadPage(make_page([baked], PreviewOptions(findings=False)).html())
    face = next(mesh for mesh in plain["meshes"] if mesh["name"] == "face")
    assert face["colors"] is None
    points = count.values(face["points"]).size // 3
    linear = np.random.default_rng(1).random((points, 3)).round(4)
    rows = ", ".join(f"({r}, {g}, {b})" for r, g, b in linear)
    look.write_text(LOOK % rows, "utf-8")
    options = PreviewOptions(findings=False, over=(str(look),))
    page = ReadPage(make_page([baked], options).html())
    meshes = {mesh["name"]: mesh for mesh in page.manifest["meshes"]}
    stored = page.values(meshes["face"]["colors"]).reshape(-1, 3)
    np.testing.assert_allclose(stored, linear ** (1 / 2.2) * 255, atol=0.51)
    assert meshes["eyeball_l"]["colors"] is None
    assert meshes["eyeball_l"]["color"] == [0, 1, 0.5]
    assert meshes["eyeball_r"]["color"] != [0, 1, 0.5]
    # Its files are named as they are.
    assert page.manifest["source"]["files"] == ["head.usdc"]


def test_a_layer_that_is_none_is_refused(tmp_path: Path) -> None:
    stage, wrong = tmp_path / "a.usda", tmp_path / "look.usda"
    stage.write_text('#usda 1.0\ndef Cube "c" {}\n', "utf-8")
    wrong.write_text("no layer", "utf-8")
    for layer, code in ((wrong, "USD001"), (tmp_path / "none.usda", "IO001")):
        with pytest.raises(AnimtoolError) as error:
            make_page([stage], PreviewOptions(over=(str(layer),)))
        assert error.value.code == code
