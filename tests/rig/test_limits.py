from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from animtool.maths import so3
from animtool.rig.limits import BallLimit, RangeLimit, swing_twist

SEEDS = st.integers(0, 10_000)


def axis_of(rng: np.random.Generator) -> tuple[float, float, float]:
    x, y, z = rng.normal(size=3)
    length = float(np.linalg.norm([x, y, z]))
    return (x / length, y / length, z / length)


def test_range() -> None:
    limit = RangeLimit(-1.0, 2.0)
    assert limit.clamped(np.array([-3.0, 0.5, 5.0])).tolist() == [-1, 0.5, 2]
    assert limit.excess(np.array([-3.0, 0.5, 5.0])).tolist() == [-2, 0, 3]


@given(SEEDS)
def test_swing_times_twist_is_the_rotation(seed: int) -> None:
    rng = np.random.default_rng(seed)
    axis, turned = axis_of(rng), so3.normalize(rng.normal(size=(5, 4)))
    swing, twist = swing_twist(turned, axis)
    again = so3.multiply(swing, so3.from_axis_angle(axis, twist))
    assert_allclose(so3.angle_between(again, turned), 0, atol=1e-12)
    assert_allclose(swing[:, :3] @ np.array(axis), 0, atol=1e-12)
    assert (np.abs(twist) <= np.pi).all()
    assert (swing[:, 3] >= 0).all()


def test_half_a_turn_of_swing_leaves_the_twist_open() -> None:
    swing, twist = swing_twist([[1.0, 0.0, 0.0, 0.0]], (0, 1, 0))
    assert twist.tolist() == [0]
    assert_allclose(swing, [[1, 0, 0, 0]])


def limit_of(rng: np.random.Generator) -> BallLimit:
    low, high = np.sort(rng.uniform(-3, 3, 2)).tolist()
    wide, narrow = rng.uniform(0.1, 2.5, 2).tolist()
    return BallLimit((wide, narrow), (low, high), axis_of(rng))


@given(SEEDS)
def test_clamped_is_inside_and_stays(seed: int) -> None:
    rng = np.random.default_rng(seed)
    limit, turned = limit_of(rng), so3.normalize(rng.normal(size=(8, 4)))
    once = limit.clamped(turned)
    assert_allclose(so3.angle_between(limit.clamped(once), once), 0, atol=1e-8)
    assert_allclose(limit.excess(once), 0, atol=1e-8)
    _, twist = swing_twist(once, limit.twist_axis)
    low, high = limit.twist or (0, 0)
    assert ((twist > low - 1e-8) & (twist < high + 1e-8)).all()
    inside = limit.excess(turned) == 0
    assert (once[inside] == turned[inside]).all()


CONE = BallLimit((0.5, 1.0), (-0.2, 0.3), (0.0, 0.0, 1.0))


@pytest.mark.parametrize(
    ("vector", "wanted"),
    [
        ((0.4, 0, 0), (0.4, 0, 0)),
        ((0.9, 0, 0), (0.5, 0, 0)),
        ((0, 0.9, 0), (0, 0.9, 0)),
        ((0, -1.9, 0), (0, -1, 0)),
        ((1, 2, 0), tuple(np.array([1, 2, 0]) * 0.5 / np.sqrt(2))),
        ((0, 0, 1), (0, 0, 0.3)),
        ((0, 0, -1), (0, 0, -0.2)),
    ],
)
def test_outside_lands_on_the_ellipse(
    vector: tuple[float, ...], wanted: tuple[float, ...]
) -> None:
    found = CONE.clamped(so3.exp(np.array([vector])))
    assert_allclose(so3.log(found)[0], wanted, atol=1e-12)


@given(SEEDS)
def test_locked_twist_leaves_the_swing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    axis, turned = axis_of(rng), so3.normalize(rng.normal(size=(4, 4)))
    found = BallLimit(None, (0.0, 0.0), axis).clamped(turned)
    swing, _ = swing_twist(turned, axis)
    assert_allclose(so3.angle_between(found, swing), 0, atol=1e-8)


def test_no_limits_change_nothing() -> None:
    turned = so3.normalize(np.random.default_rng(0).normal(size=(9, 4)))
    assert_allclose(BallLimit().clamped(turned), turned)
    assert_allclose(BallLimit().excess(turned), 0)


def test_a_cone_of_no_width() -> None:
    found = BallLimit((0.0, 0.0), None).clamped(so3.exp([[1.0, 0.5, 0.0]]))
    swing, _ = swing_twist(found, (0, 1, 0))
    assert_allclose(so3.log(swing), 0, atol=1e-9)


@pytest.mark.parametrize(
    ("degrees", "wanted"), [(185, 185), (-175, 185), (150, 170), (-120, 200), (10, 170)]
)
def test_a_twist_range_past_half_a_turn(degrees: float, wanted: float) -> None:
    axis = (0.0, 1.0, 0.0)
    limit = BallLimit(None, (np.radians(170), np.radians(200)), axis)
    found = limit.clamped(so3.from_axis_angle(axis, np.radians([degrees])))
    meant = so3.from_axis_angle(axis, np.radians([wanted]))
    assert_allclose(so3.angle_between(found, meant), 0, atol=1e-12)
