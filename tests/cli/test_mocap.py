"""``animtool mocap clean``: from files to files, and what it says."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool
from support.marked import FIGURE, TEMPLATE, captured, column, moving

from animtool import open_source
from animtool.capture.options import CleanOptions
from animtool.capture.templates.template import template_text
from animtool.core.clock import Clock
from animtool.formats.marker_arrays import write_marker_arrays
from animtool.formats.marker_files import open_markers, write_markers
from animtool.maths import so3
from animtool.motion.markers import Markers
from animtool.motion.passes import find_pass
from animtool.rig.write import rig_text
from animtool.scene.convert.takes import convert_with_passes

WALK = "samples/walk/walk.bvh"


@pytest.mark.parametrize("suffix", ["usda", "bvh"])
def test_takes_are_cleaned(root: Path, tmp_path: Path, suffix: str) -> None:
    outputs = [tmp_path / f"{name}.{suffix}" for name in "ab"]
    for output in outputs:
        done = animtool("mocap", "clean", root / WALK, "-o", output, "--cutoff", "4")
        assert done.code == 0, done.stderr
        assert "CAP101" in done.stderr
        assert "4 Hz" in done.stderr
    assert outputs[0].read_bytes() == outputs[1].read_bytes()


def test_a_frequency_that_makes_no_sense_writes_nothing(
    root: Path, tmp_path: Path
) -> None:
    output = tmp_path / "clean.bvh"
    done = animtool("mocap", "clean", root / WALK, "-o", output, "--cutoff", "0")
    assert done.code == 2
    assert "CAP001" in done.stderr
    assert not list(tmp_path.iterdir())


def test_a_take_without_spikes_stays(root: Path, tmp_path: Path) -> None:
    output = tmp_path / "same.bvh"
    passes = [(find_pass("clean"), CleanOptions(keep_noise=True))]
    report = convert_with_passes(root / WALK, output, passes)
    assert not report.notices
    before, after = (open_source(p).collect().motion for p in (root / WALK, output))
    assert abs(before.rotations.dense() - after.rotations.dense()).max() < 1e-6


def test_feet_are_held_and_what_was_done_is_said(root: Path, tmp_path: Path) -> None:
    output = tmp_path / "held.bvh"
    arguments = ("--feet", "hold", "--noise", "keep", "--format", "json")
    done = animtool("mocap", "clean", root / WALK, "-o", output, *arguments)
    assert done.code == 0, done.stderr
    passes = {one["pass"]: one["scores"] for one in json.loads(done.stdout)["scores"]}
    assert list(passes) == ["clean", "feet"]
    drift = next(score for score in passes["feet"] if score["name"] == "drift")
    assert drift["value"] < 1e-6


def marker_file(folder: Path, name: str) -> Path:
    """Write a walk of ten markers with a gap, and return its path."""
    rng = np.random.default_rng(3)
    shape, time = rng.uniform(-0.2, 0.2, (10, 3)), np.arange(200) / 100.0
    turn = so3.exp(np.stack([0.3 * time, np.sin(time), 0 * time], axis=1))
    positions = so3.rotate(turn[:, None], shape[None])
    positions[60:90, 4] = np.nan
    names = tuple(f"M{i}" for i in range(10))
    write_markers(Markers(names, Clock(100, 1, 1, 200), positions), folder / name)
    return folder / name


def test_markers_are_converted_there_and_back(tmp_path: Path) -> None:
    source = marker_file(tmp_path, "take.c3d")
    for before, after in (
        ("take.c3d", "b.trc"),
        ("b.trc", "c.npz"),
        ("c.npz", "d.c3d"),
    ):
        done = animtool("convert", tmp_path / before, tmp_path / after)
        assert done.code == 0, done.stderr
    first, last = open_markers(source), open_markers(tmp_path / "d.c3d")
    assert first.names == last.names
    np.testing.assert_allclose(first.positions, last.positions, atol=1e-6)
    done = animtool("convert", source, tmp_path / "e.trc", "--take", "x")
    assert done.code == 2


def test_gaps_are_filled_and_listed(tmp_path: Path) -> None:
    source, output = marker_file(tmp_path, "take.c3d"), tmp_path / "whole.c3d"
    done = animtool("mocap", "fill", source, "-o", output, "--format", "json")
    assert done.code == 0, done.stderr
    report = json.loads(done.stdout)
    gap = {"marker": "M4", "first": 60, "last": 89, "method": "markers"}
    assert report["mocap fill"] == "animtool/1"
    assert report["gaps"] == [gap]
    whole = open_markers(output)
    assert whole.visible.all()
    assert whole.filled is not None
    assert np.flatnonzero(whole.filled[:, 4]).tolist() == list(range(60, 90))


def test_gaps_are_filled_by_a_skeleton(tmp_path: Path) -> None:
    (tmp_path / "f.rig.yaml").write_text(rig_text(FIGURE), "utf-8")
    text = template_text(TEMPLATE, "all", "f.rig.yaml")
    (tmp_path / "f.markers.yaml").write_text(text, "utf-8")
    markers = captured(moving(150, 100, 3), 100).markers
    markers.positions[60:90, column("LWRA")] = np.nan
    write_marker_arrays(markers, tmp_path / "take.npz")
    command = ("mocap", "fill", "take.npz", "-o", "whole.c3d")
    done = animtool(*command, "--template", "f.markers.yaml", cwd=tmp_path)
    assert done.code == 0, done.stderr
    assert "1 gap: 1 by the skeleton" in done.stderr
    assert open_markers(tmp_path / "whole.c3d").visible.all()
    for option in ("--rig", "--static"):
        done = animtool(*command, option, "take.npz", cwd=tmp_path)
        assert done.code == 2
        assert "needs a skeleton: pass --template too." in done.stderr


@pytest.mark.parametrize(
    ("rig", "names", "code"), [("", None, "SOL008"), ("f.rig.yaml", "Q{}", "SOL001")]
)
def test_a_skeleton_that_does_not_fit(
    tmp_path: Path, rig: str, names: str | None, code: str
) -> None:
    (tmp_path / "f.rig.yaml").write_text(rig_text(FIGURE), "utf-8")
    text = template_text(TEMPLATE, "all", rig or None)
    (tmp_path / "f.markers.yaml").write_text(text, "utf-8")
    markers = captured(moving(60, 100, 3), 100).markers
    markers.positions[20:40, 3] = np.nan
    if names is not None:
        renamed = tuple(names.format(i) for i in range(len(markers.names)))
        markers = replace(markers, names=renamed)
    write_marker_arrays(markers, tmp_path / "take.npz")
    command = ("mocap", "fill", "take.npz", "-o", "a.npz", "--template")
    done = animtool(*command, "f.markers.yaml", cwd=tmp_path)
    assert done.code == 2
    assert code in done.stderr
    assert not (tmp_path / "a.npz").exists()


def test_points_are_named_by_the_command(tmp_path: Path) -> None:
    source, output = marker_file(tmp_path, "take.trc"), tmp_path / "named.npz"
    words = ("--static", source, "-o", output, "--format", "json")
    done = animtool("mocap", "label", source, *words)
    assert done.code == 0, done.stderr
    assert json.loads(done.stdout)["mocap label"] == "animtool/1"
    assert open_markers(output).names == open_markers(source).names


def test_info_of_markers(tmp_path: Path) -> None:
    done = animtool("info", marker_file(tmp_path, "take.c3d"), "--format", "json")
    (found,) = json.loads(done.stdout)["files"]
    assert (found["markers"], found["gaps"], found["frames"]) == (10, 1, 200)
    assert found["longest_gap"] == 0.3


def test_info_of_markers_without_gaps(tmp_path: Path) -> None:
    write_marker_arrays(captured(moving(20, 100, 3), 100).markers, tmp_path / "a.npz")
    done = animtool("info", tmp_path / "a.npz", "--format", "json")
    assert done.code == 0, done.stderr
    (found,) = json.loads(done.stdout)["files"]
    assert (found["gaps"], found["longest_gap"], found["missing"]) == (0, 0, 0)


def test_a_suffix_that_no_markers_are_written_to(tmp_path: Path) -> None:
    source = marker_file(tmp_path, "take.trc")
    done = animtool("mocap", "fill", source, "-o", tmp_path / "a.usda")
    assert done.code == 2
    assert "OUT004" in done.stderr


def test_markers_are_not_cleaned_but_filled(tmp_path: Path) -> None:
    write_marker_arrays(captured(moving(20, 100, 3)).markers, tmp_path / "take.npz")
    done = animtool("mocap", "clean", "take.npz", "-o", "a.usda", cwd=tmp_path)
    assert done.code == 2
    assert "SOL007" in done.stderr
    assert "animtool mocap fill take.npz" in done.stderr


def test_markers_are_solved_before_takes_are_compared(tmp_path: Path) -> None:
    source = marker_file(tmp_path, "take.trc")
    done = animtool("diff", source, source)
    assert (done.code, done.stdout) == (2, "")
    assert f"first make a take of them: animtool mocap solve {source}" in done.stderr


def test_two_arrays_of_one_file_have_one_notice(tmp_path: Path) -> None:
    random = np.random.default_rng(5)
    rest = random.uniform(0, 1700, (6, 3))
    static = np.repeat(rest[None], 40, axis=0)
    path = tmp_path / "take.npz"
    cloud = np.roll(static, 2, axis=1).astype(np.float32)
    names = np.array([f"M{i}" for i in range(6)])
    np.savez(path, fs=100, marker_names=names, static_mm=static, cloud_mm=cloud)
    arguments = (f"{path}#cloud_mm", "--static", f"{path}#static_mm")
    done = animtool("mocap", "label", *arguments, "-o", tmp_path / "a.npz")
    assert done.code == 0, done.stderr
    assert done.stderr.count("MKR103") == 1
