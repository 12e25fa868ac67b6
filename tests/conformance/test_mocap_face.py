"""Faces with known weights: how near they are found, and frames of recordings."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from support.data import data_files
from support.suite import some_quick

from animtool import Rig, open_source
from animtool.capture.face import fit_face
from animtool.capture.face.capture import read_capture
from animtool.rig.shapes import arkit_name

HEAD = Path(__file__).parents[2] / "rigs/head/head.rig.yaml"
# What the project means to keep [1].
MAX_RMS, MAX_ERROR = 0.03, 0.3


def faces() -> list[object]:
    """Return the captures with a truth."""
    found = data_files("mocap", "face_*.npz")
    return [p for p in found if ".truth" not in (p.id or "")]


@pytest.mark.slow(1)
@pytest.mark.parametrize("path", some_quick(faces(), 3))
def test_weights_and_poses(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capture = read_capture(path)
    assert capture.model is not None
    truth = np.load(path.with_name(path.name.replace(".npz", ".truth.npz")))
    fit = fit_face(capture.model, capture.points, float(capture.clock.rate))
    off = fit.weights - truth["weights"]
    rms, most = float(np.sqrt((off**2).mean())), float(np.abs(off).max())
    turns = truth["head_quat_wxyz"][:, [1, 2, 3, 0]]
    angle = np.degrees(
        2 * np.arccos(np.minimum(1, np.abs((turns * fit.rotations).sum(1))))
    )
    shift = 1000 * np.linalg.norm(fit.translations - truth["head_t_m"], axis=1)
    with capsys.disabled():
        print(  # noqa: T201 - the score table
            f"\n{path.name}: weights RMS {rms:.4f}, max {most:.3f}; head "
            f"{angle.max():.3f} deg, {shift.max():.3f} mm at most; landmarks "
            f"{1000 * fit.rms:.3f} mm RMS, noise {1000 * fit.noise:.3f} mm"
        )
    assert rms <= MAX_RMS
    assert most <= MAX_ERROR
    assert angle.max() < 1
    assert shift.max() < 2


@pytest.mark.parametrize("path", data_files("mocap", "*.livelink.csv"))
def test_frames_of_recordings(path: Path) -> None:
    truth = json.loads(
        path.with_name(path.name.replace(".csv", ".truth.json")).read_text()
    )
    stream = open_source(path)
    kept = truth["kept_frames"]
    first = kept[0]
    missing = set(range(kept[-1] - first + 1)) - {frame - first for frame in kept}
    assert stream.details["dropped_frames"] == sorted(missing)
    assert stream.fps == truth["fps"]


@pytest.mark.parametrize("path", data_files("mocap/real", "*livelink*.csv"))
def test_real_recordings(path: Path) -> None:
    take = open_source(path).collect()
    assert take.motion.weights is not None
    known = {arkit_name(shape.name) for shape in take.rig.shapes}
    assert len(known - {None}) == 52
    assert take.clock.count > 1


def test_recordings_move_the_head() -> None:
    root = os.environ.get("ANIMTOOL_DATA")
    files = sorted(Path(root, "mocap").glob("*.livelink.csv")) if root else []
    if not files:
        pytest.skip("ANIMTOOL_DATA has no mocap/*.livelink.csv")
    from animtool.formats.livelink.read import read_livelink

    stream = read_livelink(files[0], rig=HEAD)
    rig = Rig.load(HEAD)
    take = stream.collect()
    assert take.motion.weights is not None
    alone = open_source(files[0]).collect()
    assert alone.motion.weights is not None
    moved, told = (
        {arkit_name(one.rig.shapes[i].name) for i in weights.animated.tolist()}
        for one, weights in (
            (take, take.motion.weights),
            (alone, alone.motion.weights),
        )
    )
    known = {arkit_name(shape.name) for shape in rig.shapes}
    assert moved == told & known
    assert len(moved) > 1
    assert rig.index("head") in take.motion.rotations.animated.tolist()
