from __future__ import annotations

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_allclose

from animtool.core.array_types import FloatArray
from animtool.maths import so3

finite = st.floats(-1e3, 1e3).filter(lambda x: x == 0 or abs(x) > 1e-6)
quaternions = (
    hnp.arrays(np.float64, 4, elements=finite)
    .filter(lambda q: np.linalg.norm(q) > 1e-3)
    .map(so3.normalize)
)
vectors = hnp.arrays(np.float64, 3, elements=finite)
TIGHT = 1e-14


@given(quaternions, quaternions, quaternions)
def test_product_is_associative_and_closed(
    a: FloatArray, b: FloatArray, c: FloatArray
) -> None:
    left = so3.multiply(so3.multiply(a, b), c)
    assert_allclose(left, so3.multiply(a, so3.multiply(b, c)), atol=TIGHT)
    assert_allclose(np.linalg.norm(left), 1.0, atol=TIGHT)


@given(quaternions)
def test_identity_and_inverse(q: FloatArray) -> None:
    assert_allclose(so3.multiply(q, so3.IDENTITY), q, atol=0)
    assert_allclose(so3.multiply(q, so3.conjugate(q)), so3.IDENTITY, atol=TIGHT)


@pytest.mark.parametrize("off", [1e-3, 1e-5, 2.5e-6])
def test_vectors_that_are_nearly_opposite_are_turned_onto_each_other(
    off: float,
) -> None:
    one = np.array([0.6, 0.0, 0.8])
    other = -np.cos(off) * one + np.sin(off) * np.array([0.8, 0.0, -0.6])
    assert_allclose(
        so3.rotate(so3.shortest_rotation(one, other), one), other, atol=1e-9
    )


@given(quaternions, quaternions, vectors)
def test_rotate_is_a_homomorphism(a: FloatArray, b: FloatArray, v: FloatArray) -> None:
    scale = 1 + np.linalg.norm(v)
    once = so3.rotate(so3.multiply(a, b), v)
    assert_allclose(once, so3.rotate(a, so3.rotate(b, v)), atol=TIGHT * 4 * scale)


@given(quaternions)
def test_matrix_round_trip(q: FloatArray) -> None:
    back = so3.from_matrix(so3.to_matrix(q))
    assert back[3] >= 0
    assert so3.angle_between(q, back) < 1e-14


@pytest.mark.parametrize("diagonal", [(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)])
def test_matrix_of_half_turns(diagonal: tuple[float, ...]) -> None:
    matrix = np.diag(np.array(diagonal, float))
    assert_allclose(so3.to_matrix(so3.from_matrix(matrix)), matrix, atol=0)


@given(quaternions)
def test_exp_undoes_log(q: FloatArray) -> None:
    assert so3.angle_between(so3.exp(so3.log(q)), q) < 1e-14


@pytest.mark.parametrize(
    "angle", [0.0, 1e-300, 1e-12, 1e-7, 1e-5, 1.1e-5, 1e-3, 1.0, 3.1]
)
def test_log_and_exp_of_an_angle(angle: float) -> None:
    vector = np.array([0.0, angle, 0.0])
    q = so3.exp(vector)
    with mpmath.workdps(50):
        half = mpmath.mpf(angle) / 2
        truth = [0.0, float(mpmath.sin(half)), 0.0, float(mpmath.cos(half))]
    assert_allclose(q, truth, rtol=4e-16, atol=0)
    assert_allclose(so3.log(q), vector, rtol=1e-15, atol=0)


def test_log_takes_the_short_way() -> None:
    q = so3.from_axis_angle([0.0, 0.0, 1.0], 1.5 * np.pi)
    assert_allclose(so3.log(q), [0, 0, -np.pi / 2], atol=1e-15)


@pytest.mark.parametrize("angle", [1e-12, 1e-8, 1e-3, 1.0, np.pi - 1e-9, np.pi])
def test_angle_between_keeps_small_angles(angle: float) -> None:
    a = so3.from_axis_angle([0.6, 0.0, 0.8], 0.3)
    b = so3.multiply(a, so3.from_axis_angle([0.0, 1.0, 0.0], angle))
    assert_allclose(so3.angle_between(a, -b), angle, rtol=1e-15, atol=5e-16)


@given(quaternions, quaternions, st.floats(0, 1))
def test_slerp_has_constant_speed(a: FloatArray, b: FloatArray, t: float) -> None:
    whole = so3.angle_between(a, b)
    middle = so3.slerp(a, b, t)
    assert_allclose(np.linalg.norm(middle), 1.0, atol=TIGHT)
    # Half a turn apart the arc is not unique and ill-conditioned.
    if whole < np.pi - 1e-3:
        assert_allclose(so3.angle_between(a, middle), t * whole, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-7, 1e-5, 2e-5, 1.0, 3.0])
def test_slerp_by_the_closed_form(angle: float) -> None:
    b = so3.from_axis_angle([0.0, 1.0, 0.0], angle)
    truth = so3.from_axis_angle([0.0, 1.0, 0.0], angle / 4)
    assert_allclose(so3.slerp(so3.IDENTITY, b, 0.25), truth, atol=2e-16)


def test_slerp_ends_and_broadcasts() -> None:
    a = so3.normalize(np.random.default_rng(0).normal(size=(5, 3, 4)))
    b = so3.normalize(np.random.default_rng(1).normal(size=(5, 3, 4)))
    assert_allclose(so3.slerp(a, b, 0.0), a, atol=1e-15)
    assert so3.angle_between(so3.slerp(a, b, 1.0), b).max() < 1e-14
    one = so3.slerp(a[0, 0], b[0, 0], 0.3)
    assert_allclose(so3.slerp(a, b, np.full((5, 3), 0.3))[0, 0], one, atol=0)


def test_align_signs_makes_neighbours_close() -> None:
    angles = np.linspace(0, 6 * np.pi, 100)
    q = so3.from_axis_angle(np.array([0.0, 0.0, 1.0]), angles)
    flipped = q * np.random.default_rng(0).choice([-1.0, 1.0], 100)[:, None]
    aligned = so3.align_signs(flipped)
    assert (np.sum(aligned[1:] * aligned[:-1], axis=-1) > 0).all()
    assert aligned[0, 3] > 0
    assert so3.align_signs(np.zeros((0, 4))).shape == (0, 4)


@pytest.mark.parametrize("scale", [1e-200, 1e-30, 1.0, 1e200])
def test_normalize_over_the_float_range(scale: float) -> None:
    q = so3.normalize(np.array([1.0, 2.0, 3.0, 4.0]) * scale)
    assert_allclose(q, np.array([1, 2, 3, 4]) / np.sqrt(30), rtol=4e-16)
    assert_allclose(so3.normalize([0.0] * 4), so3.IDENTITY, atol=0)


@given(quaternions, hnp.arrays(np.float64, 3, elements=st.floats(1e-3, 1e3)))
def test_rotation_and_scale_are_found_again(q: FloatArray, scale: FloatArray) -> None:
    for sign in (1.0, -1.0):
        linear = so3.to_matrix(q) * (sign * scale)
        rotation, found = so3.split_scale(linear)
        assert_allclose(found, sign * scale, rtol=1e-12)
        assert so3.angle_between(rotation, q) < 1e-7
