"""Tracks that are known at some frames."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from animtool.edit.looping import resample_track
from animtool.maths import so3
from animtool.motion.transforms import Attribute, Track, Transforms


def known(count: int, seed: int) -> Transforms:
    """Return a thing that moves, with a color, a word, and held frames at its end."""
    rng = np.random.default_rng(seed)
    turns = so3.exp(np.cumsum(rng.normal(0, 0.2, (count, 3)), axis=0))
    return Transforms(
        rng.normal(size=(count, 3)),
        so3.align_signs(turns),
        1 + rng.random((count, 3)),
        None,
        (rng.random((count, 4)), rng.integers(0, 2, count)),
        np.arange(count) == count - 1,
    )


TRACK = Track(
    "box",
    lambda times: known(len(times), 0),
    attributes=(
        Attribute("color", "color4f", 4),
        Attribute("state", "token", 0, ("dry", "wet")),
    ),
)


@given(st.integers(2, 30), st.integers(0, 99), st.floats(-3, 40))
def test_it_is_what_is_known_and_between(count: int, seed: int, time: float) -> None:
    given_ = known(count, seed)
    track = resample_track(TRACK, given_)
    whole = track.at(np.arange(count, dtype=np.float64))
    assert_array_equal(whole.matrix(), given_.matrix())
    for one, other in zip(whole.values, given_.values, strict=True):
        assert_array_equal(one, other)
    assert whole.is_clamped is not None
    assert whole.is_clamped.tolist() == [False] * (count - 1) + [True]
    found = track.at(np.array([time]))
    low = int(np.clip(np.floor(time), 0, count - 1))
    high, part = min(low + 1, count - 1), float(np.clip(time, 0, count - 1)) - low
    color = given_.values[0]
    assert_allclose(
        found.values[0][0], color[low] + (color[high] - color[low]) * part, atol=1e-7
    )
    assert found.values[1][0] == given_.values[1][low if part < 1 - 1e-8 else high]
    middle = so3.slerp(given_.rotations[low], given_.rotations[high], np.array([part]))
    assert so3.angle_between(found.rotations[0], middle.ravel()) < 1e-6
