"""Slopes that tools state as a rule, by their definitions."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from animtool.formats.fbx.tangents import (
    CLAMPED,
    CURVED,
    PROGRESSIVE,
    STEPPED,
    STRAIGHT,
    TCB,
    TIME_INDEPENDENT,
    USER,
    compute_key_slopes,
)

SECONDS, VALUES = np.array([0.0, 1.0, 3.0]), np.array([0.0, 2.0, 3.0])
CHORDS = (2.0, 0.5)


def slopes(
    flags: int,
    stated: tuple[float, float, float] = (0.0, 0.0, 0.0),
    values: npt.NDArray[np.float64] = VALUES,
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return the slopes of three keys of one kind."""
    return compute_key_slopes(
        SECONDS,
        values,
        np.full(3, flags),
        np.tile(stated, (3, 1)),
        np.full((3, 2), 1 / 3),
    )


def test_tcb_without_any_is_half_of_both_chords() -> None:
    right, left = slopes(CURVED | TCB)
    np.testing.assert_allclose(right, [2.0, 1.25, 0.5])
    np.testing.assert_allclose(left[:2], [1.25, 0.5])


@pytest.mark.parametrize(("t", "c", "b"), [(0.3, -0.4, 0.2), (-1, 1, 1), (1, 0, 0)])
def test_tcb_is_that_of_kochanek_and_bartels(t: float, c: float, b: float) -> None:
    right, left = slopes(CURVED | TCB, (t, c, b))
    low, high = CHORDS
    into = (1 - t) * (1 + b) * (1 - c) / 2 * low + (1 - t) * (1 - b) * (
        1 + c
    ) / 2 * high
    out = (1 - t) * (1 + b) * (1 + c) / 2 * low + (1 - t) * (1 - b) * (1 - c) / 2 * high
    np.testing.assert_allclose([left[0], right[1]], [into, out])


def test_automatic_slopes_lie_between_the_chords() -> None:
    right, left = slopes(CURVED | TIME_INDEPENDENT)
    # From one neighbour to the other; at the ends along the segment.
    np.testing.assert_allclose(right, [2.0, 1.0, 0.5])
    np.testing.assert_allclose(left[:2], [1.0, 0.5])
    # By time the chords count besides, the shorter segment's the more.
    right, _ = slopes(CURVED)
    assert right[1] == pytest.approx(0.5 * 1.0 + 0.5 * (2.0 * 2 / 3 + 0.5 / 3))


def test_a_bias_goes_towards_a_neighbour() -> None:
    plain = slopes(CURVED)[0][1]
    right, left = slopes(CURVED, (50.0, 50.0, 0.0))
    # What is stated of the key before is the bias into this one, its sign turned.
    assert right[1] == pytest.approx(0.5 * plain + 0.5 * CHORDS[1])
    assert left[0] == pytest.approx(0.5 * plain + 0.5 * CHORDS[0])
    # Beyond five times whole its square is added, towards the neighbour.
    far = slopes(CURVED, (-700.0, 0.0, 0.0))[0][1]
    assert far == pytest.approx(plain * -6.0 + 7.0 * CHORDS[0] + 2.0**2 * 40.0)


def test_progressive_ones_do_not_overshoot() -> None:
    flags = CURVED | TIME_INDEPENDENT | PROGRESSIVE
    right, left = slopes(flags, values=np.array([0.0, 1.0, 0.0]))
    assert not right.any()
    assert not left.any()
    right, _ = slopes(flags, values=np.array([0.0, 0.1, 9.0]))
    # Three times the lower chord keeps a handle at a third within the values.
    assert right[1] == pytest.approx(3 * 0.1)


def test_clamped_ones_are_flat_next_to_an_equal_key() -> None:
    flags = CURVED | TIME_INDEPENDENT | CLAMPED
    right, _ = slopes(flags, values=np.array([1.0, 1.0, 5.0]))
    assert right[1] == 0.0


def test_others_have_what_is_stated_or_their_chord() -> None:
    right, left = slopes(CURVED | USER, (4.0, 5.0, 0.0))
    np.testing.assert_allclose([right[1], left[1]], [4.0, 5.0])
    right, left = slopes(STRAIGHT, (4.0, 5.0, 0.0))
    np.testing.assert_allclose([right[:2], left[:2]], [CHORDS, CHORDS])
    assert not slopes(STEPPED, (4.0, 5.0, 0.0))[0].any()
