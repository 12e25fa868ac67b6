"""``animtool mocap face``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool

from animtool import open_source

ROOT = Path(__file__).parents[2]
OWN = ("--landmarks", ROOT / "samples/face/head.landmarks.yaml")
RIG = ("--rig", ROOT / "rigs/head/head.rig.yaml")


@pytest.fixture
def landmarks(tmp_path: Path) -> Path:
    """Return a few frames of the sample in which the mouth moves."""
    with np.load(ROOT / "samples/face/speech.npz") as whole:
        arrays = dict(whole)
    arrays["landmarks_mm"] = arrays["landmarks_mm"][60:72]
    np.savez(tmp_path / "speech.npz", **arrays)
    return tmp_path / "speech.npz"


def test_the_report_says_how_far_shapes_went(landmarks: Path) -> None:
    made = landmarks.with_name("face.usdc")
    done = animtool("mocap", "face", landmarks, *RIG, *OWN, "-o", made,
                    "--format", "json")  # fmt: skip
    assert done.code == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["mocap face"] == "animtool/1"
    assert report["frames"] == 12
    take = open_source(made).collect()
    assert take.motion.weights is not None
    rows = take.motion.weights.dense()
    names = [shape.name for shape in take.rig.shapes]
    most = dict(zip(names, rows.reshape(12, -1).max(axis=0).tolist(), strict=True))
    told = {shape["name"]: shape["max"] for shape in report["shapes"]}
    assert max(told.values()) > 0.1
    for name, value in told.items():
        assert value == pytest.approx(most.get(name, 0.0), abs=1e-6)


def test_a_rig_is_asked_for(landmarks: Path) -> None:
    made = landmarks.with_name("face.usdc")
    done = animtool("mocap", "face", landmarks, *OWN, "-o", made)
    assert done.code == 2
    assert "--rig" in done.stderr
    assert not made.exists()


def test_a_neutral_frame_with_an_expression(tmp_path: Path, landmarks: Path) -> None:
    """The mouth is open in a later frame; in the first, the face is at rest."""
    with np.load(ROOT / "samples/face/speech.npz") as whole:
        arrays = dict(whole)
    arrays["landmarks_mm"] = arrays["landmarks_mm"][::7]
    np.savez(landmarks, **arrays)
    made = tmp_path / "face.usdc"
    for frame, found in (("7", True), ("0", False)):
        done = animtool("mocap", "face", landmarks, *RIG, *OWN, "-o", made,
                        "--neutral", frame, "--overwrite")  # fmt: skip
        assert done.code == 0, done.stderr
        assert done.stderr.count("FAC111 with --neutral 7 ") == found
        assert "FAC105" not in done.stderr


def test_landmarks_without_positions_on_the_rig(root: Path, tmp_path: Path) -> None:
    done = animtool(
        *("mocap", "face", root / "samples/face/speech.npz"),
        *("--rig", root / "rigs/head/head.rig.yaml", "-o", tmp_path / "a.usdc"),
    )
    assert done.code == 2
    assert "FAC003" in done.stderr
    assert "--landmarks FILE" in done.stderr
