"""``animtool mocap triangulate``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.cli import Done, animtool
from support.stage import (
    cameras_text,
    changed,
    observed,
    ring,
    walkers,
    write_observations,
)

from animtool.capture.cameras import triangulate

STAGE = ring(4)
POINTS = walkers(30, 5)


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """Return a folder with observations and the cameras that made them."""
    write_observations(tmp_path / "take.npz", observed(STAGE, POINTS))
    (tmp_path / "stage.cameras.yaml").write_text(cameras_text(STAGE), "utf-8")
    return tmp_path


def run(folder: Path, *more: object, output: str = "out.npz") -> Done:
    return animtool("mocap", "triangulate", "take.npz", "--cameras",
                    "stage.cameras.yaml", "-o", output, *more, cwd=folder)  # fmt: skip


def test_exchanged_inputs_are_named(capture: Path) -> None:
    swapped = "stage.cameras.yaml", "--cameras", "take.npz", "-o", "out.npz"
    done = animtool("mocap", "triangulate", *swapped, cwd=capture)
    assert done.code == 2
    assert "take.npz: IO002" in done.stderr
    assert "triangulate take.npz --cameras stage.cameras.yaml" in done.stderr


def test_files_are_written_and_reported(capture: Path) -> None:
    done = run(capture, "--format", "json")
    assert done.code == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["points"] == {"seen": 150, "found": 150}
    assert 0 < report["reprojection"]["px"] < 1
    assert [c["name"] for c in report["cameras"]] == list(STAGE.names)
    with np.load(capture / "out.npz") as made:
        off = np.linalg.norm(made["markers_m"] - POINTS, axis=-1)
        assert made["cameras"].max() == 4
    assert off.max() < 0.01
    first = (capture / "out.npz").read_bytes()
    done = run(capture, "--overwrite")
    assert (capture / "out.npz").read_bytes() == first
    assert "reprojection" in done.stderr
    assert " mm)" in done.stderr
    done = run(capture, output="out.trc")
    assert done.code == 0, done.stderr
    assert (capture / "out.trc").is_file()


@pytest.mark.parametrize(
    ("more", "output", "code", "fault"),
    [
        (("--gate", "0"), "out.npz", 2, "CAP001"),
        ((), "out.bvh", 2, "OUT004"),
        (("--cameras", "none.toml"), "out.npz", 3, "IO001"),
        (("--cameras", "stage.cameras.yaml"), "out.npz", 3, "CAM002"),
        (("--strict", "--noise", "0.01"), "out.npz", 1, "CAM1"),
    ],
)
def test_faults_write_nothing(
    capture: Path, more: tuple[str, ...], output: str, code: int, fault: str
) -> None:
    done = run(capture, *more, output=output)
    assert (done.code, fault in done.stderr) == (code, True), done.stderr
    assert not (capture / output).exists()
    assert "Traceback" not in done.stderr


def test_keypoints_want_a_rate(capture: Path) -> None:
    (capture / "pose/cam0").mkdir(parents=True)
    (capture / "pose/cam0/take_0_keypoints.json").write_text('{"people": []}', "utf-8")
    done = animtool("mocap", "triangulate", "pose", "--cameras", "stage.cameras.yaml",
                    "-o", "out.npz", cwd=capture)  # fmt: skip
    assert done.code == 2
    assert "--source-fps" in done.stderr


def test_validate_and_schema(capture: Path) -> None:
    assert animtool("validate", "stage.cameras.yaml", cwd=capture).code == 0
    schema = json.loads(animtool("schema", "cameras").stdout)
    assert set(schema["required"]) == {"cameras", "views"}


def test_a_camera_that_moved_is_reported_with_its_frames(tmp_path: Path) -> None:
    """Frames of reports count from 1; the last one is the last that it moved in."""
    seen = observed(ring(6), walkers(90, 8))
    pixels = seen.stored.copy()
    pixels[30:60, 4] += [9.0, 6.0]
    moved = changed(seen, pixels)
    (stretch,) = triangulate(moved, ring(6)).cameras[4].shifts
    write_observations(tmp_path / "take.npz", moved)
    (tmp_path / "stage.cameras.yaml").write_text(cameras_text(ring(6)), "utf-8")
    report = json.loads(run(tmp_path, "--format", "json").stdout)
    (entry,) = report["cameras"][4]["moved"]
    assert (entry["first"], entry["last"]) == (stretch.first + 1, stretch.end)
    assert entry["last"] - entry["first"] + 1 == stretch.end - stretch.first


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ('{"a": 1}', "take.npz --cameras"),
        ('{"cameras": [], "unit": "mm"}', "--cameras wrong.json"),
        ('{"people": []}', "pose/ --cameras"),
    ],
)
def test_a_json_file_is_told_what_is_wanted(
    capture: Path, text: str, hint: str
) -> None:
    (capture / "wrong.json").write_text(text, "utf-8")
    done = animtool("mocap", "triangulate", "wrong.json", "--cameras",
                    "stage.cameras.yaml", "-o", "out.npz", cwd=capture)  # fmt: skip
    assert done.code == 3
    assert "CAM010" in done.stderr
    assert hint in " ".join(done.stderr.split())
    assert not (capture / "out.npz").exists()


def test_single_frames_that_disagree_are_reported(tmp_path: Path) -> None:
    seen = observed(ring(5), walkers(60, 8))
    pixels = seen.stored.copy()
    pixels[[20, 41], 2] += [20.0, 10.0]
    write_observations(tmp_path / "take.npz", changed(seen, pixels))
    (tmp_path / "stage.cameras.yaml").write_text(cameras_text(ring(5)), "utf-8")
    report = json.loads(run(tmp_path, "--format", "json").stdout)
    named = [[each["frame"] for each in c["disagrees"]] for c in report["cameras"]]
    assert named == [[], [], [21, 42], [], []]
    assert "CAM111" in [notice["code"] for notice in report["notices"]]
    done = run(tmp_path, "--overwrite")
    assert "disagrees 21, 42" in done.stderr
