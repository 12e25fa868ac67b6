"""Holding targets still: laws of the ease."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from animtool.core.array_types import FloatArray
from animtool.ik.values import Span, blend_holds, hold_weights, smoothstep
from animtool.maths import so3


@st.composite
def spans_and_ease(draw: st.DrawFn) -> tuple[list[Span], float]:
    """Return spans, some nearer than their eases, and an ease."""
    spans, end = [], draw(st.floats(-20, 20))
    for _ in range(draw(st.integers(1, 4))):
        first = end + draw(st.floats(0.5, 15))
        end = first + draw(st.floats(0, 10))
        spans.append((first, end))
    return spans, draw(st.floats(0.5, 8))


def path(times: FloatArray) -> FloatArray:
    """Return a smooth motion ``(F, 3)``."""
    return np.stack([np.sin(0.3 * times), 0.1 * times, np.cos(0.2 * times)], axis=1)


def turns(times: FloatArray) -> FloatArray:
    """Return a smooth turning ``(F, 4)``."""
    return so3.exp(0.8 * path(times))


@given(spans_and_ease())
def test_inside_a_span_the_target_is_constant(made: tuple[list[Span], float]) -> None:
    spans, ease = made
    for motion in (path, turns):
        stills = motion(np.array([first for first, _ in spans]))
        for i, (first, last) in enumerate(spans):
            times = np.linspace(first, last, 7)
            found = blend_holds(motion(times), hold_weights(times, spans, ease), stills)
            expected = stills[i]
            if found.shape[1] == 4:
                expected = expected * np.sign(found[0] @ expected)
            assert_array_equal(found, np.tile(expected, (7, 1)))


@given(spans_and_ease())
def test_no_more_than_one_holds(made: tuple[list[Span], float]) -> None:
    spans, ease = made
    times = np.linspace(spans[0][0] - 10, spans[-1][1] + 10, 301)
    shares = hold_weights(times, spans, ease)
    assert ((shares >= 0) & (shares <= 1)).all()
    assert ((shares > 0).sum(axis=0) <= 1).all()


@given(spans_and_ease(), st.sampled_from([path, turns]))
def test_value_and_speed_do_not_jump(
    made: tuple[list[Span], float], motion: object
) -> None:
    assert callable(motion)
    spans, ease = made
    stills = motion(np.array([first for first, _ in spans]))
    joins = []
    for i, (first, last) in enumerate(spans):
        before = ease if i == 0 else min(ease, (first - spans[i - 1][1]) / 2)
        behind = (
            ease if i + 1 == len(spans) else min(ease, (spans[i + 1][0] - last) / 2)
        )
        joins += [first - before, first, last, last + behind]
    h = 1e-5
    times = (np.array(joins)[:, None] + h * np.array([-2, -1, 0, 1, 2])).ravel()
    found = blend_holds(motion(times), hold_weights(times, spans, ease), stills)
    rows = found.reshape(len(joins), 5, -1)
    # Signs of quaternions are brought along row by row.
    rows = rows * np.where((rows * rows[:, 2:3]).sum(-1, keepdims=True) < 0, -1, 1)
    left, right = rows[:, 2] - rows[:, 1], rows[:, 3] - rows[:, 2]
    # The steepest ease allowed here turns by 30 in a frame², times the step.
    assert_allclose(left / h, right / h, atol=2e-2)
    assert_allclose(left, 0, atol=1e-3)


@given(spans_and_ease(), st.sampled_from([0.5, 2.0, 24000 / 1001 / 24]))
def test_the_frame_rate_does_not_matter(
    made: tuple[list[Span], float], ratio: float
) -> None:
    spans, ease = made
    times = np.linspace(spans[0][0] - 9, spans[-1][1] + 9, 61)
    other = [(a * ratio, b * ratio) for a, b in spans]
    found = hold_weights(times * ratio, other, ease * ratio)
    assert_allclose(found, hold_weights(times, spans, ease), atol=1e-9)


def test_without_ease_it_steps() -> None:
    times = np.array([1.0, 1.999, 2.0, 3.0, 3.001])
    assert hold_weights(times, [(2.0, 3.0)], 0.0).tolist() == [[0, 0, 1, 1, 0]]


def test_the_ease_has_no_acceleration_at_its_ends() -> None:
    h = 1e-4
    for end in (0.0, 1.0):
        at = smoothstep(np.array([end - h, end, end + h]))
        assert at[0] - 2 * at[1] + at[2] == pytest.approx(0, abs=1e-10)


def test_what_is_held_takes_the_sign_of_the_motion() -> None:
    turns = so3.from_axis_angle([0.0, 1.0, 0.0], np.linspace(0.0, 0.4, 9))
    shares = hold_weights(np.arange(9.0), [(3.0, 5.0)], 2.0)
    for still in (turns[4], -turns[4]):
        found = blend_holds(turns, shares, still[None])
        assert (np.sum(found[1:] * found[:-1], axis=1) > 0.9).all()
        assert so3.angle_between(found[4], still) < 1e-9
