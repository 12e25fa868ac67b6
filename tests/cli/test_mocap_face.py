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


@pytest.mark.slow
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


@pytest.mark.parametrize("words", [(), ("--head", "none"), ("--neutral", "0")])
def test_mirrored_landmarks_are_named(
    tmp_path: Path, landmarks: Path, words: tuple[str, ...]
) -> None:
    arrays = dict(np.load(landmarks))
    arrays["landmarks_mm"] = arrays["landmarks_mm"] * [-1, 1, 1]
    np.savez(landmarks, **arrays)
    command = ("mocap", "face", landmarks, *RIG, *OWN, *words, "--format", "json")
    done = animtool(*command, "-o", tmp_path / "a.usdc")
    assert done.code == 0, done.stderr
    codes = [notice["code"] for notice in json.loads(done.stdout)["notices"]]
    assert "FAC112" in codes
    assert {"FAC104", "FAC105", "FAC110", "FAC111"}.isdisjoint(codes)
    notices = json.loads(done.stdout)["notices"]
    (hint,) = (n["hint"] for n in notices if n["code"] == "FAC112")
    assert hint == "negate x of the landmarks"


def test_names_of_sides_may_be_swapped(tmp_path: Path, landmarks: Path) -> None:
    arrays = dict(np.load(landmarks))
    arrays["landmarks_mm"] = arrays["landmarks_mm"] * [-1, 1, 1]
    names = arrays["landmark_names"].astype("U9")
    names[:2] = ["eye_l", "eye_r"]
    np.savez(landmarks, **arrays | {"landmark_names": names})
    own = (ROOT / "samples/face/head.landmarks.yaml").read_text("utf-8")
    own = own.replace("m00", "eye_l").replace("m01", "eye_r")
    own = own.replace("rig: ../../rigs/head/head.rig.yaml\n", "")
    (tmp_path / "a.landmarks.yaml").write_text(own, "utf-8")
    own_words = (
        "--landmarks",
        tmp_path / "a.landmarks.yaml",
        "-o",
        tmp_path / "a.usdc",
    )
    done = animtool("mocap", "face", landmarks, *RIG, *own_words)
    assert done.code == 0, done.stderr
    (line,) = [line for line in done.stderr.splitlines() if "FAC112" in line]
    assert "negate x of the landmarks, or swap the names of left" in line


@pytest.mark.slow
def test_landmarks_seen_in_a_mirror_are_named(tmp_path: Path, landmarks: Path) -> None:
    arrays = dict(np.load(landmarks))
    points = arrays.pop("landmarks_mm") / 1000 - [0, 1.6, 0]
    # Half a metre in front of a camera that looks along +Z, v down.
    depth = 0.5 - points[..., 2]
    u, v = (600 * points[..., k] / depth for k in (0, 1))
    (tmp_path / "a.cameras.yaml").write_text(
        "cameras: animtool/1\nviews:\n- {name: a, focal: [600, 600], "
        "centre: [320, 240], size: [640, 480], rotation: [1, 0, 0, 0], "
        "translation: [0, 0, 0]}\n"
    )
    for name, sign, v_sign, hint in (
        ("seen", 1, -1, ""),
        ("mirrored", -1, -1, "width of the image minus u"),
        ("v up", 1, 1, "height of the image minus v"),
    ):
        pixels = np.stack([320 + sign * u, 240 + v_sign * v], axis=-1)
        np.savez(landmarks, landmarks_px=pixels, **arrays)
        camera = ("--camera", tmp_path / "a.cameras.yaml")
        command = ("mocap", "face", landmarks, *RIG, *OWN, *camera)
        done = animtool(*command, "-o", tmp_path / f"{name}.usdc")
        assert done.code == 0, done.stderr
        assert ("FAC112" in done.stderr) == bool(hint), done.stderr
        assert hint in done.stderr


def test_landmarks_without_positions_on_the_rig(root: Path, tmp_path: Path) -> None:
    done = animtool(
        *("mocap", "face", root / "samples/face/speech.npz"),
        *("--rig", root / "rigs/head/head.rig.yaml", "-o", tmp_path / "a.usdc"),
    )
    assert done.code == 2
    assert "FAC003" in done.stderr
    assert "--landmarks FILE" in done.stderr


def test_landmarks_may_name_a_rig_that_is_missing(
    tmp_path: Path, landmarks: Path
) -> None:
    text = OWN[1].read_text("utf-8")
    moved = tmp_path / "head.landmarks.yaml"
    moved.write_text(text.replace("\nrig:", "\nrig: none.rig.yaml #"), "utf-8")
    done = animtool("mocap", "face", landmarks, *RIG, "--landmarks", moved)
    assert done.code == 0, done.stderr
