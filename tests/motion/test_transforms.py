"""Tracks: functions of a time of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from animtool.maths import so3
from animtool.motion.transforms import Track, Transforms, rotate_track


def spinning(times: np.ndarray) -> Transforms:
    """Return what turns about two axes, slides and grows."""
    turn = np.stack([times, np.sin(times), 0 * times], axis=1)
    place = np.stack([times, times**2, np.ones_like(times)], axis=1)
    scale = np.stack([1 + times**2, 2 + 0 * times, 3 + 0 * times], axis=1)
    return Transforms(place, so3.exp(turn), scale)


def sheared(times: np.ndarray) -> Transforms:
    """Return the same as matrices with a shear."""
    found = spinning(times)
    matrices = found.matrix()
    matrices[:, 0, 1] += times
    return replace(found, matrices=matrices)


@given(st.floats(-20, 20), st.sampled_from([spinning, sheared]))
def test_a_turned_track_is_turned_as_a_whole(time: float, sample: object) -> None:
    turn = so3.exp(np.array([0.3, -1.0, 2.0]))
    track = Track("box", sample)
    whole = np.eye(4)
    whole[:3, :3] = so3.to_matrix(turn)
    times = np.array([time])
    expected = whole @ track.at(times).matrix()
    found = rotate_track(track, turn).at(times).matrix()
    assert_allclose(found, expected, atol=1e-12 * max(1, np.abs(expected).max()))


def test_signs_of_rotations_are_continuous() -> None:
    found = Track("box", spinning).at(np.linspace(0, 20, 300)).rotations
    assert (np.sum(found[1:] * found[:-1], axis=-1) > 0).all()
