from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from animtool.core.array_types import FloatArray
from animtool.maths import so3
from animtool.maths.curves import Extrapolation
from animtool.maths.rotation_curves import RotationKind, evaluate_rotations

STEP, SLERP, SQUAD, SPLINE = RotationKind
SMOOTH = [SQUAD, SPLINE]
MOVING = [SLERP, SQUAD, SPLINE]
CLOSE = 1e-13


def keyed(seed: int, count: int = 6) -> tuple[FloatArray, FloatArray]:
    """Return uneven times and rotation keys, none half a turn from the next."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.2, 3.0, count)) - 2.0
    turns = rng.normal(size=(count, 3))
    turns *= rng.uniform(0.1, 2.2, (count, 1)) / np.linalg.norm(turns, axis=1)[:, None]
    keys = [so3.exp(turns[0])]
    for turn in turns[1:]:
        keys.append(so3.multiply(keys[-1], so3.exp(turn)))
    return times, so3.normalize(keys) * rng.choice([-1.0, 1.0], (count, 1))


def apart(a: FloatArray, b: FloatArray) -> float:
    """Return the largest angle between rotations."""
    return float(so3.angle_between(a, b).max())


def velocity(
    curve: Callable[[FloatArray], FloatArray], at: float, h: float
) -> FloatArray:
    """Return a one-sided angular velocity in body space, of second order in h."""
    q = curve(np.array([at, at + h, at + 2 * h]))
    near, far = (so3.log(so3.multiply(so3.conjugate(q[0]), q[i])) for i in (1, 2))
    return (4 * near - far) / (2 * h)


def jump(times: FloatArray, keys: FloatArray, kinds: object, h: float) -> float:
    """Return the largest jump of angular velocity at inner keys."""

    def curve(at: FloatArray) -> FloatArray:
        return evaluate_rotations(times, keys, kinds, at)

    return max(
        float(np.linalg.norm(velocity(curve, t, h) - velocity(curve, t, -h)))
        for t in times[1:-1]
    )


seeds = st.integers(0, 2**32 - 1)


@given(seeds, st.sampled_from(RotationKind))
def test_keys_are_met_exactly(seed: int, kind: RotationKind) -> None:
    times, keys = keyed(seed)
    got = evaluate_rotations(times, keys, kind, times)
    signs = np.sign(np.sum(got * keys, axis=-1, keepdims=True))
    assert (got * signs == so3.normalize(keys)).all()


@given(seeds, st.sampled_from(MOVING))
def test_curves_reach_their_keys(seed: int, kind: RotationKind) -> None:
    times, keys = keyed(seed)
    for side in (-1e-12, 1e-12):
        near = evaluate_rotations(times, keys, kind, times + side)
        assert apart(near, keys) < 1e-9


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("kind", SMOOTH)
def test_velocity_does_not_jump(kind: RotationKind, seed: int) -> None:
    times, keys = keyed(seed)
    coarse, fine = (jump(times, keys, kind, h) for h in (2e-3, 5e-4))
    assert fine < max(coarse / 8, 1e-6)
    assert fine < 1e-3 * jump(times, keys, SLERP, 5e-4)


@pytest.mark.parametrize("kind", SMOOTH)
def test_a_fast_short_segment_does_not_wind_its_neighbour(kind: RotationKind) -> None:
    times = np.array([0.0, 0.01, 2.0, 3.0])
    keys = so3.exp([[0.0, 0, 0], [2.0, 0, 0], [2.0, 0.3, 0], [2.0, 0.3, 0.5]])
    at = np.linspace(0.01, 2.0, 2001)
    got = evaluate_rotations(times, keys, kind, at)
    assert so3.angle_between(got[1:], got[:-1]).sum() < 2 * np.pi
    assert jump(times, keys, kind, 1e-5) < 1e-2


@pytest.mark.parametrize("seed", range(4))
def test_velocity_does_not_jump_between_kinds(seed: int) -> None:
    times, keys = keyed(seed, 7)
    kinds = [SLERP, SPLINE, SQUAD, SLERP, SQUAD, SPLINE, STEP]
    coarse, fine = (jump(times, keys, kinds, h) for h in (2e-3, 5e-4))
    assert fine < max(coarse / 8, 1e-6)


@given(seeds, seeds, st.sampled_from(MOVING))
def test_curves_turn_with_their_keys(seed: int, other: int, kind: RotationKind) -> None:
    times, keys = keyed(seed)
    turn = keyed(other)[1][0]
    at = np.linspace(times[0], times[-1], 41)
    before = evaluate_rotations(times, keys, kind, at)
    left = evaluate_rotations(times, so3.multiply(turn, keys), kind, at)
    right = evaluate_rotations(times, so3.multiply(keys, turn), kind, at)
    assert apart(left, so3.multiply(turn, before)) < 1e-11
    assert apart(right, so3.multiply(before, turn)) < 1e-11


@given(seeds, st.sampled_from(MOVING), st.floats(-3.0, 3.0))
def test_a_steady_turn_is_kept(seed: int, kind: RotationKind, speed: float) -> None:
    times = keyed(seed)[0]
    speed /= np.diff(times).max()
    axis = np.array([0.48, -0.6, 0.64])
    at = np.linspace(times[0], times[-1], 41)
    keys = so3.from_axis_angle(axis, speed * times)
    got = evaluate_rotations(times, keys, kind, at)
    assert apart(got, so3.from_axis_angle(axis, speed * at)) < CLOSE


@pytest.mark.parametrize("kind", SMOOTH)
def test_a_quadratic_turn_is_kept_between_inner_keys(kind: RotationKind) -> None:
    times = np.array([0.0, 0.5, 2.0, 2.7, 4.0])
    axis = np.array([0.0, 0.6, 0.8])

    def turned(t: FloatArray) -> FloatArray:
        return so3.from_axis_angle(axis, 0.3 * t**2 - 0.5 * t)

    at = np.linspace(0.5, 2.7, 41)
    got = evaluate_rotations(times, turned(times), kind, at)
    assert apart(got, turned(at)) < (CLOSE if kind is SPLINE else 0.1)


def test_spline_is_of_third_order() -> None:
    def smooth(t: FloatArray) -> FloatArray:
        first = np.stack([np.sin(t), 0.3 * t, np.cos(2 * t)], axis=-1)
        return so3.multiply(so3.exp(first), so3.exp(first[:, ::-1] * 0.7))

    at = np.linspace(1.0, 2.0, 201)
    errors = []
    for count in (20, 40):
        times = np.concatenate([[0.0], np.cumsum(np.tile([1.0, 2.0], count))])
        times /= count
        found = evaluate_rotations(times, smooth(times), SPLINE, at)
        errors.append(apart(found, smooth(at)))
    assert errors[1] < errors[0] / 6


@given(seeds, st.sampled_from(RotationKind), st.floats(1e-3, 1e3))
def test_time_scales_and_shifts(seed: int, kind: RotationKind, scale: float) -> None:
    times, keys = keyed(seed)
    at = np.linspace(times[0], times[-1], 38)[1:-1]
    assume(np.abs(at[:, None] - times).min() > 1e-6)
    once = evaluate_rotations(times, keys, kind, at)
    again = evaluate_rotations(times * scale + 5.0, keys, kind, at * scale + 5.0)
    assert apart(once, again) < 1e-9


@pytest.mark.parametrize("kind", SMOOTH)
def test_a_key_changes_near_segments_only(kind: RotationKind) -> None:
    times, keys = keyed(3, 9)
    other = keys.copy()
    other[4] = so3.multiply(keys[4], so3.exp([0.3, 0.2, -0.1]))
    at = np.linspace(times[0], times[-1], 400)
    a, b = (evaluate_rotations(times, k, kind, at) for k in (keys, other))
    changed = so3.angle_between(a, b) > 1e-14
    assert changed.any()
    assert (at[changed] > times[2]).all()
    assert (at[changed] < times[6]).all()


@pytest.mark.parametrize("seed", range(3))
def test_squad_of_even_keys_is_shoemakes(seed: int) -> None:
    keys, u = so3.align_signs(keyed(seed, 4)[1]), np.linspace(0, 1, 33)
    steps = so3.log(so3.multiply(so3.conjugate(keys[:-1]), keys[1:]))
    # Shoemake, 1987: s = q exp(-(log(q⁻¹ next) + log(q⁻¹ previous)) / 4).
    inner = so3.multiply(keys[1:3], so3.exp((steps[:-1] - steps[1:]) / 4))
    arcs = so3.slerp(keys[1], keys[2], u), so3.slerp(inner[0], inner[1], u)
    got = evaluate_rotations(range(-1, 3), keys, SQUAD, u)
    assert apart(got, so3.slerp(*arcs, 2 * u * (1 - u))) < CLOSE


@pytest.mark.parametrize("kind", RotationKind)
def test_one_key_everywhere(kind: RotationKind) -> None:
    for mode in Extrapolation:
        got = evaluate_rotations([1.0], [[0, 0, 3, 4]], [kind], [0, 1, 5], mode, mode)
        assert_allclose(got, [[0, 0, 0.6, 0.8]] * 3, atol=1e-16)


@pytest.mark.parametrize("kind", RotationKind)
def test_extrapolations(kind: RotationKind) -> None:
    times, keys = keyed(5)
    start, length = times[0], times[-1] - times[0]
    inside = np.linspace(0.01, 0.99, 30) * length + start

    def at(where: FloatArray, mode: str) -> FloatArray:
        way = Extrapolation(mode)
        return evaluate_rotations(times, keys, kind, where, way, way)

    plain = at(inside, "hold")
    rise = so3.multiply(so3.normalize(keys[-1]), so3.conjugate(so3.normalize(keys[0])))
    for turns in (-3, -1, 1, 2):
        there = inside + turns * length
        held = keys[[-1 if turns > 0 else 0]]
        assert apart(at(there, "hold"), held) < CLOSE
        assert apart(at(there, "cycle"), plain) < 1e-11
        power = so3.exp(turns * so3.log(rise))
        assert apart(at(there, "cycle_offset"), so3.multiply(power, plain)) < 1e-11
        if turns % 2:
            mirror = 2 * start + (turns + 1) * length - there
            assert apart(at(there, "oscillate"), at(mirror, "hold")) < 1e-11


@pytest.mark.parametrize("kind", MOVING)
def test_linear_goes_on_with_the_end_velocity(kind: RotationKind) -> None:
    times, keys = keyed(6)
    mode = Extrapolation.LINEAR

    def curve(at: FloatArray) -> FloatArray:
        return evaluate_rotations(times, keys, kind, at, mode, mode)

    for end, outward in ((times[0], -1.0), (times[-1], 1.0)):
        within = velocity(curve, end, -1e-4 * outward)
        assert_allclose(velocity(curve, end, 1e-4 * outward), within, atol=1e-5)
        beyond = velocity(curve, end + 7 * outward, 0.1 * outward)
        assert_allclose(beyond, within, atol=1e-5)


def test_linear_behind_a_step_holds() -> None:
    times, keys = keyed(6)
    mode = Extrapolation.LINEAR
    got = evaluate_rotations(times, keys, STEP, times[[0, -1]] + [-5, 5], mode, mode)
    assert apart(got, keys[[0, -1]]) < CLOSE


@pytest.mark.parametrize("kind", MOVING)
def test_signs_are_continuous(kind: RotationKind) -> None:
    times, keys = keyed(7)
    at = np.linspace(-60, 60, 20001)
    mode = Extrapolation.CYCLE_OFFSET
    got = evaluate_rotations(times, keys, kind, at, mode, mode)
    assert (np.sum(got[1:] * got[:-1], axis=-1) > 0.9).all()
    assert_allclose(np.linalg.norm(got, axis=-1), 1.0, atol=1e-15)


@pytest.mark.parametrize("kind", MOVING)
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_half_a_turn_goes_the_way_of_the_signs(kind: RotationKind, sign: float) -> None:
    keys = [[0, 0, 0, 1], [0, 0, sign, 0]]
    middle = evaluate_rotations([0, 1], keys, kind, [0.5])
    assert apart(middle, so3.from_axis_angle([0, 0, 1], [sign * np.pi / 2])) < CLOSE


@given(seeds, st.sampled_from(Extrapolation), st.data())
def test_curves_at_once_are_those_one_by_one(
    seed: int, mode: Extrapolation, data: st.DataObject
) -> None:
    times, _ = keyed(seed)
    keys = np.stack([keyed(seed + i)[1] for i in range(3)], axis=1)
    kinds = data.draw(st.lists(st.sampled_from(RotationKind), min_size=6, max_size=6))
    at = np.linspace(times[0] - 20, times[-1] + 20, 57)
    made = evaluate_rotations(times, keys, kinds, at, mode, mode)
    for i in range(3):
        alone = evaluate_rotations(times, keys[:, i], kinds, at, mode, mode)
        assert_allclose(made[:, i], alone, rtol=0, atol=1e-14)


def test_no_times_no_rotations() -> None:
    assert evaluate_rotations([0], [[0, 0, 0, 1]], SLERP, []).shape == (0, 4)


GOOD = {
    "times": [0, 1],
    "keys": [[0, 0, 0, 1], [0, 1, 0, 0]],
    "kinds": 1,
    "sample_times": [0],
}


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("times", [[0, 1]], "shape"),
        ("times", [], "at least one key"),
        ("times", [0, 0], "ascend"),
        ("times", [0, np.inf], "finite"),
        ("keys", [[0, 0, 0, 1]], "shape"),
        ("keys", [[0, 0, 0, 1], [0, 0, 0, 0]], "key 1 is zero"),
        ("keys", [[0, 0, np.nan, 1], [0, 0, 0, 1]], "key 0 is not finite"),
        ("kinds", [1], "shape"),
        ("kinds", 7, "kinds"),
        ("sample_times", [[0.0]], "shape"),
        ("sample_times", [np.nan], "finite"),
    ],
)
def test_faults(name: str, value: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        evaluate_rotations(**(GOOD | {name: value}))
