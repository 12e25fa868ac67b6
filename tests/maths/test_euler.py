from __future__ import annotations

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_allclose

from animtool.core.array_types import FloatArray
from animtool.maths import euler, so3

angles = hnp.arrays(np.float64, (6, 3), elements=st.floats(-720, 720))
orders = st.sampled_from(euler.ORDERS)


def exact_quaternion(degrees: tuple[float, ...], order: str) -> FloatArray:
    """Multiply the three turns in 50 digits."""
    with mpmath.workdps(50):
        result = [mpmath.mpf(0)] * 3 + [mpmath.mpf(1)]
        for angle, letter in zip(degrees, order, strict=True):
            half = mpmath.radians(mpmath.mpf(angle)) / 2
            turn = [mpmath.mpf(0)] * 3 + [mpmath.cos(half)]
            turn["XYZ".index(letter)] = mpmath.sin(half)
            ax, ay, az, aw = result
            bx, by, bz, bw = turn
            result = [
                aw * bx + ax * bw + ay * bz - az * by,
                aw * by - ax * bz + ay * bw + az * bx,
                aw * bz + ax * by - ay * bx + az * bw,
                aw * bw - ax * bx - ay * by - az * bz,
            ]
        return np.array([float(x) for x in result])


@pytest.mark.parametrize("order", euler.ORDERS)
@pytest.mark.parametrize(
    "degrees",
    [
        (0.0, 0.0, 0.0),
        (30.0, -70.0, 200.0),
        (90.0, 180.0, 270.0),
        (1e-9, -1e-9, 1e-300),
        (359.999999, 0.000001, -180.0),
        (360_000_000.25, -1e11, 720.5),
        (1e15, 3e20, -7e300),
    ],
)
def test_to_quaternion_in_fifty_digits(order: str, degrees: tuple[float, ...]) -> None:
    truth = exact_quaternion(tuple(mod720(d) for d in degrees), order)
    found = euler.to_quaternion([degrees], order)[0]
    truth *= np.sign(truth @ found)
    assert_allclose(found, truth, atol=4e-16)


def mod720(degrees: float) -> float:
    """Return the angle within two turns, exact."""
    return float(np.fmod(degrees, 720.0))


@given(angles, orders)
def test_round_trip(values: FloatArray, order: str) -> None:
    q = euler.to_quaternion(values, order)
    back = euler.to_quaternion(euler.from_quaternion(q, order), order)
    assert so3.angle_between(q, back).max() < 4e-14


@pytest.mark.parametrize("order", euler.ORDERS)
@pytest.mark.parametrize("middle", [90.0, -90.0, 90 - 1e-7, -90 + 1e-12, 90 - 1e-4])
def test_round_trip_at_gimbal_lock(order: str, middle: float) -> None:
    outer = np.linspace(-170, 170, 23)
    values = np.stack([outer, np.full(23, middle), outer[::-1] / 3], axis=1)
    q = euler.to_quaternion(values, order)
    found = euler.from_quaternion(q, order)
    assert np.isfinite(found).all()
    assert so3.angle_between(q, euler.to_quaternion(found, order)).max() < 4e-14


@pytest.mark.parametrize("order", euler.ORDERS)
def test_spins_add_up(order: str) -> None:
    values = np.zeros((200, 3))
    values[:, 0] = np.linspace(0, 2000, 200)
    found = euler.from_quaternion(euler.to_quaternion(values, order), order)
    assert_allclose(found, values, atol=1e-10)


def test_a_path_through_gimbal_lock_makes_no_jump() -> None:
    values = np.zeros((181, 3))
    values[:, 1] = np.linspace(0, 180, 181)
    found = euler.from_quaternion(euler.to_quaternion(values, "ZXY"), "ZXY")
    assert np.abs(np.diff(found, axis=0)).max() < 1.0 + 1e-6


@given(angles, orders)
def test_signs_are_continuous(values: FloatArray, order: str) -> None:
    q = euler.to_quaternion(values, order)
    assert (np.sum(q[1:] * q[:-1], axis=-1) >= -1e-15).all()
    assert q[0, 3] >= 0


def test_unknown_order() -> None:
    with pytest.raises(ValueError, match="XYZ"):
        euler.axes_of("XYX")


@pytest.mark.parametrize("order", ["XYZ", "ZXY", "YZX"])
@pytest.mark.parametrize(
    "degrees", [(92.0, 80.0, 92.0), (88.0, 95.0, 80.0), (-92.0, -80.0, 92.0)]
)
def test_the_first_angles_are_those_nearest_to_0(
    order: str, degrees: tuple[float, ...]
) -> None:
    """Of both triples of a rotation; the other one is hardly farther."""
    a, b, c = degrees
    other = np.array([a + 180.0, 180.0 - b, c + 180.0])
    other = (other + 180.0) % 360.0 - 180.0
    near, far = sorted([np.array(degrees), other], key=np.linalg.norm)
    assert (far**2).sum() - (near**2).sum() < np.degrees(1.0) ** 2
    for triple in (near, far):
        found = euler.from_quaternion(euler.to_quaternion(triple[None], order), order)
        assert_allclose(found[0], near, atol=1e-9)
