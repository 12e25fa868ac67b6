"""``animtool mocap solve``: files in, files out, and what it says."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool
from support.marked import FIGURE, TEMPLATE, captured, moving

from animtool import Rig, open_source
from animtool.capture.solve.calibration import scale_rig_bones
from animtool.capture.templates import load_template
from animtool.capture.templates.template import template_text
from animtool.formats.marker_arrays import write_marker_arrays
from animtool.rig.write import rig_text


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a rig, its template and a take of a larger subject."""
    (tmp_path / "f.rig.yaml").write_text(rig_text(FIGURE), "utf-8")
    text = template_text(TEMPLATE, "all", "f.rig.yaml")
    (tmp_path / "f.markers.yaml").write_text(text, "utf-8")
    larger = scale_rig_bones(FIGURE, np.array([1.0, 1.1, 1.1, 1.1, 1.1, 1.1]))
    own = captured(moving(150, 100, 3, 1.2), 100, rig=larger)
    write_marker_arrays(own.markers, tmp_path / "own.npz")
    write_marker_arrays(captured(moving(60, 100, 3)).markers, tmp_path / "take.npz")
    return tmp_path


def test_a_take_is_written_and_reported(folder: Path) -> None:
    done = animtool(
        *("mocap", "solve", "take.npz", "--template", "f.markers.yaml"),
        *("-o", "take.usda", "--format", "json"),
        cwd=folder,
    )
    assert done.code == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["frames"] == 60
    assert report["rms"] < 0.001
    assert len(report["markers"]) == 14
    take = open_source(folder / "take.usda").collect()
    assert (take.clock.count, take.clock.rate) == (60, 100)


def test_bake_and_scenes_take_markers_too(folder: Path) -> None:
    done = animtool(
        "bake", "take.npz", "--template", "f.markers.yaml", "-o", "a.usda", cwd=folder
    )
    assert done.code == 0, done.stderr
    text = "scene: animtool/1\nrig: f.rig.yaml\nfps: 50\nsource: {file: take.npz, "
    text += "template: f.markers.yaml}\noutput: {file: b.usda}\n"
    (folder / "b.scene.yaml").write_text(text, "utf-8")
    done = animtool("bake", "b.scene.yaml", cwd=folder)
    assert done.code == 0, done.stderr
    assert open_source(folder / "b.usda").collect().clock.count == 30


def test_a_subject_is_written_and_nothing_is_replaced(folder: Path) -> None:
    command = (
        *("mocap", "solve", "own.npz", "--template", "f.markers.yaml", "--calibrate"),
        *("--write-rig", "own.rig.yaml", "--write-template", "own.markers.yaml"),
    )
    assert animtool(*command, cwd=folder).code == 0
    rig = Rig.load(folder / "own.rig.yaml")
    assert rig.joints[3].translation[0] == pytest.approx(0.33, abs=0.005)
    template = load_template(folder / "own.markers.yaml")
    assert template.rig == folder / "own.rig.yaml"
    done = animtool(*command, cwd=folder)
    assert (done.code, "OUT001" in done.stderr) == (2, True)


@pytest.mark.parametrize(
    ("given", "code"),
    [
        (["--write-rig", "x.rig.yaml"], "SOL009"),
        (["--calibrate", "--write-rig", "x.yaml"], "OUT004"),
        (["--subject", "Bob"], "SOL001"),
        (["--static", "take.npz"], "--calibrate"),
    ],
)
def test_what_makes_no_sense_is_refused(
    folder: Path, given: list[str], code: str
) -> None:
    command = ("mocap", "solve", "take.npz", "--template", "f.markers.yaml")
    done = animtool(*command, *given, cwd=folder)
    assert done.code == 2
    assert code in done.stderr
    assert sorted(path.suffix for path in folder.iterdir()).count(".usda") == 0


def test_a_rig_of_another_is_pointed_out(folder: Path) -> None:
    markers = tuple(
        replace(m, offset=(m.offset[0], m.offset[1] + 0.05 * (-1) ** i, m.offset[2]))
        for i, m in enumerate(TEMPLATE.markers)
    )
    text = template_text(replace(TEMPLATE, markers=markers), "off", "f.rig.yaml")
    (folder / "off.markers.yaml").write_text(text, "utf-8")
    done = animtool(
        "mocap", "solve", "take.npz", "--template", "off.markers.yaml", cwd=folder
    )
    assert "SOL107" in done.stderr


def test_another_rig_replaces_the_missing_one_of_a_template(folder: Path) -> None:
    (folder / "f.rig.yaml").rename(folder / "ann.rig.yaml")
    for command in ("solve", "fill"):
        words = ("mocap", command, "take.npz", "--template", "f.markers.yaml")
        words = (*words, "-o", "out.usda" if command == "solve" else "out.npz")
        done = animtool(*words, cwd=folder)
        assert (done.code, "DOC015" in done.stderr) == (3, True)
        done = animtool(*words, "--rig", "ann.rig.yaml", cwd=folder)
        assert done.code == 0, done.stderr
