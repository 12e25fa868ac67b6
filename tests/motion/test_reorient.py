from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.bvh import random_rows, small_bvh

from animtool.core.units import UpAxis
from animtool.formats.bvh.read import read_bvh
from animtool.motion.reorient import reorient
from animtool.motion.take import Take, TakeStream
from animtool.rig.kinematics import forward, rest_world
from animtool.rig.parts import Capsule, Collider, IkChain
from animtool.rig.skeleton import Joint, Rig


def positions(take: Take) -> np.ndarray:
    motion = take.motion
    return forward(
        take.rig, motion.translations.dense(), motion.rotations.dense()
    ).positions


@pytest.mark.parametrize("static", [False, True])
def test_the_world_stands_up(tmp_path: Path, static: bool) -> None:
    path = tmp_path / "a.bvh"
    rows = random_rows(6)
    path.write_text(small_bvh(rows[:1].repeat(6, 0) if static else rows))
    before = read_bvh(path).collect()
    after = reorient(read_bvh(path), UpAxis.Z).collect()
    x, y, z = np.moveaxis(positions(before), -1, 0)
    assert_allclose(positions(after), np.stack([x, -z, y], axis=-1), atol=1e-15)
    assert after.rig.up is UpAxis.Z
    x, y, z = np.moveaxis(rest_world(before.rig).positions, -1, 0)
    assert_allclose(
        rest_world(after.rig).positions, np.stack([x, -z, y], axis=-1), atol=1e-15
    )


def test_nothing_to_do(tmp_path: Path) -> None:
    path = tmp_path / "a.bvh"
    path.write_text(small_bvh(random_rows(2)))
    stream = read_bvh(path)
    assert reorient(stream, UpAxis.Y) is stream


def test_pole_directions_in_the_world_are_turned() -> None:
    rig = Rig(
        "hero",
        (Joint("a", -1), Joint("b", 0, translation=(0, 1, 0)), Joint("c", 1)),
        chains=(
            IkChain("whole", "a", "c", pole_dir=(0.0, 0.6, 0.8)),
            IkChain("upper", "b", "c", pole_dir=(0.0, 0.6, 0.8)),
            IkChain("free", "a", "c"),
        ),
    )
    stream = TakeStream(rig, Fraction(24), None, Fraction(1), iter(()))
    whole, upper, free = reorient(stream, UpAxis.Z).rig.chains
    assert_allclose(whole.pole_dir, [0, -0.8, 0.6], atol=1e-15)
    # The parent of its root turns with the rig.
    assert upper == rig.chains[1]
    assert free == rig.chains[2]


def test_colliders_go_with_their_joints() -> None:
    capsule = Capsule(0.1, 0.5, (0.0, 0.0, 1.0), (0.0, 0.2, 0.3))
    rig = Rig("hero", (Joint("a", -1),), colliders=(Collider("a", capsule),))
    stream = TakeStream(rig, Fraction(24), None, Fraction(1), iter(()))
    turned = reorient(stream, UpAxis.Z).rig
    (collider,) = turned.colliders
    for vector in (capsule.axis, capsule.offset):
        x, y, z = rest_world(rig).linear[0, 0] @ vector
        found = rest_world(turned).linear[0, 0] @ vector
        assert_allclose(found, [x, -z, y], atol=1e-15)
    assert collider.capsule == capsule
