"""Laws of curves, segment by segment and outside the keys."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from support.curves import one_curve

from animtool.maths.curves import (
    Curves,
    Extrapolation,
    SegmentKind,
    end_slopes,
    evaluate,
)

SEEDS = st.integers(0, 10_000)
TIGHT = 1e-14


def random_curves(seed: int, count: int = 3) -> Curves:
    """Return curves of every kind of segment, handles up to twice too long."""
    rng = np.random.default_rng(seed)
    lengths = rng.integers(1, 8, count)
    first = np.concatenate([[0], np.cumsum(lengths)])
    keys = int(first[-1])
    share = rng.choice([0.0, 0.3, 1.0, 2.0], (2, keys)) * rng.uniform(0.5, 1, (2, keys))
    times = np.concatenate([np.cumsum(rng.uniform(0.1, 3, n)) for n in lengths])
    modes = list(Extrapolation)
    return Curves(
        first_keys=first,
        times=times,
        values=rng.normal(size=keys),
        kinds=rng.integers(0, 4, keys),
        in_handles=np.stack([-share[0], rng.normal(size=keys)], axis=-1),
        out_handles=np.stack([share[1], rng.normal(size=keys)], axis=-1),
        pre=tuple(modes[i] for i in rng.integers(0, len(modes), count)),
        post=tuple(modes[i] for i in rng.integers(0, len(modes), count)),
    )


@given(SEEDS)
def test_curves_pass_through_their_keys(seed: int) -> None:
    curves = random_curves(seed, 1)
    assert_array_equal(evaluate(curves, curves.times)[0], curves.values)


@given(SEEDS)
def test_curves_do_not_know_each_other(seed: int) -> None:
    curves = random_curves(seed)
    at = np.linspace(-5, 30, 211)
    together = evaluate(curves, at)
    for c, (start, end) in enumerate(
        zip(curves.first_keys, curves.first_keys[1:], strict=False)
    ):
        arrays = {
            name: getattr(curves, name)[start:end]
            for name in ("times", "values", "kinds", "in_handles", "out_handles")
        }
        alone = replace(
            curves,
            first_keys=np.array([0, end - start]),
            pre=curves.pre[c : c + 1],
            post=curves.post[c : c + 1],
            **arrays,
        )
        assert_array_equal(evaluate(alone, at)[0], together[c])


@given(SEEDS)
def test_the_order_of_times_changes_nothing(seed: int) -> None:
    curves = random_curves(seed)
    at = np.linspace(-5, 30, 211)
    order = np.random.default_rng(seed).permutation(len(at))
    assert_array_equal(evaluate(curves, at[order]), evaluate(curves, at)[:, order])


@given(SEEDS)
def test_extrapolation_begins_at_the_key(seed: int) -> None:
    curves = random_curves(seed)
    for c, (pre, post) in enumerate(zip(curves.pre, curves.post, strict=True)):
        start, end = curves.first_keys[c], curves.first_keys[c + 1] - 1
        for key, mode, side in ((start, pre, -np.inf), (end, post, np.inf)):
            if mode is Extrapolation.CYCLE:
                continue
            props = np.nextafter(curves.times[key], side)
            # The far end of a cycle may be a HOLD's jump or a vertical handle.
            if mode in {Extrapolation.CYCLE_OFFSET, Extrapolation.OSCILLATE}:
                continue
            found = evaluate(curves, [props])[c, 0]
            assert_allclose(found, curves.values[key], atol=1e-12)


@pytest.mark.parametrize("mode", [Extrapolation.CYCLE_OFFSET, Extrapolation.OSCILLATE])
def test_cycles_meet(mode: Extrapolation) -> None:
    curve = one_curve(
        [1.0, 3.0], [2.0, 5.0], SegmentKind.BEZIER, (-0.5, -0.2), (0.7, 0.1), mode, mode
    )
    seams = np.array([-5.0, -3.0, -1.0, 1.0, 3.0, 5.0, 7.0])
    gap = evaluate(curve, seams + 1e-9) - evaluate(curve, seams - 1e-9)
    assert np.abs(gap).max() < 1e-8


def test_hold_and_linear_are_exact() -> None:
    hold = one_curve([0.0, 2.0, 3.0], [1.0, 5.0, 7.0], SegmentKind.HOLD)
    at = [-1.0, 0.0, 1.0, np.nextafter(2.0, 0), 2.0, 2.5, 3.0, 9.0]
    assert evaluate(hold, at)[0].tolist() == [1, 1, 1, 1, 5, 5, 7, 7]
    line = replace(hold, kinds=np.full(3, SegmentKind.LINEAR))
    assert evaluate(line, at)[0].tolist()[:3] == [1, 1, 3]
    assert evaluate(line, [2.25, 2.5, 2.75])[0].tolist() == [5.5, 6, 6.5]


@given(SEEDS)
def test_a_cubic_is_a_bezier_with_handles_at_thirds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    dv, rise, h = rng.normal(size=2), rng.normal(), rng.uniform(0.1, 10)
    ins, outs = [[0.0, 0.0], [-h / 3, dv[0]]], [[h / 3, dv[1]], [0.0, 0.0]]
    at = np.linspace(0, h, 50)
    found = [
        evaluate(one_curve([0.0, h], [0.0, rise], kind, ins, outs), at)
        for kind in (SegmentKind.CUBIC, SegmentKind.BEZIER)
    ]
    assert_allclose(found[0], found[1], atol=TIGHT * (1 + np.abs(dv).max()))


@pytest.mark.parametrize(
    ("out", "into"), [((3.0, 6.0), (-4.0, 2.0)), ((0.5, 1.0), (-9.0, 0.0))]
)
def test_a_handle_too_long_is_shrunk(
    out: tuple[float, float], into: tuple[float, float]
) -> None:
    shrunk = [np.array(v) / max(1.0, abs(v[0]) / 2) for v in (out, into)]
    at = np.linspace(0, 2, 41)
    curves = [
        one_curve([0.0, 2.0], [0.0, 1.0], SegmentKind.BEZIER, b, a)
        for a, b in ((out, into), shrunk)
    ]
    assert_array_equal(evaluate(curves[0], at), evaluate(curves[1], at))


@pytest.mark.parametrize("time", [5e-324, 1e-300, 1e-100, 1e-20, 1e-9])
def test_props_a_key_without_handles(time: float) -> None:
    # Both handles at the first key: the time is u³, and so is the value.
    ins, outs = [[0.0, 0.0], [-1.0, -1.0]], (0.0, 0.0)
    curve = one_curve([0.0, 1.0], [0.0, 1.0], SegmentKind.BEZIER, ins, outs)
    assert_allclose(evaluate(curve, [time])[0], time, rtol=1e-12, atol=5e-324)


def test_slopes_at_the_ends() -> None:
    keys = [0.0, 2.0, 4.0], [0.0, 1.0, 5.0]
    bezier, cubic = SegmentKind.BEZIER, SegmentKind.CUBIC
    slopes = {
        SegmentKind.HOLD: [0.0, 0.0],
        SegmentKind.LINEAR: [0.5, 2.0],
        cubic: [4.5, 1.5],
        bezier: [3.0, 2.0],
    }
    for kind, wanted in slopes.items():
        curve = one_curve(*keys, kind, (-0.5, -1.0), (1.0, 3.0))
        assert end_slopes(curve).tolist() == [wanted]
    vertical = one_curve(*keys, bezier, (0.0, 1.0), (0.0, 0.0))
    assert end_slopes(vertical).tolist() == [[0.5, 2.0]]
    assert end_slopes(one_curve([1.0], [2.0])).tolist() == [[0.0, 0.0]]


def test_linear_goes_on_along_the_handle() -> None:
    mode = Extrapolation.LINEAR
    curve = one_curve(
        [0.0, 2.0], [0.0, 1.0], SegmentKind.BEZIER, (-0.5, -1.0), (1.0, 3.0), mode, mode
    )
    assert evaluate(curve, [-2.0, 5.0])[0].tolist() == [-6.0, 7.0]


def test_curves_with_the_same_key_times_are_as_each_alone() -> None:
    """More curves, and more times, than are looked at together."""
    rng = np.random.default_rng(5)
    count, curves = 40, 19
    total, held = count * curves, (Extrapolation.HOLD,) * curves
    own = np.sort(rng.uniform(0, 9, count))
    together = Curves(
        np.arange(curves + 1) * count,
        np.concatenate([np.tile(own, curves - 1), own + 0.1]),
        rng.normal(size=total),
        rng.integers(0, 4, total),
        rng.uniform(-0.2, 0, (total, 2)),
        rng.uniform(0, 0.2, (total, 2)),
        held,
        held,
    )
    at = np.sort(rng.uniform(-1, 10, 2500))
    values = evaluate(together, at)
    into = np.zeros(values.shape)
    assert evaluate(together, at, out=into) is into
    assert_array_equal(into, values)
    for c in range(curves):
        keys = slice(c * count, (c + 1) * count)
        alone = Curves(
            np.array([0, count]),
            *(getattr(together, name)[keys] for name in ARRAYS),
            held[:1],
            held[:1],
        )
        assert_array_equal(evaluate(alone, at)[0], values[c])


def test_out_has_the_shape_of_the_values() -> None:
    with pytest.raises(ValueError, match=r"out must be float64 \(3, 1\)"):
        evaluate(random_curves(1), [0.5], out=np.zeros((3, 2)))


def test_no_times_give_no_values() -> None:
    curves = random_curves(1)
    assert evaluate(curves, []).shape == (3, 0)


ARRAYS = ("times", "values", "kinds", "in_handles", "out_handles")

FAULTS = {
    "first_keys": ("first_keys", np.array([0, 1])),
    "times: .* not ascending": ("times", np.array([1.0, 1.0])),
    "times: .* not finite": ("times", np.array([0.0, np.nan])),
    "values: nan": ("values", np.array([np.nan, 0.0])),
    "values must have": ("values", np.zeros(3)),
    "ins must have": ("in_handles", np.zeros((2, 3))),
    "outs: .* not finite": ("out_handles", np.full((2, 2), np.inf)),
    "kinds: 7": ("kinds", np.array([7, 0])),
    "outs: .* points away": ("out_handles", np.array([[-1.0, 0.0], [0.0, 0.0]])),
    "pre and post": ("pre", ()),
}


@pytest.mark.parametrize("message", FAULTS)
def test_faults(message: str) -> None:
    name, value = FAULTS[message]
    curve = one_curve([0.0, 1.0], [0.0, 1.0], SegmentKind.BEZIER)
    with pytest.raises(ValueError, match=message):
        evaluate(replace(curve, **{name: value}), [0.5])
