from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from animtool import _kernels
from animtool.maths import so3

LARGEST = float(np.finfo(np.float32).max)


@given(st.integers(0, 2**31), st.sampled_from([1.0, 0.01, 0.0254]))
def test_points_are_those_of_numpy(seed: int, unit: float) -> None:
    rng = np.random.default_rng(seed)
    shape = (int(rng.integers(1, 4)), int(rng.integers(1, 9)), 3)
    points = rng.normal(size=shape) * 10.0 ** rng.uniform(-3, 6)
    rounded, error, frame, vertex = _kernels.round_points(points, unit)
    exact = points / unit
    assert rounded.dtype == np.float32
    assert_array_equal(rounded, exact.astype(np.float32))
    off = np.linalg.norm(rounded - exact, axis=-1) * unit
    assert error == pytest.approx(off.max(), rel=1e-12)
    assert off[frame, vertex] == pytest.approx(error, rel=1e-12)


def test_what_float32_holds_does_not_move() -> None:
    points = np.arange(12.0).reshape(2, 2, 3)
    assert _kernels.round_points(points, 1.0)[1:] == (0.0, 0, 0)


def test_what_float32_does_not_hold_is_its_largest_number() -> None:
    rounded = _kernels.round_points(np.array([[[1e300, -1e300, 1.0]]]), 1.0)[0]
    assert rounded.ravel().tolist() == [LARGEST, -LARGEST, 1.0]


def test_the_worst_of_many_points_is_found() -> None:
    rng = np.random.default_rng(3)
    points = rng.normal(size=(3, 1000, 3)).astype(np.float32).astype(np.float64)
    points[2, 777] += [0.0, 3e-9, 0.0]
    points[0, 5] += [1e-9, 0.0, 0.0]
    rounded, error, frame, vertex = _kernels.round_points(points, 1.0)
    assert (frame, vertex) == (2, 777)
    assert error == np.linalg.norm(rounded[2, 777] - points[2, 777])


def test_one_point_beyond_float32_leaves_the_others() -> None:
    points = np.ones((1, 600, 3))
    points[0, 300] = [1e300, 0.1, -np.inf]
    rounded, _, frame, vertex = _kernels.round_points(points, 0.5)
    assert rounded[0, 300].tolist() == [LARGEST, np.float32(0.2), -LARGEST]
    assert (np.delete(rounded, 300, axis=1) == 2).all()
    assert (frame, vertex) == (0, 300)


@pytest.mark.parametrize("shape", [(0, 4, 3), (2, 0, 3)])
def test_nothing(shape: tuple[int, ...]) -> None:
    rounded, error, _, _ = _kernels.round_points(np.zeros(shape), 1.0)
    assert rounded.shape == shape
    assert error == 0.0


def test_bad_arguments() -> None:
    with pytest.raises(ValueError, match="points"):
        _kernels.round_points(np.zeros((1, 2, 4)), 1.0)
    for unit in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="unit"):
            _kernels.round_points(np.zeros((1, 2, 3)), unit)


@pytest.mark.parametrize("frames", [0, 1, 2, 300])
def test_signs_continue_as_those_of_float64(frames: int) -> None:
    rng = np.random.default_rng(frames)
    rows = rng.normal(size=(frames, 5, 4)).astype(np.float32)
    rows[frames // 2 :, 2] = 0.0
    previous = rng.normal(size=(5, 4)).astype(np.float32)
    expected = so3.align_signs(rows, previous).astype(np.float32)
    found = _kernels.continue_signs(rows, previous)
    assert (rows if found is None else found).tobytes() == expected.tobytes()
    if frames:
        assert _kernels.continue_signs(expected, expected[0]) is None


def test_signs_of_other_shapes_are_refused() -> None:
    rows = np.ones((2, 3, 4), np.float32)
    for previous in (rows[0, :2].copy(), rows[0, :, :3].copy()):
        with pytest.raises(ValueError, match="previous"):
            _kernels.continue_signs(rows, previous)
    with pytest.raises(ValueError, match="rotations"):
        _kernels.continue_signs(rows[..., :3].copy(), rows[0])
