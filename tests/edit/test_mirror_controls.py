"""Controls in a mirror."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.nasty import nasty_take

from animtool import Clip, Rig
from animtool.edit.mirroring import ControlMirror, _control_effect, mirror
from animtool.motion.take import Take
from animtool.rig.controls import Control, Drive
from animtool.rig.expressions import parse_expression
from animtool.rig.kinematics import rest_world
from animtool.rig.sides import pair_sides
from animtool.rig.skeleton import Joint

RIG = """\
rig: animtool/1
name: bust
joints:
- {name: chest, type: free}
- {name: head, parent: chest, type: ball, translate: [0, 1, 0]}
- {name: arm_l, parent: chest, type: ball, translate: [1, 0, 0], mirror: arm_r}
meshes: []
controls:
- name: turn
  range: [-60, 60]
  default: 5
  drives: [{joint: head.rotation.y, expr: turn}]
- {name: nod, range: [-30, 30], drives: [{joint: head.rotation.x, expr: nod}]}
- {name: raise_l, range: [0, 90], drives: [{joint: arm_l.rotation.z, expr: raise_l}]}
- {name: raise_r, range: [0, 90], drives: [{joint: arm_r.rotation.z, expr: -raise_r}]}
- {name: swing_l, range: [-9, 9], drives: [{joint: arm_l.rotation.y, expr: swing_l}]}
- {name: swing_r, range: [-9, 9], drives: [{joint: arm_r.rotation.y, expr: swing_r}]}
"""
NAMES = ["turn", "nod", "raise_l", "raise_r", "swing_l", "swing_r"]
ENDS = [25, 8, 40, 10, 6, 0]


def keyed(values: list[float], folder: Path) -> Take:
    rig = folder / "bust.rig.yaml"
    rig.write_text(RIG, "utf-8")
    text = "clip: animtool/1\nrig: bust.rig.yaml\nfps: 24\nrange: [1, 3]\nchannels:\n"
    for name, value in zip(NAMES, values, strict=True):
        keys = f"[{{t: 1, v: 1}}, {{t: 3, v: {value}}}]"
        text += f"- {{target: control/{name}, interp: linear, keys: {keys}}}\n"
    (folder / "bust.clip.yaml").write_text(text, "utf-8")
    return Clip.load(folder / "bust.clip.yaml").sample(Rig.load(rig))


def test_mirrored_controls_drive_the_mirrored_pose(tmp_path: Path) -> None:
    seen = mirror(keyed(ENDS, tmp_path))
    assert seen.motion.controls is not None
    values = seen.motion.controls.dense()[-1, :, 0].tolist()
    # What turns about the middle changes its sign, what nods stays.
    assert_allclose(values, [-25, 8, 10, 40, 0, -6], atol=1e-12)
    again = keyed(values, tmp_path)
    for i in range(2):
        one, other = seen.motion.dense()[i], again.motion.dense()[i]
        assert_allclose(one[-1], other[-1], atol=1e-12)


@pytest.mark.slow
def test_shapes_of_one_side_turn_a_control_round(root: Path) -> None:
    rig = Rig.load(root / "rigs/head/head.rig.yaml")
    clip = Clip.load(root / "samples/speech/speech.clip.yaml", rig)
    take = clip.sample(rig)
    seen = mirror(take)
    assert take.motion.controls is not None
    assert seen.motion.controls is not None
    names = [control.name for control in rig.controls]
    before, after = (one.motion.controls.dense() for one in (take, seen))
    changed = {"turn": -1, "tilt": -1, "look_x": -1, "nod": 1, "look_y": 1, "jaw": 1}
    for name, sign in changed.items():
        i = names.index(name)
        assert before[:, i].any()
        np.testing.assert_allclose(after[:, i], sign * before[:, i], atol=1e-12)
    found = ControlMirror.from_rig(
        rig,
        pair_sides(names).partners,
        pair_sides(rig.names, rig.parents).partners,
        pair_sides([shape.name for shape in rig.shapes]).partners,
        np.array([-1.0, 1.0, 1.0]),
    )
    assert found.signs[names.index("mouth_side")] == -1
    twice = mirror(seen)
    assert twice.motion.controls is not None
    np.testing.assert_allclose(
        twice.motion.controls.dense(), take.motion.controls.dense(), atol=1e-12
    )


def test_controls_of_pairs_that_are_not_symmetric() -> None:
    take = nasty_take()
    names = [control.name for control in take.rig.controls]
    left, right = names.index("lift_l"), names.index("lift_r")
    seen = mirror(take)
    assert take.motion.controls is not None
    assert seen.motion.controls is not None
    before, after = take.motion.controls.dense(), seen.motion.controls.dense()
    assert_allclose(after[:, right], lift(take.rig, before[:, left]), atol=1e-12)
    assert_allclose(after[:, left], lift(take.rig, before[:, right]), atol=1e-12)
    assert_allclose(after[:, :2], before[:, :2])


def test_a_control_that_moves_nothing_keeps_its_sign(tmp_path: Path) -> None:
    path = tmp_path / "bust.rig.yaml"
    still = "{name: raise_l, range: [0, 90]}"
    drive = ", drives: [{joint: arm_l.rotation.z, expr: raise_l}]"
    one_way = RIG.replace(drive, "").replace("-raise_r", '"clamp(raise_r, 0, 90)"')
    path.write_text(one_way, "utf-8")
    rig = Rig.load(path)
    found = ControlMirror.from_rig(
        rig,
        pair_sides([control.name for control in rig.controls]).partners,
        pair_sides(rig.names, rig.parents).partners,
        np.zeros(0, np.int64),
        np.array([-1.0, 1.0, 1.0]),
    )
    assert still in one_way
    assert found.signs[NAMES.index("raise_l")] == 1


def test_a_control_that_cannot_be_0_is_mirrored_about_its_default(
    tmp_path: Path,
) -> None:
    text = RIG.replace(
        "range: [-60, 60]\n  default: 5", "range: [20, 60]\n  default: 40"
    )
    path = tmp_path / "bust.rig.yaml"
    path.write_text(text, "utf-8")
    rig = Rig.load(path)
    partners = np.arange(len(rig.controls))
    none = np.zeros(0, np.int64)
    way = np.array([-1.0, 1.0, 1.0])
    found = ControlMirror.from_rig(rig, partners, np.arange(len(rig.names)), none, way)
    turn = [control.name for control in rig.controls].index("turn")
    assert (found.signs[turn], found.pivots[turn]) == (-1, 40)


def lift(rig: Rig, values: np.ndarray) -> np.ndarray:
    """Return values of one lift as the other has them, by where the arms point."""
    across = np.array([-1.0, 1.0, 1.0])
    linear = rest_world(rig).linear[0]
    one, other = (linear[rig.index(name)][:, 2] for name in ("arm.L", "arm.R"))
    # Rotations turn the other way round in a mirror, and lift_r drives by its negative.
    return values * np.sign((one * -across) @ -other)


def test_a_control_is_moved_by_a_tenth_of_its_range_or_of_1() -> None:
    """One way and the other, by three times of what it is moved."""
    drives = (Drive("joint/a.translation.y", parse_expression("3 * c")),)
    for low, high, moved in ((None, None, 0.1), (-2.0, 3.0, 0.5), (0.0, None, 0.1)):
        rig = Rig(
            "r",
            (Joint("a", -1),),
            controls=(Control("c", low=low, high=high, drives=drives),),
        )
        for way in (1.0, -1.0):
            found, _ = _control_effect(rig, 0, way, rest_world(rig).linear[0])
            assert_allclose(found, [[0, 0, 0, 0, 3 * way * moved, 0]], atol=1e-12)
