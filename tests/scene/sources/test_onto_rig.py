"""Motion mapped to another rig by names."""

from __future__ import annotations

from pathlib import Path

import pytest
from numpy.testing import assert_allclose
from support.placed import composed, stage_text

from animtool.core.errors import FormatError
from animtool.edit.loop_options import LoopOptions
from animtool.report.describe import describe
from animtool.rig.skeleton import Joint, Rig
from animtool.scene.bake.bake import bake
from animtool.scene.bake.options import BakeOptions
from animtool.scene.convert.takes import convert
from animtool.scene.solves.cycle import loop_source
from animtool.scene.sources.onto_rig import map_names
from animtool.scene.sources.open import SourceOptions


def arms(first: str, second: str) -> Rig:
    """Return two arms with a hand each, of one name, as BVH and USD files have them."""
    return Rig(
        "arms",
        (
            Joint("hips", -1),
            Joint(first, 0),
            Joint("hand", 1),
            Joint(second, 0),
            Joint("hand_2", 3, source_name="hand"),
        ),
    )


@pytest.mark.parametrize("order", [("l", "r"), ("r", "l")])
def test_of_joints_with_one_name_the_one_below_the_same_parent(
    order: tuple[str, str],
) -> None:
    rig, other = arms("l", "r"), arms(*order)
    names = map_names(rig, other)
    parents = [other.names[other.joints[j].parent] for j in names.joints[[2, 4]]]
    assert parents == ["l", "r"]
    assert names.unmatched_joints == ()


def test_a_name_below_another_parent_is_still_found() -> None:
    rig = Rig("a", (Joint("hips", -1), Joint("hand", 0)))
    names = map_names(rig, arms("l", "r"))
    assert names.joints.tolist() == [0, 2]


def test_a_file_fits_itself_however_its_stage_tilts_it(tmp_path: Path) -> None:
    source, other = tmp_path / "tilted.usda", tmp_path / "upright.usda"
    turn = "float xformOp:rotateX = 50\nuniform token[] xformOpOrder = ["
    # Bones in a line have no front, so their tilt could not be told.
    tilted, upright = (
        text.replace("(0, -40, 1", "(30, -40, 1")
        for text in (stage_text("set", f'{turn}"xformOp:rotateX"]'), stage_text())
    )
    source.write_text(tilted)
    other.write_text(upright)
    output = tmp_path / "out.usda"
    options = BakeOptions(source=SourceOptions(rig=source))
    report = bake(source, output, options)
    assert not {"RIG040", "RIG041"} & {notice.code for notice in report.notices}
    positions = composed(output)
    assert_allclose(positions, composed(source), atol=1e-6)
    with pytest.raises(FormatError) as caught:
        bake(source, output.with_stem("other"), BakeOptions(SourceOptions(rig=other)))
    assert caught.value.code == "RIG040"


def test_meshes_that_a_stage_leaves_out_are_noted(tmp_path: Path) -> None:
    source, output = tmp_path / "char.usda", tmp_path / "out.usda"
    source.write_text(stage_text())
    codes = {}
    for name, options in {
        "joints": BakeOptions(),
        "meshes": BakeOptions(source=SourceOptions(rig=source)),
        "points": BakeOptions(deform=True),
        "layer": BakeOptions(rig_layer=source),
    }.items():
        report = bake(source, output.with_stem(name), options)
        codes[name] = [n.code for n in report.notices if n.code == "USD127"]
    outer = tmp_path / "shot.scene.yaml"
    outer.write_text("scene: animtool/1\nsource: char.usda\n")
    (note,) = [
        n for n in bake(outer, tmp_path / "s.usda").notices if n.code == "USD127"
    ]
    assert str(outer) not in (note.hint or "")
    assert codes == {"joints": ["USD127"], "meshes": [], "points": [], "layer": []}
    assert '"body"' in output.with_stem("meshes").read_text()


@pytest.mark.parametrize("pass_text", ["trim: {first: 2}", "clean: {}", "resample: {}"])
def test_passes_of_frames_and_of_clips_keep_the_note_on_meshes(
    tmp_path: Path, pass_text: str
) -> None:
    (tmp_path / "char.usda").write_text(stage_text())
    scene = tmp_path / "shot.scene.yaml"
    scene.write_text(
        f"scene: animtool/1\nsource: char.usda\npasses: [{{{pass_text}}}]\n"
    )
    codes = [n.code for n in bake(scene, tmp_path / "s.usda").notices]
    assert codes.count("USD127") == 1


def test_a_loop_notes_the_meshes_of_its_source(tmp_path: Path) -> None:
    source = tmp_path / "char.usda"
    source.write_text(stage_text())
    options = LoopOptions(first=1, last=5, find=False)
    result = loop_source(source, tmp_path / "loop.usda", options)
    assert [n.code for n in result.notices].count("USD127") == 1


def test_meshes_are_listed_only_for_a_stage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = tmp_path / "char.usda"
    source.write_text(stage_text())
    calls = []

    def count(skeleton: object) -> tuple[str, ...]:
        calls.append(skeleton)
        return ("body",)

    monkeypatch.setattr("animtool.usd.takes.read.skinned_mesh_names", count)
    describe(source)
    convert(source, tmp_path / "take.bvh")
    assert calls == []
    bake(source, tmp_path / "out.usda")
    assert len(calls) == 1
