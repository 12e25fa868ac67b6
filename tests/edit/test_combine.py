"""Takes of one rig that state other axes, or their shapes in another order."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.nasty import nasty_take
from support.takes import assert_same_motion, motion_of, takes

from animtool.core.clock import Clock
from animtool.core.errors import OptionError
from animtool.core.units import UpAxis
from animtool.edit.layers import (
    BLEND,
    LAYER,
    LayerMode,
    blend,
    difference,
    layer,
    rest_take,
)
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.passes import PassContext, PlacedJoint, apply_pass
from animtool.motion.reorient import reorient
from animtool.motion.take import Take, TakeStream
from animtool.rig.parts import Shape
from animtool.rig.skeleton import Joint, JointType, Rig

WITHIN = 1e-12  # [m], [rad], [1], a few roundings


@st.composite
def pairs(draw: st.DrawFn) -> tuple[Take, Take]:
    """Return two takes of one rig with Y up, on one clock."""
    take = draw(takes())
    take = replace(take, rig=replace(take.rig, up=UpAxis.Y))
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    motion = motion_of(take.rig, take.clock.count, rng, False, uniform=True)
    return take, replace(take, motion=motion)


def z_up(take: Take) -> Take:
    return reorient(TakeStream.of(take), UpAxis.Z).collect()


@pytest.mark.slow
@given(pairs())
def test_the_up_axis_of_the_other_take_does_not_matter(both: tuple[Take, Take]) -> None:
    take, other = both
    for found, expected in (
        (blend(take, z_up(other), weight=0.3), blend(take, other, weight=0.3)),
        (layer(take, z_up(other)), layer(take, other)),
        (difference(take, z_up(other)), difference(take, other)),
    ):
        assert found.rig.up is UpAxis.Y
        assert_same_motion(found, expected, WITHIN)
    delta = difference(z_up(take), z_up(other))
    summed = layer(other, delta, mode=LayerMode.ADDITIVE)
    assert_same_motion(summed, layer(take, take), 10 * WITHIN)


def shaped(take: Take, **weights: float) -> Take:
    """Return the take with shapes at constant weights."""
    values = np.tile(np.array([*weights.values()])[:, None], (take.clock.count, 1, 1))
    return replace(
        take,
        rig=replace(take.rig, shapes=tuple(map(Shape, weights))),
        motion=replace(take.motion, weights=Channel.from_dense(values)),
    )


@given(takes())
def test_shapes_are_matched_by_name(take: Take) -> None:
    one, other = shaped(take, a=0.0, b=0.0), shaped(take, b=0.25, a=1.0)
    found = layer(one, other).motion.weights
    assert found is not None
    assert found.dense()[0, :, 0].tolist() == [1.0, 0.25]
    with pytest.raises(OptionError) as caught:
        layer(one, shaped(take, a=1.0, c=0.25))
    assert caught.value.code == "SCN017"


def test_an_additive_layer_of_whole_poses_is_said() -> None:
    rig = nasty_take().rig
    below = other = rest_take(rig, nasty_take().clock)
    doubled = layer(below, other, mode="additive")
    assert [notice.code for notice in doubled.notices] == ["SCN119"]
    assert layer(below, other).notices == ()
    assert layer(below, difference(other), mode="additive").notices == ()
    # Only the joints that it affects count.
    root = below.rig.names[0]
    assert layer(below, other, mode="additive", joints=root).notices == ()


@pytest.mark.parametrize(
    ("delay", "frames", "found"),
    [
        (240, 24, True),
        (-40, 24, True),
        (12, 24, False),
        (-12, 24, False),
        (0, 24, False),
        (240, 1, False),  # a pose
    ],
)
def test_a_layer_that_is_never_played(delay: float, frames: int, found: bool) -> None:
    rig = Rig("one", (Joint("hips", -1, JointType.FREE),))
    take, other = (
        Take(
            rig,
            Clock(Fraction(24), Fraction(1), Fraction(1), count),
            Motion(
                Channel.from_dense(np.zeros((count, 1, 3))),
                Channel.from_dense(np.tile(so3.IDENTITY, (count, 1, 1))),
            ),
        )
        for count in (24, frames)
    )
    codes = [notice.code for notice in layer(take, other, delay=delay).notices]
    assert codes == ["SCN118"] * found


@pytest.mark.parametrize(
    ("joint", "times", "move", "found"),
    [
        ("hips", [3, 4], 1.0, True),
        ("hips", [30], 1.0, False),  # no goal in these frames
        ("head", [3], 1.0, True),  # it is below
        ("hips", [3], 1e-4, False),
        ("hand", [3], 1.0, False),  # of another rig
    ],
)
def test_a_layer_that_moves_what_ik_has_placed(
    joint: str, times: list[int], move: float, found: bool
) -> None:
    free = JointType.FREE
    head = Joint("head", 0, JointType.BALL, translation=(0.0, 1.0, 0.0))
    rig = Rig("one", (Joint("hips", -1, free), head))
    motions = []
    for x in (0.0, move):
        translations = np.tile(rig.rest_translations, (9, 1, 1))
        translations[:, 0, 0] = x
        rotations = Channel.from_dense(np.tile(so3.IDENTITY, (9, 2, 1)))
        motions.append(Motion(Channel.from_dense(translations), rotations))
    clock = Clock(Fraction(24), Fraction(1), Fraction(1), 9)
    take, other = (Take(rig, clock, motion) for motion in motions)
    placed = PlacedJoint(joint, joint, np.array(times, np.float64))
    context = PassContext(lambda _: other, Path(), placed_joints=[placed])
    options = LAYER.options(take=Path("other.bvh"))
    result = apply_pass(TakeStream.of(take), LAYER, options, context).collect()
    assert [notice.code for notice in result.notices] == ["SCN120"] * found


@pytest.mark.parametrize(
    ("distance", "weight", "found"),
    [
        (50.0, ((1.0, 0.0), (9.0, 1.0)), True),
        (1.5, ((1.0, 0.0), (9.0, 1.0)), False),
        (50.0, 0.5, False),
        (50.0, ((1.0, 1.0), (9.0, 1.0)), False),
    ],
)
def test_takes_far_apart_that_are_blended(
    distance: float, weight: object, found: bool
) -> None:
    head = Joint("head", 0, JointType.BALL, translation=(0.0, 1.0, 0.0))
    rig = Rig("one", (Joint("hips", -1, JointType.FREE), head))
    rotations = Channel.from_dense(np.tile(so3.IDENTITY, (9, 2, 1)))
    takes_apart = []
    for x in (0.0, distance):
        translations = np.tile(rig.rest_translations, (9, 1, 1))
        translations[:, 0, 0] = x
        motion = Motion(Channel.from_dense(translations).compact(), rotations)
        takes_apart.append(Take(rig, Clock(24, 1, 1, 9), motion))
    take, other = takes_apart
    context = PassContext(lambda _: other, Path())
    options = BLEND.options(take=Path("other.bvh"), weight=weight)
    apply_pass(TakeStream.of(take), BLEND, options, context).collect()
    assert [notice.code for notice in context.notices] == ["SCN122"] * found
