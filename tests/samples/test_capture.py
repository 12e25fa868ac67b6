"""Eight cameras to a character: the script makes the files, and the walk comes back."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool
from support.printed import Printed

from animtool import open_source
from animtool.rig.kinematics import forward_kinematics

FOLDER = Path(__file__).parents[2] / "samples/capture"


def test_the_script_makes_the_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["make", str(tmp_path)])
    runpy.run_path(str(FOLDER / "make.py"), run_name="__main__")
    name = "stage.cameras.yaml"
    assert (tmp_path / name).read_text() == (FOLDER / name).read_text()
    with np.load(tmp_path / "take.npz") as made, np.load(FOLDER / "take.npz") as kept:
        assert made.files == kept.files
        np.testing.assert_array_equal(made["uv8"], kept["uv8"])


@pytest.mark.slow
def test_a_giant_walks_as_the_cameras_saw(tmp_path: Path) -> None:
    scene = FOLDER / "giant.scene.yaml"
    done = animtool("bake", scene, "-o", tmp_path / "giant.usdc", "--strict")
    assert done.code == 0, done.stderr
    assert "reprojection" in done.stderr


@pytest.mark.slow(1)
def test_the_walk_comes_back(printed: Printed) -> None:
    command = "animtool bake samples/capture/capture.scene.yaml -o capture.usdc"
    assert "warning: " not in printed.stderr(command)
    take = open_source(printed(command) / "capture.usdc").collect()
    assert (take.clock.count, take.clock.rate) == (37, 24)
    stride = open_source(FOLDER.parent / "stride/stride.clip.yaml")
    assert stride.curve is not None
    motion = stride.curve(1 + np.arange(37.0))
    truth = forward_kinematics(
        stride.rig, motion.translations.dense(), motion.rotations.dense()
    )
    names = take.rig.names
    for joint in ("hips", "wrist_l", "wrist_r", "ankle_l", "ankle_r", "toe_l"):
        own = take.world().positions[:, names.index(joint)]
        away = own - truth.positions[:, stride.rig.index(joint)]
        assert np.linalg.norm(away, axis=1).max() < 0.005, joint


@pytest.mark.slow
def test_it_goes_step_by_step(tmp_path: Path) -> None:
    markers = tmp_path / "markers.npz"
    cameras = FOLDER / "stage.cameras.yaml"
    done = animtool(
        *("mocap", "triangulate", FOLDER / "take.npz"),
        *("--cameras", cameras, "-o", markers),
    )
    assert done.code == 0, done.stderr
    template = FOLDER.parents[1] / "rigs/biped/biped.markers.yaml"
    done = animtool("mocap", "solve", markers, "--template", template)
    assert done.code == 0, done.stderr
    assert "43 markers" in done.stderr
