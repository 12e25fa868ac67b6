"""What takes of persons say of themselves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from animtool import Channel, Take, open_source
from animtool.maths import so3
from animtool.retarget.facts import measure_capture


@pytest.fixture(scope="module")
def walk(root: Path) -> Take:
    return open_source(root / "samples/walk/walk.bvh").collect()


def test_a_walk(walk: Take) -> None:
    """Of two cycles of 32 frames at 30 a second, 1.44 m each."""
    found = measure_capture(walk)
    assert found is not None
    assert {name: foot.steps for name, foot in found.feet.items()} == {
        "left": 2,
        "right": 2,
    }
    hips = walk.world().positions[:, 0]
    way = np.linalg.norm((hips[-1] - hips[0])[[0, 2]]) / (63 / 30)
    assert found.speed_mean == pytest.approx(way, rel=0.01)


def test_noise_is_that_of_the_noisiest_joint(walk: Take) -> None:
    rng, joint = np.random.default_rng(4), walk.rig.index("LeftHand")
    turns = walk.motion.rotations.dense()
    shake = so3.exp(rng.normal(0, 0.02, (len(turns), 3)))
    turns[:, joint] = so3.multiply(turns[:, joint], shake)
    motion = replace(walk.motion, rotations=Channel.from_dense(turns))
    found = measure_capture(replace(walk, motion=motion))
    assert found is not None
    assert found.noisiest == "LeftHand"
    # Frames are few.
    assert found.noise == pytest.approx(0.02, rel=0.2)


def test_who_has_no_legs_says_nothing(walk: Take) -> None:
    tree = replace(walk.rig.joints[0], name="trunk", parent=-1)
    motion = walk.motion
    first = [
        Channel.from_dense(c.dense()[:, :1])
        for c in (motion.translations, motion.rotations)
    ]
    alone = replace(walk.rig, joints=(tree,))
    take = replace(
        walk,
        rig=alone,
        motion=replace(motion, translations=first[0], rotations=first[1]),
    )
    assert measure_capture(take) is None
