"""Places between frames: on a frame, beside it, and at both ends of a take."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.testing import assert_allclose

from animtool.edit.travel import even_positions, frame_positions, positions_between
from animtool.motion.motion import Channel


def test_what_is_within_a_billionth_of_a_frame_is_on_it() -> None:
    found = frame_positions([1 - 1e-12, 1 + 1e-12, 1 - 1e-7, 1 + 1e-7, 2.5], 4)
    assert found.frames.tolist() == [1, 1, 0, 1, 2]
    assert (found.fractions == 0).tolist() == [True, True, False, False, False]
    assert_allclose(found.frames + found.fractions, [1, 1, 1, 1, 2.5], atol=2e-7)


def test_the_first_and_the_last_frame_are_held() -> None:
    for found in (
        frame_positions([-0.5, 0.0, 2.75, 3.0, 3.5], 4),
        positions_between(np.array([0.0, 1, 2, 3]), [-0.5, 0.0, 2.75, 3.0, 3.5]),
    ):
        assert (found.frames + found.fractions).tolist() == [0, 0, 2.75, 3, 3]
    found = even_positions(np.arange(-2, 4), Fraction(1, 4), Fraction(3, 2), 4)
    places = [0, 0, 0.375, 1.875, 3, 3]
    assert (found.frames + found.fractions).tolist() == places
    channel = Channel.from_dense(np.array([0.0, 1, 4, 9])[:, None, None])
    assert_allclose(
        found.interpolate(channel).values[:, 0, 0], [0, 0, 0.375, 3.625, 9, 9]
    )


def test_a_curve_is_the_parabola_of_three_frames_at_its_ends_too() -> None:
    """Of t² it is t² between all frames, the first and last two among them."""
    channel = Channel.from_dense((np.arange(6.0) ** 2)[:, None, None])
    at = np.array([0.25, 0.5, 2.5, 4.5, 4.75])
    found = frame_positions(at, 6).interpolate_spline(channel)
    assert_allclose(found.values[:, 0, 0], at**2)
