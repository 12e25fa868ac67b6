"""A rig that is rescaled somewhere moves there as it does at home."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.clips import RIG, write_clip

from animtool import Clip
from animtool.core.array_types import FloatArray
from animtool.maths import so3
from animtool.rig.file import load_rig
from animtool.rig.placed import transform_rig
from animtool.rig.placement import Placement
from animtool.rig.skeleton import Rig
from animtool.rig.write import rig_text

# Slides that controls, other slides and angles drive, and what reads them.
LENGTHS = """
- {name: lift, parent: hips, type: prismatic, axis: [0, 0, 1]}
- {name: twin, parent: hips, type: prismatic, axis: [1, 0, 0],
   mimic: {joint: lift, gain: -0.5, offset: 2}}
- {name: crank, parent: hips, type: pin, axis: [0, 0, 1],
   mimic: {joint: lift, gain: 8, offset: 5}}
- {name: half, parent: chest, type: prismatic, axis: [0, 1, 0],
   driven: {expr: "lift.slide / 2 + 1"}}
- {name: bent, parent: chest, type: prismatic, axis: [0, 1, 0],
   driven: {by: elbow_l.angle, curve: [[0, 0], [90, 6]]}}
- {name: open, parent: chest, type: pin, axis: [1, 0, 0],
   driven: {by: lift.slide, curve: [[0, 0], [4, 40]], interp: smooth}}
bind:"""
CONTROLS = """
- {name: hoist, drives: [{joint: lift.slide, expr: "hoist * 4"},
   {joint: hips.translation.y, curve: [[0, 0], [1, 12]]}]}
- {name: felt, driven: {expr: "lift.slide / 4"}}
"""
KEYS = """
- {target: control/hoist, keys: [{t: 1, v: 0.1}, {t: 5, v: 0.9}]}
- {target: control/curl, keys: [{t: 1, v: 0.2}, {t: 5, v: 0.7}]}
"""


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    path = tmp_path / "hero.rig.yaml"
    path.write_text(RIG.replace("\nbind:", LENGTHS) + CONTROLS.lstrip())
    return load_rig(path)


def moved(rig: Rig, folder: Path) -> tuple[FloatArray, FloatArray]:
    """Return joints ``(F, J, 3)`` [m] and controls of a clip of a rig."""
    take = Clip.load(write_clip(folder, KEYS.lstrip()), rig).sample(rig)
    assert take.motion.controls is not None
    return take.world().positions, take.motion.controls.dense()


@pytest.mark.parametrize("size", [1.0, 0.01, 2.5])
def test_what_is_of_lengths_is_as_large_as_its_rig(
    rig: Rig, tmp_path: Path, size: float
) -> None:
    turn = so3.from_axis_angle([0.0, 0.6, 0.8], 0.7)
    placement = Placement(np.array([[3.0, 1.0, -2.0]]), turn[None], np.array([size]))
    before, controls = moved(rig, tmp_path)
    assert np.abs(np.ptp(before, axis=0)).max(axis=1).min() > 0.01
    rescaled = transform_rig(rig, replace(placement, rotations=so3.IDENTITY[None]))
    after, felt = moved(rescaled, tmp_path)
    np.testing.assert_allclose(after, placement.translations + size * before, atol=1e-9)
    np.testing.assert_allclose(felt, controls, atol=1e-12)
    # And as a file.
    path = tmp_path / "placed.rig.yaml"
    path.write_text(rig_text(rescaled))
    again, felt = moved(load_rig(path), tmp_path)
    np.testing.assert_allclose(again, after, atol=1e-9)
    np.testing.assert_allclose(felt, controls, atol=1e-9)
