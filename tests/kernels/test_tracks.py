from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool import _kernels
from animtool.maths import so3


@pytest.mark.parametrize("frames", [0, 1, 63, 64, 65, 200])
@pytest.mark.parametrize("with_previous", [False, True])
def test_rotations_have_unit_length_and_continuous_signs(
    frames: int, with_previous: bool
) -> None:
    rng = np.random.default_rng(frames)
    tracks = [rng.normal(size=(frames, 4)).astype(np.float32) for _ in range(5)]
    previous = rng.normal(size=(5, 4)) if with_previous else None
    found = _kernels.unpack_rotations(tracks, previous)
    expected = np.stack(tracks, axis=1).astype(np.float64)
    expected /= np.linalg.norm(expected, axis=2, keepdims=True)
    assert found.shape == (frames, 5, 4)
    assert_allclose(found, so3.align_signs(expected, previous), atol=1e-15)


def test_no_tracks_are_no_rotations() -> None:
    assert _kernels.unpack_rotations([], None).shape == (0, 0, 4)


def test_tracks_of_other_shapes() -> None:
    one = np.ones((6, 4), np.float32)
    for other in (one[:5], one[:, :3].copy()):
        with pytest.raises(ValueError, match="tracks"):
            _kernels.unpack_rotations([one, other], None)
    with pytest.raises(ValueError, match="previous"):
        _kernels.unpack_rotations([one], np.ones((2, 4)))


def test_squared_lengths() -> None:
    rows = np.array([[0, 0, 3, 4], [0, 0, 0, 0.5]], np.float32)
    assert _kernels.squared_lengths(rows) == (0.25, 25.0)
    for odd in (np.nan, np.inf, 1e30):
        rows[1, 2] = odd
        assert np.isnan(_kernels.squared_lengths(rows)).all()
