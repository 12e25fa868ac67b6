"""Input that is probably a mistake: one warning, with numbers and what to do."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool
from support.marked import FIGURE, TEMPLATE, captured, moving

from animtool import open_source
from animtool.capture.solve.run import (
    MIN_MOVING_FRAMES,
    solve_markers,
    static_notices,
)
from animtool.capture.templates import MarkerTemplate, TemplateMarker
from animtool.capture.templates.template import template_text
from animtool.core.units import UpAxis
from animtool.edit import resampled, trim
from animtool.formats.bvh.write import write_bvh
from animtool.formats.marker_arrays import write_marker_arrays
from animtool.motion.markers import Markers
from animtool.motion.reorient import reorient
from animtool.motion.take import TakeStream
from animtool.rig.write import rig_text

SAMPLE = Path(__file__).parents[2] / "samples/retarget"
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


@pytest.mark.parametrize("command", ["clean", "retarget", "loop", "bake"])
@pytest.mark.parametrize("right", ["Y", "Z"])
def test_an_up_axis_that_the_body_contradicts(
    command: str, right: str, tmp_path: Path
) -> None:
    walk = tmp_path / "walk.bvh"
    write_bvh(reorient(open_source(WALK), UpAxis(right)).collect(), walk)
    wrong = "Z" if right == "Y" else "Y"
    words: tuple[str | Path, ...] = {
        "clean": ("mocap", "clean", walk, "-o", tmp_path / "a.usdc"),
        "retarget": ("retarget", walk, "--to", CHILD),
        "loop": ("loop", walk),
        "bake": ("bake", walk, "-o", tmp_path / "a.usdc"),
    }[command]
    lines = [line for line in warnings(*words, "--up", wrong) if "MOT214" in line]
    (line,) = lines
    assert f"the body stands along {right}, but the up axis is {wrong}" in line
    assert line.endswith(f"read it with --up {right}")
    again = () if command in {"retarget", "loop"} else ("--overwrite",)
    assert "MOT214" not in "".join(warnings(*words, "--up", right, *again))


def test_a_solve_whose_body_lies() -> None:
    """A walk with Z up, in a file of markers that states Y."""
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
    world = reorient(TakeStream.of(take), UpAxis.Z).collect().world()
    offsets = np.array(list(corners.values()))
    points = world.positions[:, :, None] + np.einsum(
        "fjab,kb->fjka", world.linear, offsets
    )
    names = tuple(marker.name for marker in template.markers)
    captured_walk = Markers(names, take.clock, points.reshape(len(points), -1, 3))
    (notice,) = [
        notice
        for notice in solve_markers(captured_walk, take.rig, template).take().notices
        if notice.code == "MOT214"
    ]
    assert notice.message == "the body stands along Z, but the up axis is Y"
    assert notice.severity == "warning"
    right = replace(captured_walk, up=UpAxis.Z)
    codes = [n.code for n in solve_markers(right, take.rig, template).take().notices]
    assert "MOT214" not in codes


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
    assert line.startswith(f"{path}: warning: MAP108 2 joints of ")
    assert "LeftHand to wrist_r, RightHand to wrist_l" in line


def test_a_unit_that_makes_a_giant(tmp_path: Path) -> None:
    command = ("mocap", "clean", WALK, "-o", tmp_path / "a.usdc", "--units", "m")
    (line,) = warnings(*command)
    assert "RIG217" in line
    assert "with --units cm it would be" in line


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
