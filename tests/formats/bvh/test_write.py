from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.bvh import HEADER, random_rows, small_bvh
from support.faults import raises

from animtool.core.clock import Clock
from animtool.core.errors import AnimtoolError
from animtool.core.rates import rate_from_frame_time
from animtool.formats.bvh.read import read_bvh
from animtool.formats.bvh.write import build_bvh_text, frame_time, write_bvh
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.report.compare import compare_takes
from animtool.rig.parts import Shape
from animtool.rig.skeleton import Joint, Rig


def written(take: Take, path: Path) -> Take:
    path.write_bytes(b"".join(build_bvh_text(take).parts))
    return read_bvh(path).collect()


def test_text_comes_back(tmp_path: Path) -> None:
    rows = random_rows(10)
    path = tmp_path / "a.bvh"
    path.write_text(small_bvh(rows))
    take = read_bvh(path).collect()
    text = b"".join(build_bvh_text(take).parts).decode()
    assert text.startswith(HEADER)
    again = np.array([line.split() for line in text.splitlines()[-10:]], float)
    # Angles may be other triples of the same rotation; positions are the numbers.
    assert_allclose(again[:, :3], rows[:, :3], atol=1e-9)
    found = compare_takes(take, written(take, tmp_path / "b.bvh"))
    assert found.world.value < 1e-9
    assert found.rotation.value < 1e-6
    assert found.mismatches == []


def take_of(joints: tuple[Joint, ...], frames: int = 6, seed: int = 0) -> Take:
    rng = np.random.default_rng(seed)
    rig = Rig("r", joints, 0.01)
    translations = np.tile(rig.rest_translations, (frames, 1, 1))
    rotations = so3.align_signs(
        so3.normalize(rng.normal(size=(frames, len(joints), 4)))
    )
    motion = Motion(Channel.from_dense(translations), Channel.from_dense(rotations))
    return Take(rig, Clock(Fraction(30), Fraction(1), Fraction(1), frames), motion)


JOINTS = (
    Joint("root", -1, translation=(0.0, 1.0, 0.0)),
    Joint("a", 0, translation=(0.0, 0.5, 0.0), rotation=(0.5, 0.5, 0.5, 0.5)),
    Joint("b", 0, translation=(0.0, -0.5, 0.0), channels=("Yrotation",)),
)


def test_a_rig_that_never_was_a_bvh(tmp_path: Path) -> None:
    take = take_of(JOINTS)
    back = written(take, tmp_path / "a.bvh")
    found = compare_takes(take, back)
    assert found.world.value < 1e-8
    assert back.rig.joints[1].tips == ((0.0, 0.0, 0.0),)


def test_channels_that_cannot_hold_the_motion_are_made_up(tmp_path: Path) -> None:
    back = written(take_of(JOINTS), tmp_path / "a.bvh")
    channels = back.rig.joints[2].channels
    assert channels is not None
    assert channels[0] == "Yrotation"
    assert len(channels) == 3


def test_a_joint_that_moves_gets_positions(tmp_path: Path) -> None:
    take = take_of(JOINTS)
    values = take.motion.translations.dense()
    values[:, 1, 2] += np.linspace(0, 1, 6)
    take = replace(
        take, motion=replace(take.motion, translations=Channel.from_dense(values))
    )
    back = written(take, tmp_path / "a.bvh")
    assert compare_takes(take, back).translation.value < 1e-9
    assert "Zposition" in (back.rig.joints[1].channels or ())


def test_scales_are_named() -> None:
    take = take_of(JOINTS)
    scales = Channel.from_dense(np.full((6, 3, 3), 2.0))
    take = replace(take, motion=replace(take.motion, scales=scales))
    assert [n.code for n in build_bvh_text(take).notices] == ["BVH108"]


@pytest.mark.parametrize(("weight", "codes"), [(0.5, ["BVH114"]), (0.0, [])])
def test_lost_shapes_are_named(weight: float, codes: list[str]) -> None:
    take = take_of(JOINTS)
    rig = replace(take.rig, shapes=(Shape("smile", "", np.zeros((0, 3))),))
    weights = Channel.from_dense(np.full((6, 1, 1), weight))
    take = replace(take, rig=rig, motion=replace(take.motion, weights=weights))
    assert [n.code for n in build_bvh_text(take).notices] == codes


def test_several_roots_and_deep_chains(tmp_path: Path) -> None:
    chain = tuple(Joint(f"j{i}", i - 1, translation=(0, 0.01, 0)) for i in range(1500))
    back = written(take_of((*chain, Joint("prop", -1)), 2), tmp_path / "a.bvh")
    assert back.rig.names == [*(f"j{i}" for i in range(1500)), "prop"]
    assert back.rig.roots == [0, 1500]


@pytest.mark.parametrize(
    "rate",
    [
        "24",
        "25",
        "30",
        "60",
        "120",
        "24000/1001",
        "30000/1001",
        "1",
        "1000",
        "119",
        "33",
    ],
)
def test_frame_times_read_as_their_rate(rate: str) -> None:
    choice = rate_from_frame_time(frame_time(Fraction(rate)))
    assert choice.fps == Fraction(rate)


def test_joints_that_do_not_stand_depth_first_keep_their_values(tmp_path: Path) -> None:
    names = [("hips", -1), ("arm_l", 0), ("arm_r", 0), ("hand_l", 1), ("hand_r", 2)]
    rig = Rig("arms", tuple(Joint(name, parent) for name, parent in names))
    turns = so3.exp(0.1 * np.arange(1.0, 16.0).reshape(1, 5, 3))
    motion = Motion(Channel.from_dense(np.zeros((1, 5, 3))), Channel.from_dense(turns))
    clock = Clock(Fraction(24), Fraction(1), Fraction(1), 1)
    path = tmp_path / "arms.bvh"
    path.write_bytes(b"".join(build_bvh_text(Take(rig, clock, motion)).parts))
    back = read_bvh(path).collect()
    assert back.rig.names == ["hips", "arm_l", "hand_l", "arm_r", "hand_r"]
    found = back.motion.rotations.dense()[0]
    own = [back.rig.index(name) for name, _ in names]
    assert so3.angle_between(found[own], turns[0]).max() < 1e-9


def test_a_take_is_written_to_a_file(tmp_path: Path) -> None:
    take, path = take_of(JOINTS), tmp_path / "a.bvh"
    assert write_bvh(take, str(path)) == []
    assert path.read_bytes() == b"".join(build_bvh_text(take).parts)
    with raises(AnimtoolError, "OUT001") as caught:
        write_bvh(take, path)
    assert str(caught.value).endswith("exists; overwrite=True replaces it")
    assert write_bvh(take, path, overwrite=True) == []
