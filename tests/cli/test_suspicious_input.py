"""Input that is probably a mistake: one warning, with numbers and what to do."""

from __future__ import annotations

import re
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool
from support.gltf import write_small
from support.marked import FIGURE, TEMPLATE, captured, moving

from animtool import open_source
from animtool.capture.markers.plausible import plausibility_warnings
from animtool.capture.solve.run import MIN_MOVING_FRAMES, static_notices
from animtool.capture.templates import MarkerTemplate, TemplateMarker
from animtool.capture.templates.template import template_text
from animtool.core.clock import Clock
from animtool.core.units import UpAxis
from animtool.edit import resampled, trim
from animtool.formats.bvh.write import write_bvh
from animtool.formats.marker_arrays import write_marker_arrays
from animtool.motion.markers import Markers
from animtool.motion.reorient import reorient
from animtool.motion.take import TakeStream
from animtool.rig.write import rig_text

SAMPLE = Path(__file__).parents[2] / "samples/retarget"
SLOW = Clock(Fraction(1, 30), Fraction(1), Fraction(1), 60)
WALK, CHILD = SAMPLE / "takes/walk.bvh", SAMPLE / "rigs/child.rig.yaml"


def shorter(path: Path, frames: int) -> Path:
    """Write the first frames of the walk."""
    head, _, motion = WALK.read_text("utf-8").partition("MOTION\n")
    _, time, *rows = motion.splitlines()
    lines = [f"{head}MOTION", f"Frames: {frames}", time, *rows[:frames], ""]
    path.write_text("\n".join(lines), "utf-8")
    return path


def warnings(*command: str | Path, code: int = 0, cwd: Path | None = None) -> list[str]:
    """Return the warnings and errors of a command."""
    done = animtool(*command, cwd=cwd)
    assert done.code == code, done.stderr
    shown = (line for line in done.stderr.splitlines() if "note:" not in line)
    return [line for line in shown if re.search(r"[A-Z]{3,4}[0-9]{3} ", line)]


def test_a_cut_off_above_half_the_rate(tmp_path: Path) -> None:
    rate = open_source(WALK).fps
    command = ("mocap", "clean", WALK, "-o", tmp_path / "a.bvh", "--cutoff")
    (line,) = warnings(*command, "200")
    assert "CAP106" in line
    assert f"{float(rate / 2):g} Hz" in line
    assert f"set --cutoff below {float(rate / 2):g}" in line
    take, clean = open_source(WALK).collect(), open_source(tmp_path / "a.bvh").collect()
    apart = take.world().positions - clean.world().positions
    assert np.abs(apart).max() < 1e-4
    assert not warnings(*command, str(int(rate / 4)), "--overwrite")


@pytest.mark.parametrize("command", ["clean", "feet", "retarget", "loop", "bake"])
@pytest.mark.parametrize("right", ["Y", "Z"])
def test_an_up_axis_that_the_body_contradicts(
    command: str, right: str, tmp_path: Path
) -> None:
    walk = tmp_path / "walk.bvh"
    write_bvh(reorient(open_source(WALK), UpAxis(right)).collect(), walk)
    wrong = "Z" if right == "Y" else "Y"
    words: tuple[str | Path, ...] = {
        "clean": ("mocap", "clean", walk, "-o", tmp_path / "a.usdc"),
        "feet": ("mocap", "clean", walk, "-o", tmp_path / "a.usdc", "--feet", "hold"),
        "retarget": ("retarget", walk, "--to", CHILD),
        "loop": ("loop", walk),
        "bake": ("bake", walk, "-o", tmp_path / "a.usdc"),
    }[command]
    found = warnings(*words, "--up", wrong)
    (line,) = [line for line in found if "MOT214" in line or "MAP009" in line]
    assert f"the body stands along {right}, but --up {wrong} was given" in line
    assert line.endswith(f"read it with --up {right}")
    again = () if command in {"retarget", "loop"} else ("--overwrite",)
    assert "MOT214" not in "".join(warnings(*words, "--up", right, *again))


@pytest.mark.parametrize(("up", "found"), [("z", True), ("y", False)])
def test_an_up_axis_of_a_body_on_four_legs(
    up: str, found: bool, tmp_path: Path
) -> None:
    fox = SAMPLE.parent / "fox/fox.glb"
    lines = warnings("bake", fox, "-o", tmp_path / "a.usdc", "--up", up)
    assert ("MOT214" in "".join(lines)) is found


@pytest.mark.parametrize("right", ["Y", "Z"])
def test_an_up_axis_of_a_scene_that_the_body_contradicts(
    right: str, tmp_path: Path
) -> None:
    write_bvh(
        reorient(open_source(WALK), UpAxis(right)).collect(), tmp_path / "walk.bvh"
    )
    scene, wrong = tmp_path / "a.scene.yaml", "Z" if right == "Y" else "Y"
    text = "scene: animtool/1\nsource: {file: walk.bvh, up: %s}\noutput: a.usdc\n"
    scene.write_text(text % wrong.lower(), "utf-8")
    (line,) = [line for line in warnings("bake", scene) if "MOT214" in line]
    assert f"stands along {right}, but up: {wrong} was given" in line
    assert line.endswith(f"read it with up: {right}")
    scene.write_text(text % right.lower(), "utf-8")
    assert "MOT214" not in "".join(warnings("bake", scene, "--overwrite"))


@pytest.mark.parametrize(("right", "along"), [("Z", "Z"), ("Y", "-Z")])
def test_a_solve_whose_body_lies(right: str, along: str, tmp_path: Path) -> None:
    """A walk with one axis up, in a file of markers that is read with the other."""
    take = open_source(WALK).collect()
    take = trim(take, None, float(take.clock.times[9]))
    corners = {"a": (0.1, 0.0, 0.0), "b": (0.0, 0.1, 0.0), "c": (0.0, 0.0, 0.1)}
    template = MarkerTemplate(
        tuple(
            TemplateMarker(f"{joint}_{corner}", joint, offset)
            for joint in take.rig.names
            for corner, offset in corners.items()
        )
    )
    world = reorient(TakeStream.of(take), UpAxis(right)).collect().world()
    offsets = np.array(list(corners.values()))
    points = world.positions[:, :, None] + np.einsum(
        "fjab,kb->fjka", world.linear, offsets
    )
    names = tuple(marker.name for marker in template.markers)
    captured_walk = Markers(names, take.clock, points.reshape(len(points), -1, 3))
    (tmp_path / "w.rig.yaml").write_text(rig_text(take.rig), "utf-8")
    text = template_text(template, "all", "w.rig.yaml")
    (tmp_path / "w.markers.yaml").write_text(text, "utf-8")
    write_marker_arrays(replace(captured_walk, up=UpAxis.Z), tmp_path / "w.npz")
    command = ("mocap", "solve", "w.npz", "--template", "w.markers.yaml", "--up")
    wrong = "Z" if right == "Y" else "Y"
    lines = warnings(*command, wrong.lower(), cwd=tmp_path)
    (line,) = [line for line in lines if "MOT214" in line]
    assert f"the body stands along {along}, " in line
    assert line.endswith(f"read it with --up {right}")
    assert "MOT214" not in "".join(warnings(*command, right.lower(), cwd=tmp_path))


def test_a_rate_that_no_camera_has(tmp_path: Path) -> None:
    few = shorter(tmp_path / "few.bvh", 3)
    for flag in ("--fps", "--source-fps"):
        command = ("bake", few, "-o", tmp_path / "a.usdc", "--overwrite", flag)
        (line,) = warnings(*command, "100000")
        assert f"TAKE009 {flag} 100000 is implausible" in line
        assert not warnings(*command, "1000")


def test_markers_that_never_move(tmp_path: Path) -> None:
    (tmp_path / "f.rig.yaml").write_text(rig_text(FIGURE), "utf-8")
    text = template_text(TEMPLATE, "all", "f.rig.yaml")
    (tmp_path / "f.markers.yaml").write_text(text, "utf-8")
    markers = captured(moving(60, 100, 3)).markers
    still = replace(markers, positions=np.repeat(markers.positions[:1], 60, axis=0))
    write_marker_arrays(markers, tmp_path / "take.npz")
    write_marker_arrays(still, tmp_path / "still.npz")
    command = ("mocap", "solve", "--template", "f.markers.yaml")
    (line,) = warnings(*command, "still.npz", cwd=tmp_path)
    assert "SOL108 no marker moves by more than 2 mm in 60 frames" in line
    assert not warnings(*command, "take.npz", cwd=tmp_path)


def test_markers_in_another_unit(tmp_path: Path) -> None:
    markers = captured(moving(60, 100, 3)).markers
    for scale, text, hint in (
        (1e-3, "1000 times that", "set the unit of the file with --units"),
        (1e3, "in mm it would be 1", "set --units mm"),
    ):
        scaled = replace(markers, positions=scale * markers.positions)
        write_marker_arrays(scaled, tmp_path / "take.npz")
        done = animtool("mocap", "fill", "take.npz", "-o", "b.npz", cwd=tmp_path)
        (line,) = [line for line in done.stderr.splitlines() if "MKR117" in line]
        assert text in line
        assert line.endswith(hint)
        for name in ("take.npz", "b.npz"):
            (tmp_path / name).unlink()
    clouds = [
        plausibility_warnings(markers),
        plausibility_warnings(replace(markers, clock=SLOW)),
    ]
    assert [[one.code for one in found] for found in clouds] == [[], ["TAKE009"]]


def test_gaps_that_an_option_leaves(tmp_path: Path) -> None:
    markers = captured(moving(60, 100, 3)).markers
    gone = markers.positions.copy()
    gone[20:40, 3] = np.nan
    write_marker_arrays(replace(markers, positions=gone), tmp_path / "take.npz")
    command = ("mocap", "fill", "take.npz", "-o", "b.npz", "--longest", "0.05")
    (line,) = warnings(*command, cwd=tmp_path)
    assert line.endswith("longer gaps are left by --longest 0.05")


def test_single_markers_that_never_move() -> None:
    path = np.linspace(0, 1, MIN_MOVING_FRAMES)[:, None, None] * np.ones((1, 4, 3))
    path[:, 2] = 0.5
    (notice,) = static_notices(("a", "b", "c", "d"), path)
    assert notice.code == "SOL108"
    assert notice.message.endswith("while others move by 1.73 m: c")
    assert not static_notices(("a", "b", "c", "d"), path[1:])
    assert not static_notices(("a", "b", "c", "d"), 1e-2 * path)


def test_a_map_that_crosses_sides(tmp_path: Path) -> None:
    names = {"LeftHand": "wrist_r", "RightHand": "wrist_l"}
    entries = "".join(f"- {{source: {a}, target: {b}}}\n" for a, b in names.items())
    path = tmp_path / "crossed.map.yaml"
    path.write_text(f"map: animtool/1\nothers: auto\njoints:\n{entries}", "utf-8")
    lines = warnings("retarget", WALK, "--to", CHILD, "--map", path)
    (line,) = [line for line in lines if "MAP108" in line]
    assert line.startswith(f"{path}:4:3: warning: MAP108 joints[0]: 2 joints of ")
    assert "LeftHand to wrist_r, RightHand to wrist_l" in line


def test_a_unit_that_makes_a_giant(tmp_path: Path) -> None:
    command = ("mocap", "clean", WALK, "-o", tmp_path / "a.usdc", "--units", "m")
    (line,) = warnings(*command)
    assert "RIG217" in line
    assert "--units cm would make it" in line


@pytest.mark.parametrize(
    ("lengths", "hint"),
    [
        ("shortest: 24, longest: 40", "write shortest: 0.8, longest: 1.33"),
        ("shortest: 30", "for 30 frames write shortest: 1"),
        ("shortest: 300", "lower shortest:, or raise longest:"),
        ("shortest: 4.5, longest: 6", "use a longer take, or lower shortest:"),
    ],
)
def test_a_loop_whose_lengths_are_in_frames(
    tmp_path: Path, lengths: str, hint: str
) -> None:
    scene, walk = tmp_path / "a.scene.yaml", shorter(tmp_path / "walk.bvh", 64)
    scene.write_text(
        f"scene: animtool/1\nsource: {{file: {walk.name}}}\n"
        f"passes:\n- loop: {{find: true, {lengths}}}\noutput: {{file: a.usdc}}\n",
        "utf-8",
    )
    (line,) = warnings("bake", scene, code=3)
    assert "SCN018 passes[0].loop" in line
    assert line.endswith(hint)


def test_rays_of_focal_lengths_in_millimetres(tmp_path: Path) -> None:
    """One error, at the focal length: not one at the file, after a warning."""
    source = Path(__file__).parents[2] / "samples/capture"
    text = (source / "stage.cameras.yaml").read_text("utf-8")
    cameras = tmp_path / "mm.cameras.yaml"
    cameras.write_text(re.sub(r"focal: \[[^]]*\]", "focal: [24, 24]", text), "utf-8")
    (line,) = warnings(
        "mocap", "triangulate", source / "take.npz", "--cameras", cameras,
        "-o", tmp_path / "a.npz", code=2,
    )  # fmt: skip
    assert "CAM014 views[0].focal: " in line
    assert "24 * 1920 / 36 = 1280" in line


def test_a_skeleton_in_decimetres(tmp_path: Path) -> None:
    """In no unit of --units is it a person."""
    for factor, words in (
        (0.1, "in decimetres it would be 2.1 m: export it in cm, at 10 times"),
        (0.01, "--units m would make it 2.1 m"),
        (1e-4, "export it at its true size"),
        (1.0, None),
    ):
        text = "".join(
            " ".join(scaled_words(line.split(" "), factor))
            if "OFFSET" in line
            else line
            for line in WALK.read_text("utf-8").splitlines(keepends=True)
        )
        path = tmp_path / "a.bvh"
        path.write_text(text, "utf-8")
        done = animtool("bake", path, "-o", tmp_path / "a.usdc", "--overwrite")
        lines = [line for line in done.stderr.splitlines() if "RIG217" in line]
        assert len(lines) == (words is not None)
        assert words is None or words in lines[0]


def scaled_words(words: list[str], factor: float) -> list[str]:
    """Return the words of a line of a BVH with its three offsets multiplied."""
    return [
        f"{float(word) * factor:.6f}" + "\n" * word.endswith("\n")
        if any(character.isdigit() for character in word)
        else word
        for word in words
    ]


def test_a_loop_of_one_frame(tmp_path: Path) -> None:
    one = shorter(tmp_path / "one.bvh", 1)
    (line,) = warnings("loop", one, code=2)
    assert "SCN018" in line
    assert line.endswith("a cycle needs several frames: choose another take")
    (line,) = warnings("loop", shorter(tmp_path / "two.bvh", 2), code=2)
    assert line.endswith("use a longer take, or lower --shortest")
    text = (
        f"scene: animtool/1\nsource: {{file: {one.name}}}\npasses: [{{loop: {{}}}}]\n"
    )
    scene = tmp_path / "a.scene.yaml"
    scene.write_text(f"{text}output: {{file: a.usdc}}\n", "utf-8")
    (line,) = warnings("bake", scene)
    assert "SCN114 passes[0].loop: the take has one frame" in line


def test_hints_name_their_callers_words(tmp_path: Path) -> None:
    done = animtool("bake", WALK, "-o", tmp_path / "a.usdc", "--fps", "17")
    shown = {line.split()[2]: line for line in done.stderr.splitlines()}
    assert shown["TAKE006"].endswith("; --keep-samples writes it")
    assert shown["TAKE007"].endswith("; --keep-samples keeps the frames as is")
    (notice,) = [
        notice
        for notice in resampled(open_source(WALK).collect(), 17).notices
        if notice.code == "TAKE007"
    ]
    assert notice.hint == "smooth=True interpolates smoothly"


@pytest.mark.parametrize(("unit", "found"), [("mm", True), ("m", False)])
def test_a_unit_that_makes_a_speck_of_a_gltf(
    unit: str, found: bool, tmp_path: Path
) -> None:
    source = write_small(tmp_path / "small.gltf")
    lines = warnings("bake", source, "-o", tmp_path / "a.usda", "--units", unit)
    found_lines = [line for line in lines if "RIG217" in line]
    assert len(found_lines) == found
    assert all("use --units m" in line for line in found_lines)


@pytest.mark.parametrize(
    ("options", "found"),
    [
        (("--fps", "0.5"), True),
        (("--range", "1-9x40"), True),
        (("--range", "3"), False),
        (("--fps", "12"), False),
    ],
)
def test_one_frame_of_several(
    options: tuple[str, ...], found: bool, tmp_path: Path
) -> None:
    few = shorter(tmp_path / "few.bvh", 20)
    lines = warnings("bake", few, "-o", tmp_path / "a.usda", *options)
    assert sum("TAKE010" in line for line in lines) == found


def test_a_capture_is_not_replaced_by_its_bake(tmp_path: Path) -> None:
    walk, layer = shorter(tmp_path / "walk.bvh", 3), tmp_path / "walk.usdc"
    assert animtool("bake", walk, "-o", layer).code == 0
    done = animtool("bake", layer, "-o", walk)
    assert done.code == 2
    (command,) = re.findall(r"write animtool (.*?);", done.stderr)
    assert animtool(*command.split()).code == 0
    skipped = animtool("bake", layer, "-o", walk, "--skip-existing")
    assert (skipped.code, "skipped" in skipped.stderr) == (0, True)


def test_an_output_among_the_inputs_of_a_batch(tmp_path: Path) -> None:
    shorter(tmp_path / "walk.bvh", 3)
    (tmp_path / "empty").mkdir()
    for output in ("out", "out/", "empty", "out.usdc", "out/{stem}.usdc"):
        done = animtool("batch", "walk.bvh", output, cwd=tmp_path)
        assert done.code == 2, output
        (words,) = re.findall(r"use -o (.*)", done.stderr)
        again = animtool("batch", "walk.bvh", "-o", words.strip("'"), cwd=tmp_path)
        assert again.code == 0, again.stderr
    assert not (tmp_path / "walk.usdc").exists()


def test_a_missing_input_of_a_batch_is_named_before_it_runs(tmp_path: Path) -> None:
    shorter(tmp_path / "walk.bvh", 3)
    command = ("batch", "walk.bvh", "wlk.bvh", "-o", "{stem}.usdc", "-n")
    (line,) = warnings(*command, cwd=tmp_path)
    assert "BAT067 'wlk.bvh' does not exist" in line
    assert "'walk.bvh'" in line


def test_an_option_that_only_bake_has(tmp_path: Path) -> None:
    done = animtool("convert", WALK, tmp_path / "a.usda", "--rig", CHILD)
    assert done.code == 2
    clip = tmp_path / "a.clip.yaml"
    clip.write_text(
        f"clip: animtool/1\nrig: {CHILD}\nfps: 24\nrange: [1, 2]\nchannels: []\n",
        "utf-8",
    )
    done = animtool("convert", clip, tmp_path / "b.usda", "--units", "cm")
    assert "bake --to-units" in done.stderr
    assert "to_units:" not in done.stderr


@pytest.mark.parametrize(
    ("rate", "found"), [("120", True), ("24", True), ("30", False), ("29.97", False)]
)
def test_a_rate_that_the_file_contradicts(
    rate: str, found: bool, tmp_path: Path
) -> None:
    few = shorter(tmp_path / "few.bvh", 30)
    assert open_source(few).fps == 30
    done = animtool("bake", few, "-o", tmp_path / "a.usda", "--source-fps", rate)
    lines = [line for line in done.stderr.splitlines() if "TAKE011" in line]
    assert len(lines) == found
    for line in lines:
        assert f"not --source-fps {rate}: 30 frames last {30 / int(rate):.3g} s" in line
        assert "instead of 1 s" in line


@pytest.mark.parametrize(
    ("fps", "rate"), [("0.0333", "30"), ("0.0417083", "24000/1001"), ("0.5", "")]
)
def test_a_frame_time_as_the_rate_of_a_source(
    fps: str, rate: str, tmp_path: Path
) -> None:
    few = shorter(tmp_path / "few.bvh", 3)
    scene = tmp_path / "a.scene.yaml"
    text = "scene: animtool/1\nsource: {file: few.bvh, fps: %s}\noutput: {file: %s}\n"
    scene.write_text(text % (fps, "a.usda"), "utf-8")
    for command in (
        ("validate", scene),
        ("bake", scene),
        ("bake", few, "-o", tmp_path / "b.usda", "--source-fps", fps),
    ):
        done = animtool(*command)
        lines = f"{done.stdout}\n{done.stderr}".splitlines()
        found = [line for line in lines if "TAKE0" in line]
        assert len(found) == 1, found
        assert f"fps {fps} is implausible" in found[0]
        assert found[0].endswith(f"write {rate}") == bool(rate)
        if command[1] is scene:
            assert "a.scene.yaml:2:" in found[0]
    for plausible in ("24", "120", "12.5"):
        scene.write_text(text % (plausible, "a.usda"), "utf-8")
        assert "TAKE009" not in animtool("validate", scene).stdout


@pytest.mark.parametrize(
    ("joint", "found"), [("Hips", True), ("hero:Hips", False), ("a:b:Hips", False)]
)
def test_a_namespace_that_no_joint_has(joint: str, found: bool, tmp_path: Path) -> None:
    few = shorter(tmp_path / "few.bvh", 3)
    text = few.read_text("utf-8").replace("ROOT Hips", f"ROOT {joint}")
    few.write_text(text, "utf-8")
    command = ("bake", few, "-o", tmp_path / "a.usda", "--strip-namespace")
    lines = warnings(*command, "1")
    assert sum("USD125" in line for line in lines) == found
    assert "USD125" not in "".join(warnings(*command, "0", "--overwrite"))
    (more,) = (
        line for line in warnings(*command, "3", "--overwrite") if "USD125" in line
    )
    assert found or f"write --strip-namespace {joint.count(':')}" in more


@pytest.mark.parametrize(("blend", "found"), [("500", True), ("12", False)])
def test_a_blend_longer_than_the_cycle(blend: str, found: bool, tmp_path: Path) -> None:
    few = shorter(tmp_path / "few.bvh", 40)
    cycle = ("loop", few, "--first", "2", "--last", "34")
    lines = [line for line in warnings(*cycle, "--blend", blend) if "SCN115" in line]
    assert len(lines) == found
    assert all("the cycle of 32 frames" in line for line in lines)
    assert "SCN115" not in "".join(warnings("loop", few, "--first", "2", "--last", "7"))


def test_a_tolerance_that_hides_every_difference(tmp_path: Path) -> None:
    few, many = shorter(tmp_path / "few.bvh", 4), tmp_path / "many.bvh"
    many.write_text(few.read_text("utf-8").replace("0 10 0", "0 11 0"), "utf-8")
    (line,) = warnings("diff", few, many, "--tolerance", "20", "--angle-tolerance", "9")
    assert "CLI107 --tolerance 20 m hides every difference" in line
    assert not warnings("diff", few, many, "--tolerance", "5mm", code=1)
    assert not warnings("diff", few, few, "--tolerance", "20")
