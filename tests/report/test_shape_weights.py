from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from animtool.core.clock import Clock
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.report.compare import compare_takes
from animtool.rig.parts import Shape
from animtool.rig.skeleton import Joint, Rig

FRAMES = 5
NAMES = ("blink", "jawOpen", "smile")
Floats = npt.NDArray[np.float64]


def take(weights: Floats | None, names: tuple[str, ...] = NAMES) -> Take:
    rig = Rig("face", (Joint("head", -1),), shapes=tuple(map(Shape, names)))
    frames = FRAMES if weights is None else len(weights)
    motion = Motion(
        Channel.from_dense(np.repeat(rig.rest_translations[None], frames, 0)),
        Channel.from_dense(np.repeat(rig.rest_rotations[None], frames, 0)),
        None,
        None if weights is None else Channel.from_dense(weights[..., None]),
    )
    return Take(rig, Clock(Fraction(24), Fraction(11), Fraction(1), frames), motion)


def still(value: float = 0.0) -> Floats:
    return np.full((FRAMES, len(NAMES)), value)


def test_weights_that_differ_are_a_difference() -> None:
    opened, barely = still(), still()
    opened[3, 1], barely[3, 1] = 1.0, 0.1
    found = compare_takes(take(opened), take(barely))
    assert found.weight.value == pytest.approx(0.9)
    assert (found.weight.shape, found.weight.code) == ("jawOpen", 14)
    assert found.shapes == 3
    assert not found.within(1.0, 1.0)
    assert found.within(1.0, 1.0, weights=0.91)


def test_shapes_are_compared_by_name() -> None:
    weights = np.arange(15.0).reshape(FRAMES, 3)
    other = take(weights[:, [2, 0, 1]], ("smile", "blink", "JawOpen"))
    found = compare_takes(take(weights), other)
    assert (found.weight.value, found.shapes) == (0.0, 3)
    assert found.within(0.0, 0.0, 0.0)


def test_two_spellings_of_one_shape_are_two_shapes_in_one_take() -> None:
    both = ("JawOpen", "jawOpen", "smile")
    weights = np.arange(15.0).reshape(FRAMES, 3)
    found = compare_takes(take(weights, both), take(weights[:, 1:], both[1:]))
    assert found.weight.value == 0
    assert found.mismatches == ["1 shape is not in the second: JawOpen"]


@pytest.mark.parametrize("swap", [False, True])
def test_a_shape_that_one_lacks_counts_unless_it_is_zero(swap: bool) -> None:
    weights = still()
    weights[-1, 2] = 1e-9
    more, fewer = take(weights), take(still()[:, :2], NAMES[:2])
    found = compare_takes(*((fewer, more) if swap else (more, fewer)))
    other = "first" if swap else "second"
    assert found.mismatches == [f"1 shape is not in the {other}: smile"]
    assert not found.within(1.0, 1.0, 1.0)
    resting = compare_takes(take(still()), fewer)
    assert resting.within(0.0, 0.0, 0.0)


def test_a_take_without_weights_has_them_at_zero() -> None:
    assert compare_takes(take(None), take(still())).within(0.0, 0.0, 0.0)
    assert compare_takes(take(None), take(still(0.5))).weight.value == 0.5


def test_other_rates_are_compared_at_equal_times() -> None:
    ramp = np.linspace(0, 1, FRAMES)[:, None] * np.ones(3)
    slow = take(ramp)
    fast = take(np.linspace(0, 1, 2 * FRAMES - 1)[:, None] * np.ones(3))
    fast = replace(fast, clock=replace(fast.clock, fps=Fraction(48)))
    assert compare_takes(slow, fast).weight.value == pytest.approx(0, abs=1e-12)


@given(
    arrays(np.float64, (2, FRAMES, 3), elements=st.floats(-2, 2)),
    st.permutations(range(3)),
)
def test_the_order_of_shapes_and_takes_is_no_matter(
    weights: Floats, order: list[int]
) -> None:
    one, two = weights
    largest = np.abs(one - two).max()
    other = take(two[:, order], tuple(NAMES[i] for i in order))
    for a, b in ((take(one), other), (other, take(one))):
        assert compare_takes(a, b).weight.value == largest
