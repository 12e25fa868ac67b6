from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from animtool import _kernels

INFLUENCES = {
    "first": np.array([0, 1, 2]),
    "joints": np.array([0, 1], np.int32),
    "weights": np.ones(2),
}
POINTS = {"points": np.zeros((1, 2, 3)), "normalizes": False}
OUT = {"out": np.zeros((3, 2, 3))}
LINEAR = {**INFLUENCES, **POINTS, "transforms": np.ones((3, 2, 3, 4)), **OUT}
DUAL = {
    **INFLUENCES,
    **POINTS,
    "rotations": np.tile([0.0, 0, 0, 1], (3, 2, 1)),
    "translations": np.ones((3, 2, 3)),
    "stretches": None,
    **OUT,
}
SPARSE = {
    "points": np.zeros((1, 2, 3)),
    "weights": np.ones((5, 2)),
    "first": np.array([0, 1, 3]),
    "columns": np.array([1, 0, 1], np.int32),
    "offsets": np.ones((3, 3)),
    "out": np.zeros((5, 2, 3)),
}


def filled(kernel: Callable[..., None], arguments: dict[str, object]) -> object:
    out = np.full(np.shape(arguments["out"]), np.nan)
    kernel(**{**arguments, "out": out})
    return out


def test_each_gives_all_frames() -> None:
    ones = np.ones((3, 2, 3))
    assert_array_equal(filled(_kernels.skin_linear, LINEAR), ones)
    assert_array_equal(filled(_kernels.skin_dual_quaternion, DUAL), ones)
    expected = np.broadcast_to([[1.0], [2.0]], (5, 2, 3))
    assert_array_equal(filled(_kernels.add_sparse, SPARSE), expected)


def test_sparse_adds_in_place() -> None:
    points = np.ones((5, 2, 3))
    _kernels.add_sparse(**{**SPARSE, "points": points, "out": points})
    assert_array_equal(points, np.broadcast_to([[2.0], [3.0]], (5, 2, 3)))


def test_no_frames() -> None:
    out = np.zeros((0, 2, 3))
    none = {"transforms": np.ones((0, 2, 3, 4)), "out": out}
    assert _kernels.skin_linear(**{**LINEAR, **none}) is None
    assert out.shape == (0, 2, 3)


def test_a_result_of_another_kind_is_refused() -> None:
    for out in (np.zeros((3, 2, 3), np.float32), np.zeros((3, 3, 2)).swapaxes(1, 2)):
        with pytest.raises(TypeError):
            _kernels.skin_linear(**{**LINEAR, "out": out})


BAD_INFLUENCES = [
    ("first", np.array([0, 1, 3])),
    ("first", np.array([1, 1, 2])),
    ("first", np.array([0, 3, 2])),
    ("first", np.zeros(0, np.int64)),
    ("joints", np.array([0, 2], np.int32)),
    ("joints", np.array([-1, 0], np.int32)),
    ("weights", np.ones(3)),
    ("points", np.zeros((2, 2, 3))),
    ("points", np.zeros((1, 3, 3))),
    ("points", np.zeros((1, 2, 4))),
    ("out", np.zeros((2, 2, 3))),
]


@pytest.mark.parametrize(
    ("name", "value"), [*BAD_INFLUENCES, ("transforms", np.ones((3, 2, 4, 4)))]
)
def test_linear_refuses_bad_arrays(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=rf"^{name}: "):
        _kernels.skin_linear(**{**LINEAR, name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *BAD_INFLUENCES,
        ("rotations", np.ones((3, 2, 3))),
        ("translations", np.ones((3, 1, 3))),
        ("stretches", np.ones((3, 2, 3, 1))),
    ],
)
def test_dual_quaternions_refuse_bad_arrays(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=rf"^{name}: "):
        _kernels.skin_dual_quaternion(**{**DUAL, name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("points", np.zeros((2, 2, 3))),
        ("first", np.array([0, 1, 2])),
        ("first", np.array([0, 4, 3])),
        ("columns", np.array([0, 2, 0], np.int32)),
        ("offsets", np.ones((2, 3))),
        ("weights", np.ones((5, 1))),
        ("out", np.zeros((4, 2, 3))),
    ],
)
def test_sparse_refuses_bad_arrays(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=r"^(first|columns|points|offsets|out): "):
        _kernels.add_sparse(**{**SPARSE, name: value})


def test_others_refuse_bad_arrays() -> None:
    with pytest.raises(ValueError, match="points"):
        _kernels.point_extents(np.zeros((1, 2, 2)))
    with pytest.raises(ValueError, match="linear"):
        _kernels.split_stretch(np.zeros((1, 2, 2, 3)))
