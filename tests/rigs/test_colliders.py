"""The biped's capsules: they fill its body, mirror, and are made by their script."""

from __future__ import annotations

import sys
from pathlib import Path
from runpy import run_path

import numpy as np
import pytest
import yaml
from support.bodies import out_of_capsules, skin_of
from support.suite import nightly

from animtool import open_source
from animtool.clip.sample import sample_channels
from animtool.documents.arrays import load_array
from animtool.rig.file import load_rig

ROOT = Path(__file__).parents[2]
BIPED = ROOT / "rigs/biped"
FINGERS = ("thumb", "index", "middle", "ring", "pinky")


def of_fingers() -> np.ndarray:
    skin = load_rig(BIPED / "biped.rig.yaml").meshes[0].skin
    assert skin is not None
    first = load_array(BIPED / "body.npz", "weights").argmax(1)
    carriers = load_array(BIPED / "body.npz", "indices")[np.arange(len(first)), first]
    return np.array([name.startswith(FINGERS) for name in skin.joints])[
        carriers.astype(int)
    ]


@nightly
def test_the_script_makes_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept, made = BIPED / "biped.rig.yaml", tmp_path / "biped.rig.yaml"
    text = kept.read_text("utf-8")
    made.write_text(text.partition("colliders:")[0], "utf-8")
    script = BIPED / "make_colliders.py"
    monkeypatch.setattr(sys, "argv", [script.name, str(made)])
    monkeypatch.setattr(sys, "path", [str(BIPED), *sys.path])
    run_path(str(script), run_name="__main__")
    old, new = yaml.safe_load(text), yaml.safe_load(made.read_text("utf-8"))
    assert len(new["colliders"]) == len(old["colliders"])
    for ours, theirs in zip(new["colliders"], old["colliders"], strict=True):
        assert ours["joint"] == theirs["joint"]
        for name, value in theirs["capsule"].items():
            # Another processor may round the other way.
            np.testing.assert_allclose(ours["capsule"][name], value, atol=1.5e-4)
    del old["colliders"], new["colliders"]
    assert new == old


def test_they_mirror() -> None:
    rig = load_rig(BIPED / "biped.rig.yaml")
    flip = np.array([-1.0, 1.0, 1.0])
    sided = [c for c in rig.colliders if c.joint.endswith(("_l", "_r"))]
    assert len(sided) == 24
    for left, right in zip(sided[::2], sided[1::2], strict=True):
        assert right.joint == left.joint[:-2] + "_r"
        ours, theirs = left.capsule, right.capsule
        assert (ours.radius, ours.length) == (theirs.radius, theirs.length)
        assert np.array_equal(np.array(ours.axis) * flip, theirs.axis)
        assert np.array_equal(np.array(ours.offset) * flip, theirs.offset)
    for collider in rig.colliders:
        if collider not in sided:
            axis, offset = collider.capsule.axis, collider.capsule.offset
            assert offset[0] == 0
            assert axis[0] in {0, 1}


@pytest.mark.parametrize("moved", [False, True])
def test_their_surface_is_near_the_skin(*, moved: bool) -> None:
    rig = load_rig(BIPED / "biped.rig.yaml")
    motion = sample_channels((), rig, np.zeros(1)).motion
    if moved:
        walk = open_source(ROOT / "samples/stride/stride.clip.yaml").collect()
        motion = walk.motion.select(np.array([2, 8, 16]))
    points, _ = skin_of(rig, motion, "body")
    off = out_of_capsules(rig, motion, points)[:, ~of_fingers()]
    assert (np.abs(off) < 0.01).mean() > 0.88
    assert off.max() < 0.03
