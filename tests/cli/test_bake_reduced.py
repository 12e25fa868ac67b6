"""``bake --keep-curves``, ``--reduce`` and ``--table``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd
from support.bvh import random_rows, small_bvh
from support.cli import animtool
from support.clips import hero, write_clip
from support.usd import open_stage, skeleton_query, validation_errors

from animtool.clip.file import load_clip, open_clip
from animtool.clip.sample import sample_channels
from animtool.rig.skeleton import Rig

CONTROLS = """\
- target: control/grin
  post: oscillate
  keys: [{t: 1, v: 0, out: [3, 0]}, {t: 5, v: 1, interp: step}, {t: 8, v: 0.5},
         {t: 13, v: 0.2, in: [0, 0.3]}]
- {target: control/lean, interp: catmull_rom,
   keys: [{t: 1, v: 0}, {t: 3, v: 0.4}, {t: 9, v: -1}, {t: 13, v: 1}]}
- {target: joint/elbow_l.angle, keys: [{t: 1, v: 0}, {t: 13, v: 90}]}
"""
SCENE = """\
scene: animtool/1
rig: hero.rig.yaml
source: {file: shot.clip.yaml}
passes: [PASS]
output: {file: o.usda, keep_curves: true}
"""


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return hero(tmp_path)


@pytest.fixture
def shot(tmp_path: Path, rig: Rig) -> Path:
    assert rig.controls
    return write_clip(tmp_path, CONTROLS)


def control(stage: Usd.Stage, name: str) -> Usd.Attribute:
    prim = skeleton_query(stage).GetAnimQuery().GetPrim()
    return prim.GetAttribute(f"animtool:control:{name}")


@pytest.mark.parametrize("suffix", ["usda", "usdc"])
@pytest.mark.parametrize("options", [(), ("--fps", "60", "--start", "1001")])
def test_controls_keep_their_curves(
    shot: Path, rig: Rig, tmp_path: Path, options: tuple[str, ...], suffix: str
) -> None:
    output = tmp_path / f"o.{suffix}"
    done = animtool(
        "bake", shot, "-o", output, "--keep-curves", *options, "--format", "json"
    )
    assert done.code == 0, done.stderr
    assert "Warning" not in done.stderr
    report = json.loads(done.stdout)
    assert [curve["control"] for curve in report["curves"]] == ["grin", "lean"]
    # The handle of grin's last key has no length, so its segment is split.
    assert [curve["split"] for curve in report["curves"]] == [1, 0]
    assert all(curve["difference"] <= 1e-12 for curve in report["curves"])
    stage = open_stage(output)
    assert validation_errors(stage) == []
    frames = np.arange(1.0, 13.0, 0.21)
    motion = sample_channels(
        load_clip(open_clip(shot), rig).channels, rig, frames
    ).motion
    assert motion.controls is not None
    values = motion.controls.dense()[..., 0]
    names = [c.name for c in rig.controls]
    codes = frames if not options else 1001 + (frames - 1) * 60 / 24
    for name in ("grin", "lean"):
        attribute = control(stage, name)
        assert attribute.HasSpline()
        found = [attribute.Get(float(code)) for code in codes]
        expected = values[:, names.index(name)]
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
    assert not control(stage, "curl")


def test_a_layer_keeps_them_over_its_rig(shot: Path, tmp_path: Path) -> None:
    stage, layer = tmp_path / "hero.usda", tmp_path / "layer.usda"
    assert animtool("bake", shot, "-o", stage, "--split").code == 0
    over = tmp_path / "hero.rig.usda"
    done = animtool("bake", shot, "-o", layer, "--rig-layer", over, "--keep-curves")
    assert done.code == 0, done.stderr
    assert layer.read_text().count(".spline = ") == 2


def test_stdout_has_them_too(shot: Path) -> None:
    done = animtool("bake", shot, "-o", "-", "--keep-curves")
    assert done.code == 0
    assert "animtool:control:grin.spline" in done.stdout
    assert "Warning" not in done.stderr


def test_without_being_asked_there_is_none(shot: Path, tmp_path: Path) -> None:
    output = tmp_path / "o.usda"
    assert animtool("bake", shot, "-o", output).code == 0
    assert "animtool:control" not in output.read_text()


def test_a_source_without_controls_says_so(walk: Path, tmp_path: Path) -> None:
    output = tmp_path / "o.usda"
    done = animtool("bake", walk, "-o", output, "--keep-curves")
    assert done.code == 0
    assert "SCN208" in done.stderr
    assert animtool("bake", walk, "-o", "x.usda", "--keep-curves", "--strict").code == 1


@pytest.mark.parametrize(
    ("made", "kept"),
    [
        ("root_motion: {mode: extract}", 2),
        # Run evenly, curves stay the ones that they were.
        ("resample: {fps: 12}", 2),
        ("trim: {first: 3, last: 9}", 0),
        ("loop: {first: 2, last: 9}", 0),
    ],
)
def test_a_pass_drops_the_curves_of_what_it_changes(
    shot: Path, tmp_path: Path, made: str, kept: int
) -> None:
    assert shot.is_file()
    scene = tmp_path / "x.scene.yaml"
    scene.write_text(SCENE.replace("PASS", f"{{{made}}}"))
    done = animtool("bake", scene)
    assert done.code == 0, done.stderr
    assert (tmp_path / "o.usda").read_text().count(".spline = ") == kept
    assert ("SCN208" in done.stderr) is (kept == 0)


def test_samples_are_reduced(walk: Path, tmp_path: Path) -> None:
    output = tmp_path / "o.usda"
    done = animtool("bake", walk, "-o", output, "--reduce", "1cm", "--format", "json")
    assert done.code == 0, done.stderr
    report = json.loads(done.stdout)
    found = report["reduction"]
    assert found["samples"] > found["kept"] == report["samples"]
    assert 0 < found["error"]["meters"] <= 0.01
    stage = open_stage(output)
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (1, found["samples"])
    assert validation_errors(stage) == []
    query = skeleton_query(stage).GetAnimQuery()
    assert len(query.GetJointTransformTimeSamples()) == found["kept"]


def test_a_joint_is_reduced_less(walk: Path, tmp_path: Path) -> None:
    def kept(*options: str) -> int:
        output = tmp_path / "o.usda"
        done = animtool(
            *("bake", walk, "-o", output, "--overwrite", "--format", "json"),
            *("--reduce", "2cm", *options),
        )
        assert done.code == 0, done.stderr
        return int(json.loads(done.stdout)["reduction"]["kept"])

    assert kept("--reduce-at", "*Toe=1mm") > kept()


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        (["--reduce", "0"], 2, "is not a length"),
        (["--reduce", "1"], 2, "write 1mm or 1m"),
        (["--reduce", "1cm", "--reduce-at", "Hips=1"], 2, "write 1mm or 1m"),
        (["--reduce", "1cm", "--samples", "0,.5"], 2, "CLI002"),
        (["--reduce", "1cm", "--root-motion", "skelroot"], 2, "CLI002"),
        (["--reduce-at", "Hips=1cm"], 2, "CLI002"),
        (["--reduce", "1cm", "--reduce-at", "1cm"], 2, "hand_l=0.1mm"),
        (["--reduce", "1cm", "--reduce-at", "Hip=1mm"], 2, "did you mean 'Hips'?"),
        (["--table", "-o", "o.usda"], 2, "--table writes no file"),
    ],
)
def test_options_that_make_no_sense(
    walk: Path, tmp_path: Path, options: list[str], code: int, said: str
) -> None:
    where = [] if "-o" in options else ["-o", tmp_path / "o.usda"]
    done = animtool("bake", walk, *where, *options)
    assert done.code == code
    assert said in done.stderr
    assert not list(tmp_path.glob("*.usda"))


def test_a_scene_says_how_to_reduce(walk: Path, tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_bytes(walk.read_bytes())
    scene = tmp_path / "x.scene.yaml"
    head = "scene: animtool/1\nsource: {file: walk.bvh}\n"
    scene.write_text(head + "output: {reduce: 1cm, reduce_at: {Hips: 1mm}}\n")
    done = animtool("bake", scene, "-o", tmp_path / "o.usda")
    assert done.code == 0, done.stderr
    assert "reduced to" in done.stderr
    scene.write_text(head + "output: {reduce: 1 parsec}\n")
    done = animtool("bake", scene, "-o", tmp_path / "p.usda")
    assert done.code == 3
    assert "x.scene.yaml:3:18: SCN003" in done.stderr


def test_a_table_of_a_clip(shot: Path, tmp_path: Path) -> None:
    before = sorted(tmp_path.iterdir())
    done = animtool("bake", shot, "--table", "--format", "json")
    assert done.code == 0, done.stderr
    samples, keys = json.loads(done.stdout)["tables"]
    assert samples["instants"] == 12 * 8 + 1
    rates = [row for row in samples["rows"] if row["method"] == "rate"]
    assert [row["options"]["fps"] for row in rates] == [6, 12, 24, 48, 96]
    errors = [row["error"]["largest"] for row in rates]
    assert errors == sorted(errors, reverse=True)
    # Straight lines between samples: four times the rate, a sixteenth of the error
    # where the curve is smooth; the handle at the last key is not.
    assert errors[-1] < errors[0] / 16
    for row in (*samples["rows"], *keys["rows"]):
        assert row["steps"] > 0
        assert row["seconds"] > 0
    for row in keys["rows"]:
        assert row["error"]["largest"] <= row["options"]["reduce"]
    assert sorted(tmp_path.iterdir()) == before


def test_a_table_of_samples_in_words(walk: Path) -> None:
    done = animtool("bake", walk, "--table")
    assert done.code == 0, done.stderr
    (exact,) = [line for line in done.stdout.splitlines() if "fps 30 " in line]
    # Marks, method, setting, seconds, samples, kB, error [mm].
    assert float(exact.split()[7]) < 1e-3


def test_samples_left_out_are_not_lost_ones(tmp_path: Path) -> None:
    rows = random_rows(60)
    rows[30:34] = rows[30]
    (tmp_path / "take.bvh").write_text(small_bvh(rows), "utf-8")
    output = tmp_path / "take.usda"
    assert (
        animtool("bake", tmp_path / "take.bvh", "-o", output, "--reduce", "1mm").code
        == 0
    )
    stage = open_stage(output)
    rotations = stage.GetAttributeAtPath("/take/Rig/Anim.rotations")
    assert 50 < len(rotations.GetTimeSamples()) < 60
    assert "MOT205" not in animtool("validate", output).stdout
    # Of a file that states nothing, the same samples are lost.
    other = tmp_path / "other.usda"
    other.write_text(
        output.read_text("utf-8").replace("bool reduced", "bool own"), "utf-8"
    )
    assert "MOT205" in animtool("validate", other).stdout
