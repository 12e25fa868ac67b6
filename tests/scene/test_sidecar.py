"""A rig that lives elsewhere, over a source of any kind."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf
from support.cli import animtool

from animtool.core.errors import AnimtoolError, FormatError
from animtool.motion.take import Take
from animtool.scene.file.read import load_scene
from animtool.scene.sources.open import SourceOptions, open_source

RIG = """rig: animtool/1
name: cat
joints:
- {name: hips, type: free, translate: [0, 0.3, 0]}
- {name: chest, parent: hips, type: ball, translate: [0, 0, 0.4]}
- {name: tail_1, parent: hips, type: ball, translate: [0, 0, -0.1]}
- {name: tail_2, parent: tail_1, type: ball, translate: [0, 0, -0.2]}
- {name: tail_3, parent: tail_2, type: ball, translate: [0, 0, -0.2]}
"""
CLIP = """clip: animtool/1
rig: cat.rig.yaml
fps: 24
channels:
- {target: joint/hips.translation, keys: [{t: 1, v: [0, 0, 0]}, {t: 9, v: [0.3, 0, 0]}]}
- target: joint/chest.rotation
  interp: slerp
  keys: [{t: 1, v: [1, 0, 0, 0]}, {t: 9, v: [0.8, 0, 0.6, 0]}]
"""
SIDECAR = """rig: animtool/1
name: side
from: cat.usda
controls:
- {name: puff, range: [0, 1], default: 0.25, drives: [{control: other, expr: puff}]}
- {name: other, range: [0, 1]}
ik: [{name: spine, root: hips, tip: chest}]
attach: [{name: tail, kind: spring_chain, joints: [tail_1, tail_2, tail_3]}]
colliders: [{joint: chest, capsule: {radius: 0.05, length: 0.1, axis: [0, 1, 0]}}]
"""
SCENE = """scene: animtool/1
rig: side.rig.yaml
source: SOURCE
passes:
- simulate: {what: [tail]}
output: {file: out.usda}
"""
SOURCES = {
    "usd": "{file: shot.usda}",
    "usd-list": "[{file: shot.usda}]",
    "layer": "{file: layer.usda}",
    "bvh": "{file: cat.bvh, units: m}",
    "clip": "{file: cat.clip.yaml}",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rig in USD as another tool writes it, a sidecar, and motion of all kinds."""
    made = tmp_path_factory.mktemp("sidecar")
    (made / "cat.rig.yaml").write_text(RIG, "utf-8")
    (made / "cat.clip.yaml").write_text(CLIP, "utf-8")
    (made / "side.rig.yaml").write_text(SIDECAR, "utf-8")
    for command in (
        "convert cat.rig.yaml cat.usda",
        "bake cat.clip.yaml -o shot.usda",
        "bake cat.clip.yaml -o layer.usda --rig-layer cat.usda",
        "convert cat.clip.yaml cat.bvh",
    ):
        assert animtool(*command.split(), cwd=made).code == 0
    for name in ("cat.usda", "shot.usda"):
        foreign(made / name)
    return made


def foreign(path: Path) -> None:
    """Take away what only animtool writes."""
    layer = Sdf.Layer.FindOrOpen(str(path))
    prims: list[Sdf.Path] = []
    layer.Traverse("/", lambda at: prims.append(at) if at.IsPrimPath() else None)
    for at in prims:
        layer.GetPrimAtPath(at).customData.clear()
    layer.Save()


def opened(folder: Path, source: str) -> Take:
    path = folder / "shot.scene.yaml"
    path.write_text(SCENE.replace("SOURCE", source), "utf-8")
    return load_scene(path).open().collect()


@pytest.mark.parametrize("kind", SOURCES)
def test_a_sidecar_serves_any_source(folder: Path, kind: str) -> None:
    take, same = opened(folder, SOURCES[kind]), opened(folder, SOURCES["clip"])
    rig = take.rig
    assert [entry.name for entry in rig.attach] == ["tail"]
    assert [control.name for control in rig.controls] == ["puff", "other"]
    assert [chain.name for chain in rig.chains] == ["spine"]
    assert [collider.joint for collider in rig.colliders] == ["chest"]
    places, wanted = take.world().positions, same.world().positions
    np.testing.assert_allclose(places, wanted, atol=2e-6)
    # The tail lags behind.
    still = open_source(folder / "cat.clip.yaml").collect().world().positions
    assert np.abs(places[:, 4] - still[:, 4]).max() > 0.01


def test_bake_takes_a_rig_for_any_source(folder: Path) -> None:
    for name in ("shot.usda", "cat.bvh"):
        command = f"bake {name} --rig side.rig.yaml -o made.usda --overwrite"
        units = ["--units", "m"] if name == "cat.bvh" else []
        done = animtool(*command.split(), *units, cwd=folder)
        assert done.code == 0, done.stderr
        made = open_source(folder / "made.usda").collect().rig
        assert [entry.name for entry in made.attach] == ["tail"]


def test_what_the_rig_lacks_is_named(folder: Path) -> None:
    text = RIG.replace("tail_3", "wisp").replace("name: cat", "name: dog")
    (folder / "dog.rig.yaml").write_text(text, "utf-8")
    options = SourceOptions(rig=folder / "dog.rig.yaml")
    notices = open_source(folder / "shot.usda", options).notices
    found = {notice.code: notice.message for notice in notices}
    assert "tail_3" in found["RIG042"]
    assert "wisp" in found["RIG043"]


def test_a_source_that_does_not_fit_is_refused(folder: Path) -> None:
    text = RIG.replace("[0, 0, 0.4]", "[0.4, 0, 0]").replace(
        "[0, 0, -0.2]", "[1, 0, 0]"
    )
    (folder / "other.rig.yaml").write_text(text, "utf-8")
    scene = SCENE.replace("SOURCE", SOURCES["usd"])
    scene = scene.replace("side", "other").replace(
        "passes:\n- simulate: {what: [tail]}\n", ""
    )
    path = folder / "misfit.scene.yaml"
    path.write_text(scene, "utf-8")
    with pytest.raises(FormatError) as caught:
        load_scene(path).open()
    assert caught.value.code == "RIG040"
    # In place of an error, a warning: by the command line, or by the scene.
    done = animtool("bake", path, "--force-fit", "--overwrite")
    assert done.code == 0
    assert "RIG041" in done.stderr
    path.write_text(scene.replace("out.usda", "out.usda, force_fit: true"), "utf-8")
    assert animtool("bake", path, "--overwrite").code == 0


def test_nothing_in_common_is_refused(folder: Path) -> None:
    (folder / "fish.rig.yaml").write_text(
        "rig: animtool/1\nname: fish\njoints: [{name: fin, type: free}]\n", "utf-8"
    )
    options = SourceOptions(rig=folder / "fish.rig.yaml")
    with pytest.raises(AnimtoolError) as caught:
        open_source(folder / "shot.usda", options)
    assert caught.value.code == "SCN036"


@pytest.fixture(scope="module")
def twisted(folder: Path) -> Path:
    """The cat in USD with its bones elsewhere."""
    names = [f"bone_{i}" for i in range(60)]
    text = RIG.replace("[0, 0, 0.4]", "[0.4, 0, 0]").replace(
        "[0, 0, -0.2]", "[0, 0.2, 0]"
    )
    text += "".join(f"- {{name: {n}, parent: hips, type: ball}}\n" for n in names)
    (folder / "twisted.rig.yaml").write_text(text, "utf-8")
    done = animtool("convert", "twisted.rig.yaml", "twisted.usda", cwd=folder)
    assert done.code == 0
    return folder / "twisted.usda"


def test_a_layer_is_not_written_where_it_does_not_fit(
    folder: Path, twisted: Path
) -> None:
    output = folder / "refused.usda"
    command = ["bake", folder / "shot.usda", "--rig-layer", twisted, "-o", output]
    done = animtool(*command)
    assert done.code == 3
    assert "RIG040" in done.stderr
    assert "--force-fit" in done.stderr
    assert not output.exists()
    done = animtool(*command, "--force-fit", "--format", "json")
    assert done.code == 0
    report = json.loads(done.stdout)
    assert 0 <= report["fit"] < 0.7
    codes = [notice["code"] for notice in report["notices"]]
    assert "RIG041" in codes
    # All names are in JSON and under -v, the first ones in brief.
    whole = {n["code"]: n["message"] for n in report["notices"]}["USD111"]
    assert "bone_59" in whole
    assert "…" not in whole
    assert "bone_59" not in done.stderr
    said = animtool(*command, "-v", "--force-fit", "--overwrite").stderr
    assert "bone_59" in said
    assert "…" not in said


@pytest.mark.slow
@pytest.mark.usefixtures("twisted")
def test_every_way_to_a_layer_is_checked(folder: Path) -> None:
    (folder / "reach.targets.yaml").write_text(
        "targets: animtool/1\ngoals:\n- {effector: chest, position: [0, 0.4, 0.3]}\n",
        "utf-8",
    )
    (folder / "over.scene.yaml").write_text(
        "scene: animtool/1\nsource: {file: shot.usda}\n"
        "output: {file: o.usda, rig_layer: twisted.usda}\n",
        "utf-8",
    )
    (folder / "over.batch.yaml").write_text(
        "batch: animtool/1\ninputs: [shot.usda]\noptions: {rig_layer: twisted.usda}\n"
        "output: b.usda\n",
        "utf-8",
    )
    ik = "ik cat.rig.yaml --targets reach.targets.yaml --clip cat.clip.yaml"
    for command, code in (
        ("bake over.scene.yaml", 3),
        ("batch over.batch.yaml -j 1", 1),
        (f"{ik} --rig-layer twisted.usda -o i.usda", 3),
    ):
        done = animtool(*command.split(), cwd=folder)
        assert done.code == code, command
        assert "RIG040" in done.stdout + done.stderr, command
    for name, old, new in (
        ("over.scene.yaml", "twisted.usda}", "twisted.usda, force_fit: true}"),
        ("over.batch.yaml", "twisted.usda}", "twisted.usda, force_fit: true}"),
    ):
        path = folder / name
        path.write_text(path.read_text("utf-8").replace(old, new), "utf-8")
    for command in (
        "bake over.scene.yaml",
        "batch over.batch.yaml -j 1",
        f"{ik} --rig-layer twisted.usda -o i.usda --force-fit",
    ):
        done = animtool(*command.split(), cwd=folder)
        assert done.code == 0, (command, done.stderr)
