from __future__ import annotations

import json
from pathlib import Path

import pytest
from pxr import Usd, UsdSkel
from support.bvh import random_rows, small_bvh
from support.cli import animtool
from support.drifting import author_samples
from support.skinned_rig import write_pair

from animtool.cli.diff import diff
from animtool.report.compare import WEIGHT_TOLERANCE


@pytest.fixture
def takes(tmp_path: Path) -> tuple[Path, Path]:
    rows = random_rows(6)
    one, two = tmp_path / "one.bvh", tmp_path / "two.bvh"
    one.write_text(small_bvh(rows))
    rows[3, 6] += 1.0
    two.write_text(small_bvh(rows))
    return one, two


def test_info_of_several_files(takes: tuple[Path, Path], tmp_path: Path) -> None:
    animtool("bake", takes[0], "-o", tmp_path / "one.usdc")
    files = (takes[0], tmp_path / "one.usdc", tmp_path / "none.bvh")
    done = animtool("info", *files, "--format", "json")
    assert done.code == 3
    assert "none.bvh" in done.stderr
    bvh, usd = json.loads(done.stdout)["files"]
    for key in (
        "joints",
        "frames",
        "fps",
        "duration",
        "animated",
        "units",
        "up",
        "roots",
    ):
        assert bvh[key] == usd[key], key
    assert (bvh["frames"], bvh["channels"], usd["channels"]) == (6, 9, None)
    for mine, theirs in zip(bvh["bounds"], usd["bounds"], strict=True):
        assert mine == pytest.approx(theirs, rel=1e-6)
    text = animtool("info", takes[0]).stdout
    assert "2 below Hips, 9 channels" in text


def test_diff(takes: tuple[Path, Path]) -> None:
    assert animtool("diff", takes[0], takes[0]).code == 0
    done = animtool("diff", *takes, "--format", "json")
    assert done.code == 1
    found = json.loads(done.stdout)
    assert found["rotation"]["joint"] == "Spine"
    assert found["rotation"]["code"] == 4
    assert found["rotation"]["value"] == pytest.approx(1.0, abs=1e-9)
    assert (
        animtool("diff", *takes, "--tolerance", "1", "--angle-tolerance", "1.1").code
        == 0
    )
    assert "different" in animtool("diff", *takes).stdout


def test_diff_names_what_one_has_not(takes: tuple[Path, Path], tmp_path: Path) -> None:
    short = tmp_path / "short.bvh"
    text = takes[0].read_text().replace("Spine", "Tail")
    short.write_text(text.replace("Frames: 6", "Frames: 5").rsplit("\n", 2)[0] + "\n")
    found = json.loads(animtool("diff", takes[0], short, "--format", "json").stdout)
    said = " ".join(found["mismatches"])
    assert not found["same"]
    assert "Spine" in said
    assert "6 frames (1 to 6)" in said
    assert "5 (1 to 5)" in said


def test_bvh_to_usd_to_bvh_to_usd(takes: tuple[Path, Path], tmp_path: Path) -> None:
    a, b, c = tmp_path / "a.usdc", tmp_path / "b.bvh", tmp_path / "c.usdc"
    for source, output in ((takes[0], a), (a, b), (b, c)):
        assert animtool("convert", source, output).code == 0
    assert (
        animtool("diff", a, c, "--tolerance", "3e-8", "--angle-tolerance", "2e-5").code
        == 0
    )
    assert "JOINT Spine" in b.read_text()
    refused = animtool("convert", a, b)
    assert refused.code == 2
    assert animtool("convert", a, tmp_path / "d.fbx").code == 2
    report = animtool("convert", a, b, "--overwrite", "--format", "json")
    assert json.loads(report.stdout)["frames"] == 6


def test_names_with_dots_come_back_in_a_bvh(tmp_path: Path) -> None:
    """They were lost where only ``jointNames`` has them."""
    dotted = tmp_path / "dotted.bvh"
    text = small_bvh(random_rows(4)).replace("Spine", "Spine.01")
    dotted.write_text(text.replace("Hips", "Hips.L"))
    ours, theirs = tmp_path / "ours.usda", tmp_path / "theirs.usda"
    assert animtool("convert", dotted, ours).code == 0
    stage = Usd.Stage.Open(str(ours))
    prim = stage.GetPrimAtPath("/dotted/Rig/Skel")
    prim.ClearCustomData()
    UsdSkel.Skeleton(prim).CreateJointNamesAttr(["Hips.L", "Spine.01"])
    stage.GetRootLayer().Export(str(theirs))
    # A layer alone, whose Skeleton is elsewhere.
    alone = tmp_path / "alone.usda"
    assert animtool("bake", dotted, "-o", alone, "--rig-layer", ours).code == 0
    for source in (ours, theirs, alone):
        back = source.with_suffix(".bvh")
        assert animtool("convert", source, back).code == 0
        assert "ROOT Hips.L" in back.read_text()
        assert "JOINT Spine.01" in back.read_text()


def test_names_that_are_none_are_those_of_paths(tmp_path: Path) -> None:
    source, back = tmp_path / "a.usda", tmp_path / "a.bvh"
    author_samples(source, [1.0, 2.0, 3.0])
    stage = Usd.Stage.Open(str(source))
    skeleton = UsdSkel.Skeleton(stage.GetPrimAtPath("/hero/Rig/Skel"))
    for names in (["x", "x"], ["x"], ["x", ""], ["x", "y\nz"]):
        skeleton.CreateJointNamesAttr(names)
        stage.Save()
        assert animtool("convert", source, back, "--overwrite").code == 0
        assert "ROOT hips\n" in back.read_text()


def test_diff_says_in_which_space_it_compares(
    takes: tuple[Path, Path], tmp_path: Path
) -> None:
    other = tmp_path / "other.usda"
    arguments = ("--to-up", "Z", "--to-units", "m")
    assert animtool("bake", takes[0], "-o", other, *arguments).code == 0
    done = animtool("diff", takes[0], other, "--tolerance", "0.001mm")
    assert done.code == 0, done.stdout
    assert "Y up instead of Z up; compared with Y up" in done.stdout
    assert "lengths in cm instead of m; compared in metres" in done.stdout
    assert "compared with" not in animtool("diff", *takes).stdout


@pytest.mark.parametrize(
    ("tolerance", "code"),
    [("20mm", 0), ("2cm", 0), ("0.02", 0), ("1mm", 1), ("1e-3", 1), ("1parsec", 2)],
)
def test_a_tolerance_may_have_a_unit(tmp_path: Path, tolerance: str, code: int) -> None:
    one, two, rows = tmp_path / "one.bvh", tmp_path / "two.bvh", random_rows(4)
    one.write_text(small_bvh(rows))
    rows[2, 0] += 1.0  # cm
    two.write_text(small_bvh(rows))
    assert animtool("diff", one, two, "--tolerance", tolerance).code == code


def test_what_a_usd_file_states_is_not_stated_again(takes: tuple[Path, Path]) -> None:
    animtool("bake", takes[0])
    done = animtool("bake", takes[0].with_suffix(".usdc"), "--units", "m", "-o", "-")
    assert done.code == 2
    assert "--to-units" in done.stderr


@pytest.fixture
def faces(tmp_path: Path) -> tuple[Path, Path]:
    """Return a clip, and the same with another weight of one shape."""
    one, two = write_pair(tmp_path), tmp_path / "narrow.clip.yaml"
    two.write_text(one.read_text().replace("{t: 9, v: 1.2}", "{t: 9, v: 0.1}"))
    return one, two


def test_diff_compares_shape_weights(faces: tuple[Path, Path], tmp_path: Path) -> None:
    one, two = tmp_path / "one.usdc", tmp_path / "two.usdc"
    for clip, output in zip(faces, (one, two), strict=True):
        assert animtool("bake", clip, "-o", output).code == 0
    for pair in (faces, (one, two)):
        done = animtool("diff", *pair)
        assert done.code == 1
        assert "shape 'smile', time code 9" in done.stdout
    assert animtool("diff", faces[0], one, "--tolerance", "1e-4").code == 0
    done = animtool("diff", one, two, "--format", "json", "--weight-tolerance", "1.2")
    assert done.code == 0
    weight = json.loads(done.stdout)["weight"]
    assert weight["value"] == pytest.approx(1.1, rel=1e-6)
    assert (weight["shape"], weight["code"]) == ("smile", 9)


def test_info_names_the_shapes_that_move(faces: tuple[Path, Path]) -> None:
    done = animtool("info", faces[0])
    assert "joints of 4, 3 shapes of 3; the rest are static" in done.stdout
    assert "shapes    smile, bulge, both\n" in done.stdout
    found = json.loads(animtool("info", faces[0], "--format", "json").stdout)
    (described,) = found["files"]
    assert described["moving_shapes"] == ["smile", "bulge", "both"]
    still = faces[0].with_name("still.clip.yaml")
    still.write_text(
        "clip: animtool/1\nrig: pair.rig.yaml\nfps: 24\nrange: [1, 9]\nchannels: []\n"
    )
    assert "joints of 4, 0 shapes of 3; the rest" in animtool("info", still).stdout


def test_diff_of_takes_that_start_elsewhere(
    takes: tuple[Path, Path], tmp_path: Path
) -> None:
    one, two = tmp_path / "a.usda", tmp_path / "b.usda"
    for output, start in ((one, 1), (two, 1001)):
        animtool("bake", takes[0], "-o", output, "--start", start)
    done = animtool("diff", one, two)
    assert done.code == 0
    assert "note: first time code 1 instead of 1001" in done.stdout
    assert done.stdout.endswith("same\n")


def test_diff_chooses_takes_and_characters(
    takes: tuple[Path, Path], tmp_path: Path
) -> None:
    library, shot = tmp_path / "library.usda", tmp_path / "shot.usda"
    animtool("bake", *takes, "-o", library, "--prim-path", "/World/a")
    shot.write_text(library.read_text())
    stage = Usd.Stage.Open(str(shot))
    stage.DefinePrim("/World/b").GetReferences().AddInternalReference("/World/a")
    stage.Save()
    tolerances = ("--tolerance", "1e-4")
    assert animtool("diff", takes[1], library, "--take", "two", *tolerances).code == 0
    assert animtool("diff", takes[0], library, "--take", "two", *tolerances).code == 1
    both = ("--take-a", "one", "--take-b", "two")
    assert animtool("diff", library, library, *both, *tolerances).code == 1
    assert (
        animtool("diff", library, library, "--take", "two", "--tolerance", "0").code
        == 0
    )
    done = animtool("diff", library, shot)
    assert (done.code, done.stderr) == (1, "")
    assert "1 skeleton is not in the first: /World/b" in done.stdout
    done = animtool("diff", takes[1], shot)
    assert "USD107" in done.stderr
    assert "--source-prim" in done.stderr
    done = animtool("diff", library, shot, "--source-prim-b", "/World/b")
    assert (done.code, done.stderr) == (0, "")
    assert animtool("diff", shot, shot, "--source-prim", "/World/b").stderr == ""
    assert animtool("diff", takes[0], shot, "--source-prim-a", "/x").code == 2


def test_the_default_tolerance_of_weights_is_that_of_the_library() -> None:
    (option,) = (o for o in diff.params if o.name == "tol_weight")
    assert option.default == WEIGHT_TOLERANCE


@pytest.mark.parametrize(
    "option", ["--tolerance", "--angle-tolerance", "--weight-tolerance"]
)
@pytest.mark.parametrize("value", ["nan", "-1", "wide"])
def test_a_tolerance_that_is_none_is_refused(
    takes: tuple[Path, Path], option: str, value: str
) -> None:
    done = animtool("diff", *takes, option, value)
    assert done.code == 2
    assert option in done.stderr


def test_one_of_a_kind_is_not_said_in_plural(
    takes: tuple[Path, Path], tmp_path: Path
) -> None:
    still = tmp_path / "still.bvh"
    head, _, rows = takes[0].read_text().partition("Frames: 6")
    time, row = rows.strip().splitlines()[:2]
    still.write_text(f"{head}Frames: 1\n{time}\n{row}\n")
    keys = tmp_path / "still.clip.yaml"
    done = animtool("convert", still, keys, "--reduce", "1mm")
    assert "1 frame, 2 joints" in done.stderr
    assert "nothing moves: 3 keys, for what is not at rest" in done.stderr
    rig = tmp_path / "one.rig.yaml"
    rig.write_text(
        "rig: animtool/1\nname: one\njoints:\n- {name: a, type: free}\n"
        "- {name: b, parent: a, type: pin, axis: [0, 0, 1], translate: [1, 0, 0]}\n"
        "- {name: c, parent: b, type: fixed, translate: [1, 0, 0]}\n"
        "controls: [{name: x}]\nik: [{name: leg, root: a, tip: c}]\n"
    )
    done = animtool("info", rig)
    assert "controls  x\n  and       1 chain\n" in done.stdout


def test_skipping_a_clip_wants_its_rig_too(walk: Path, tmp_path: Path) -> None:
    clip, rig = tmp_path / "keys.clip.yaml", tmp_path / "keys.rig.yaml"
    rig.write_text("mine")
    refused = animtool("convert", walk, clip, "--skip-existing")
    assert refused.code == 2
    assert "keys.rig.yaml" in refused.stderr
    assert not clip.exists()
    clip.write_text("mine")
    assert animtool("convert", walk, clip, "--skip-existing").code == 0
    assert clip.read_text() == "mine"


def test_a_length_without_a_unit_is_refused(walk: Path, tmp_path: Path) -> None:
    done = animtool("convert", walk, tmp_path / "keys.clip.yaml", "--reduce", "1")
    assert done.code == 2
    assert "write 1mm or 1m" in done.stderr


def test_physics_says_that_motion_is_left_out(walk: Path, tmp_path: Path) -> None:
    done = animtool("convert", walk, tmp_path / "rig.usda", "--physics")
    assert done.code == 0
    assert "CLI104" in done.stderr
    again = animtool("convert", tmp_path / "rig.usda", tmp_path / "b.usda", "--physics")
    assert again.code == 0
    assert "CLI104" not in again.stderr


@pytest.mark.parametrize("command", ["info", "diff", "preview", "retarget", "loop"])
def test_every_command_warns_of_a_rate_of_the_source(
    root: Path, walk: Path, tmp_path: Path, command: str
) -> None:
    more = {
        "diff": [walk],
        "preview": ["-o", tmp_path / "a.html"],
        "retarget": ["--to", root / "rigs/biped/biped.rig.yaml"],
    }
    arguments = [command, walk, *more.get(command, [])]
    done = animtool(*arguments, "--source-fps", 2400)
    assert "TAKE009 --source-fps 2400" in done.stderr
    assert "TAKE009" not in animtool(*arguments, "--source-fps", 60).stderr


def test_a_file_as_the_name_of_a_take_is_swapped(tmp_path: Path) -> None:
    (tmp_path / "fox.glb").touch()
    for command, more in (("info", []), ("bake", ["-o", "a.usdc"])):
        for words in (["--take", "fox.glb", "trot"], ["--take=fox.glb", "trot"]):
            done = animtool(command, *words, *more, cwd=tmp_path)
            assert "IO001" in done.stderr
            right = " ".join([*words, *more]).replace("fox.glb", "?")
            right = right.replace("trot", "fox.glb").replace("?", "trot")
            assert f"animtool {command} {right}" in done.stderr
    done = animtool("info", "--take", "fox.glb", cwd=tmp_path)
    assert "--take has the file fox.glb" in done.stderr
    (tmp_path / "a.toml").touch()
    for command, flag in (("batch", "-o"), ("validate", "--profile")):
        done = animtool(command, "none.bvh", flag, "a.toml", cwd=tmp_path)
        assert done.code
        assert "write animtool" not in done.stderr
    done = animtool("info", "none.glb", "--take", "trot", cwd=tmp_path)
    assert "IO001" in done.stderr
    assert "--take" not in done.stderr
