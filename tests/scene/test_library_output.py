"""A take of a clip library as the output of a scene."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Sdf, Usd
from support.cli import Done, animtool
from support.props import prop_matrices, write_props
from support.usd import validation_errors

from animtool import open_source
from animtool.scene.sources.open import SourceOptions

PASSES = {
    "slow": "- time_scale: {speed: 0.5}",
    "left": "- mirror:",
    "short": "- trim: {last: 20}",
}


@pytest.fixture
def folder(walk: Path, tmp_path: Path) -> Path:
    shutil.copy(walk, tmp_path / "walk.bvh")
    write_props(tmp_path / "props.usda")
    (tmp_path / "animtool.toml").touch()
    return tmp_path


def add(
    folder: Path, name: str, *flags: object, passes: str = "", props: str = ""
) -> Done:
    """Bake a scene whose output is a take of a library."""
    path = folder / f"{name}.scene.yaml"
    lines = ["scene: animtool/1", "source: {file: walk.bvh, units: cm}"]
    lines += ["props:", props] if props else []
    lines += ["passes:", passes or PASSES[name]]
    lines.append(f"output: {{file: lib.usda, as: library, take: {name}}}")
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return animtool("bake", path, *flags)


def variants(folder: Path) -> list[str]:
    stage = Usd.Stage.Open(str(folder / "lib.usda"))
    return list(stage.GetDefaultPrim().GetVariantSet("take").GetVariantNames())


def specs(folder: Path, name: str) -> list[str]:
    """Return what a library holds of a take, as text."""
    layer = Sdf.Layer.OpenAsAnonymous(str(folder / "lib.usda"))
    found = Sdf.Layer.CreateAnonymous(".usda")
    for source in (f"/walk/Rig/Anim_{name}", f"/walk{{take={name}}}"):
        Sdf.CreatePrimInLayer(found, "/take")
        Sdf.CopySpec(layer, source, found, "/take")
    return found.ExportToString().splitlines()


@pytest.mark.slow
def test_takes_come_one_by_one(folder: Path) -> None:
    for name in PASSES:
        done = add(folder, name)
        assert done.code == 0, done.stderr
    assert variants(folder) == sorted(PASSES)
    stage: Any = Usd.Stage.Open(str(folder / "lib.usda"))
    assert stage.GetDefaultPrim().GetVariantSet("take").GetVariantSelection() == "slow"
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (1, 127)
    for name, passes in PASSES.items():
        path = folder / "alone.scene.yaml"
        head = "scene: animtool/1\nsource: {file: walk.bvh, units: cm}\npasses:\n"
        path.write_text(f"{head}{passes}\noutput: {{file: {name}.usda}}\n", "utf-8")
        assert animtool("bake", path).code == 0
        alone = open_source(folder / f"{name}.usda").collect()
        taken = open_source(folder / "lib.usda", SourceOptions(take=name)).collect()
        assert taken.clock == alone.clock
        apart = taken.world().positions - alone.world().positions
        assert np.abs(apart).max() < 1e-6
    assert validation_errors(stage) == []


def test_another_take_stays_as_it_is(folder: Path) -> None:
    add(folder, "slow")
    add(folder, "left")
    before = {name: specs(folder, name) for name in ("slow", "left")}
    assert add(folder, "short").code == 0
    assert {name: specs(folder, name) for name in ("slow", "left")} == before
    done = add(folder, "left", "--overwrite", passes=PASSES["short"])
    assert done.code == 0, done.stderr
    assert specs(folder, "slow") == before["slow"]
    assert specs(folder, "left") != before["left"]
    taken = open_source(folder / "lib.usda", SourceOptions(take="left")).collect()
    assert taken.clock.count == 20


def test_a_take_that_is_there_is_not_replaced_unasked(folder: Path) -> None:
    add(folder, "slow")
    before = (folder / "lib.usda").read_bytes()
    done = add(folder, "slow")
    assert done.code == 2
    assert "SCN050" in done.stderr
    assert (folder / "lib.usda").read_bytes() == before


def test_a_library_is_not_skipped(folder: Path) -> None:
    add(folder, "slow")
    done = add(folder, "left", "--skip-existing")
    assert done.code == 2
    assert "adds a take" in " ".join(done.stderr.split())
    assert variants(folder) == ["slow"]


def test_what_is_no_library_is_refused(folder: Path) -> None:
    assert animtool("bake", "walk.bvh", "-o", "lib.usda", cwd=folder).code == 0
    before = (folder / "lib.usda").read_bytes()
    done = add(folder, "slow", "--overwrite")
    assert done.code == 2
    assert "SCN051" in done.stderr
    assert (folder / "lib.usda").read_bytes() == before


def test_a_take_of_another_layer_is_not_replaced(folder: Path) -> None:
    add(folder, "slow")
    (folder / "lib.usda").rename(folder / "takes.usda")
    top = '#usda 1.0\n(\n    defaultPrim = "walk"\n    subLayers = [@./takes.usda@]\n'
    (folder / "lib.usda").write_text(f"{top}    timeCodesPerSecond = 30\n)\n")
    done = add(folder, "slow", "--overwrite")
    assert "SCN051" in done.stderr
    assert add(folder, "left").code == 0
    assert variants(folder) == ["left", "slow"]
    taken = open_source(folder / "lib.usda", SourceOptions(take="slow")).collect()
    assert taken.clock.count == 127


def test_props_come_with_their_take(folder: Path) -> None:
    box = "- {from: props.usda, prim: /Set/box, path: Props/box}"
    add(folder, "slow")
    for flags in ((), ("--overwrite",)):
        assert add(folder, "short", *flags, props=box).code == 0
    stage: Any = Usd.Stage.Open(str(folder / "lib.usda"))
    assert not stage.GetPrimAtPath("/walk/Props/box")
    stage.GetDefaultPrim().GetVariantSet("take").SetVariantSelection("short")
    assert stage.GetPrimAtPath("/walk/Props/box").IsDefined()
    found = prop_matrices(stage, "/walk/Props/box", [1, 6, 11])
    expected = prop_matrices(folder / "props.usda", "/Set/box", [1, 5, 9])
    np.testing.assert_allclose(found, expected, atol=1e-9)
    outside = box.replace("Props/box", "/Props/box")
    done = add(folder, "left", props=outside)
    assert "SCN047" in done.stderr
    assert variants(folder) == ["short", "slow"]


def test_several_outputs_of_a_run(folder: Path) -> None:
    path = folder / "two.scene.yaml"
    path.write_text(
        "scene: animtool/1\nsource: {file: walk.bvh, units: cm}\noutput:\n"
        "- {file: lib.usda, as: library, take: walk}\n- {file: walk.usda}\n"
    )
    assert animtool("bake", path).code == 0
    assert variants(folder) == ["walk"]
    assert "as a take" in animtool("bake", path, "--plan").stdout


@pytest.mark.parametrize(
    ("output", "code"),
    [
        ("{file: lib.usda, take: walk}", "SCN039"),
        ("{file: lib.usda, as: library, bones: true}", "CLI002"),
        ("{file: lib.usda, as: library, deform: true}", "CLI002"),
    ],
)
def test_settings_that_a_take_has_not(folder: Path, output: str, code: str) -> None:
    path = folder / "one.scene.yaml"
    path.write_text(
        f"scene: animtool/1\nsource: {{file: walk.bvh}}\noutput: {output}\n"
    )
    done = animtool("bake", path)
    assert done.code in {2, 3}
    assert code in done.stderr


def test_a_batch_does_not_write_one(folder: Path) -> None:
    (folder / "t.scene.yaml").write_text(
        "scene: animtool/1\nsource: {file: '${input}'}\n"
        "output: {as: library, take: '${stem}'}\n"
    )
    done = animtool("batch", "walk.bvh", "--scene", "t.scene.yaml",
                    "-o", "{stem}.usda", "-j", "1", cwd=folder)  # fmt: skip
    assert "SCN052" in done.stdout + done.stderr


def test_scenes_that_write_other_takes_are_clean(folder: Path) -> None:
    for name in PASSES:
        add(folder, name)
    for name in PASSES:
        found = animtool("validate", folder / f"{name}.scene.yaml")
        assert found.code == 0, found.stdout
    shutil.copy(folder / "slow.scene.yaml", folder / "again.scene.yaml")
    assert "SCN204" in animtool("validate", folder / "again.scene.yaml").stdout
