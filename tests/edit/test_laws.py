"""Laws of the passes, over random rigs and takes."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.takes import assert_same_motion, motion_of, rigs, takes

from animtool.edit.layers import LayerMode, blend, difference, layer
from animtool.edit.mirroring import Axis, mirror
from animtool.edit.resample import resampled
from animtool.edit.retiming import time_scale, time_warp, trim
from animtool.formats.bvh.read import read_bvh
from animtool.maths import so3
from animtool.motion.keyed import KeyInterpolation
from animtool.motion.motion import Channel
from animtool.motion.take import Take
from animtool.rig.skeleton import Joint, Rig

WITHIN = 1e-12  # [m], [rad], [1], a few roundings


@st.composite
def pairs(draw: st.DrawFn) -> tuple[Take, Take]:
    """Return two takes of one rig on one clock; either may be scaled."""
    take = draw(takes())
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    scaled = draw(st.booleans())
    motion = motion_of(take.rig, take.clock.count, rng, scaled, uniform=False)
    return take, replace(take, motion=motion)


def with_scales(take: Take) -> Take:
    """Return the take with scales, 1 where it has none."""
    if take.motion.scales is not None:
        return take
    ones = Channel.from_dense(np.ones_like(take.motion.translations.dense()))
    return replace(take, motion=replace(take.motion, scales=ones))


def assert_like(found: Take, expected: Take, tolerance: float) -> None:
    """Compare two takes, of which one may have scales of 1 and the other none."""
    assert_same_motion(with_scales(found), with_scales(expected), tolerance)


@given(pairs())
def test_base_and_difference_make_the_source(both: tuple[Take, Take]) -> None:
    source, base = both
    delta = difference(source, base)
    back = layer(base, delta, mode=LayerMode.ADDITIVE)
    assert_like(back, source, WITHIN)


@given(takes(whole=True), st.data())
def test_a_pose_and_the_difference_from_it_make_the_source(
    source: Take, data: st.DataObject
) -> None:
    frame = float(data.draw(st.sampled_from(source.clock.times.tolist())))
    delta = difference(source, source, frame)
    held = time_warp(
        source,
        [[source.clock.times[0], frame], [source.clock.times[-1], frame]],
    )
    back = layer(held, delta, mode=LayerMode.ADDITIVE)
    assert_like(back, source, WITHIN)


@given(takes())
def test_a_difference_from_rest_is_what_the_rig_does(source: Take) -> None:
    delta = difference(source)
    turns = delta.motion.rotations.dense()
    expected = so3.multiply(
        so3.conjugate(source.rig.rest_rotations), source.motion.rotations.dense()
    )
    assert so3.angle_between(turns, expected).max() <= WITHIN
    nothing = difference(source, source).motion.rotations.dense()
    assert so3.angle_between(nothing, so3.IDENTITY).max() <= WITHIN


@given(pairs(), st.sampled_from(KeyInterpolation))
def test_a_blend_ends_at_either_take(
    both: tuple[Take, Take], interpolation: KeyInterpolation
) -> None:
    one, other = both
    assert_like(blend(one, other, weight=0.0), one, 0.0)
    ends = one.clock.times[[0, -1]].tolist()
    always = [[ends[0], 1.0], [ends[1], 1.0]]
    for weight in (1.0, always):
        found = blend(one, other, weight=weight, interpolation=interpolation)
        assert_like(found, other, WITHIN)


@given(pairs(), st.sampled_from(LayerMode), st.booleans())
def test_a_layer_without_weight_changes_nothing(
    both: tuple[Take, Take], mode: LayerMode, masked: bool
) -> None:
    take, other = both
    joints = [take.rig.names[0]] if masked else []
    found = layer(take, other, mode=mode, weight=0.0, joints=joints, children=True)
    assert_like(found, take, WITHIN)


@given(pairs(), st.data())
def test_a_layer_changes_the_joints_of_its_mask_only(
    both: tuple[Take, Take], data: st.DataObject
) -> None:
    take, other = both
    name = data.draw(st.sampled_from(take.rig.names))
    found = layer(take, other, joints=[name])
    chosen = take.rig.index(name)
    inside = np.arange(len(take.rig.joints)) == chosen
    for kind in ("translations", "rotations"):
        ours, below, above = (
            getattr(one.motion, kind).dense() for one in (found, take, other)
        )
        expected = np.where(inside[:, None], above, below)
        if kind == "rotations":
            expected = so3.align_signs(expected, expected[0])
        np.testing.assert_array_equal(ours, expected)
    for kind in ("weights", "controls"):
        ours, below = getattr(found.motion, kind), getattr(take.motion, kind)
        assert (ours is None) == (below is None)
        if ours is not None:
            np.testing.assert_array_equal(ours.dense(), below.dense())


@given(takes(uniform=True), st.sampled_from(Axis))
def test_mirrored_twice_is_the_source(take: Take, axis: Axis) -> None:
    assert_same_motion(mirror(mirror(take, axis), axis), take, WITHIN)


@st.composite
def sided(draw: st.DrawFn) -> Take:
    """Return a take of two arms, whose halves are framed in their own ways."""
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    places, turns = rng.normal(0, 0.5, (5, 3)), so3.exp(rng.normal(0, 1, (5, 3)))
    names = ["hips", "arm_l", "arm_r", "hand_l", "hand_r"]
    joints = tuple(
        Joint(name, parent, translation=tuple(place), rotation=tuple(turn))
        for name, parent, place, turn in zip(
            names, [-1, 0, 0, 1, 2], places.tolist(), turns.tolist(), strict=True
        )
    )
    take = draw(takes())
    rig = Rig("arms", joints)
    scaled = draw(st.booleans())
    motion = motion_of(rig, take.clock.count, rng, scaled, uniform=True)
    return Take(rig, take.clock, motion)


@given(sided(), st.sampled_from(Axis))
def test_sides_swapped_twice_are_the_source(take: Take, axis: Axis) -> None:
    once = mirror(take, axis)
    assert_same_motion(mirror(once, axis), take, WITHIN)
    if take.motion.scales is not None and once.motion.scales is not None:
        np.testing.assert_allclose(
            once.motion.scales.dense()[:, [0, 2, 1, 4, 3]],
            take.motion.scales.dense(),
            atol=WITHIN,
        )


@given(takes(), st.data())
def test_trimmed_frames_are_the_sources(take: Take, data: st.DataObject) -> None:
    count = take.clock.count
    low = data.draw(st.integers(0, count - 1))
    high = data.draw(st.integers(low, count - 1))
    times = take.clock.times
    found = trim(take, float(times[low]), float(times[high]))
    clock = replace(
        take.clock,
        start=take.clock.start + low * take.clock.step,
        count=high - low + 1,
    )
    kept = take.motion.select(slice(low, high + 1))
    assert_same_motion(found, Take(take.rig, clock, kept))


@pytest.mark.parametrize(("off", "left_out"), [(9e-7, 0), (2e-6, 1)])
def test_a_time_code_of_a_few_digits_means_its_frame(
    walk: Path, off: float, left_out: int
) -> None:
    take = read_bvh(walk).collect()
    first, last = take.clock.times[[0, -1]].tolist()
    for found in (trim(take, first=first + off), trim(take, last=last - off)):
        assert found.clock.count == take.clock.count - left_out


@given(takes(whole=True), st.sampled_from([0.5, 0.25, 0.2, 0.1, -1.0, -0.5, 1.0]))
def test_slower_and_back(take: Take, speed: float) -> None:
    pivot = float(take.clock.start)
    slow = time_scale(take, speed, pivot)
    back = time_scale(slow, 1 / speed, pivot)
    assert_same_motion(back, take, WITHIN)


@given(takes(whole=True), st.sampled_from(KeyInterpolation), st.data())
def test_a_straight_curve_of_time(
    take: Take, interpolation: KeyInterpolation, data: st.DataObject
) -> None:
    first, last = take.clock.times[[0, -1]].tolist()
    inside = data.draw(st.lists(st.floats(first, last), max_size=3))
    # Keys that all but meet have no slope that floats could hold.
    at = sorted({first, last, *(round(x, 2) for x in inside)})
    curve = [[t, t] for t in at if first <= t <= last]
    assert_same_motion(time_warp(take, curve, interpolation), take, 1e-9)


@given(takes())
def test_the_same_rate(take: Take) -> None:
    found = resampled(take, take.clock.rate)
    clock = replace(take.clock, fps=take.clock.rate, step=Fraction(1))
    assert_same_motion(found, replace(take, clock=clock))


@given(rigs(), st.integers(0, 2**31), st.sampled_from([2, 3, 5]))
def test_a_finer_rate_and_back(rig: Rig, seed: int, finer: int) -> None:
    from animtool.core.clock import Clock

    rng = np.random.default_rng(seed)
    motion = motion_of(rig, 7, rng, scaled=True, uniform=False)
    take = Take(rig, Clock(Fraction(24), Fraction(1), Fraction(1), 7), motion)
    fine = resampled(take, 24 * Fraction(finer))
    assert_same_motion(resampled(fine, Fraction(24)), take)
