from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool import _kernels

JOINTS, FRAMES = 3, 4
PARENTS = np.array([-1, 0, 1])
T, R = np.zeros((FRAMES, JOINTS, 3)), np.ones((FRAMES, JOINTS, 4)) / 2
POSITIONS, LINEAR = np.zeros((FRAMES, JOINTS, 3)), np.zeros((FRAMES, JOINTS, 3, 3))


def test_parents_stand_before_their_children() -> None:
    for wrong in ([0, 0, 1], [-1, 2, 1]):
        with pytest.raises(ValueError, match="parent"):
            _kernels.forward_kinematics(np.array(wrong), T, R, None, POSITIONS, LINEAR)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ((T[:, :2].copy(), R, None, POSITIONS, LINEAR), "translations"),
        ((T, R[1:], None, POSITIONS, LINEAR), "rotations"),
        ((T, R, T[:1], POSITIONS, LINEAR), "scales"),
        ((T, R, None, POSITIONS[1:], LINEAR), "positions"),
        ((T, R, None, POSITIONS, LINEAR[:, 1:].copy()), "linear"),
    ],
)
def test_shapes_that_do_not_fit(given: tuple[np.ndarray, ...], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        _kernels.forward_kinematics(PARENTS, *given)


def test_results_are_never_a_copy() -> None:
    for positions, linear in (
        (POSITIONS.astype(np.float32), LINEAR),
        (POSITIONS, LINEAR.swapaxes(-1, -2)),
    ):
        with pytest.raises(TypeError):
            _kernels.forward_kinematics(PARENTS, T, R, None, positions, linear)


def test_rounding_report_finds_the_joint() -> None:
    parents = np.array([-1, 0, 1])
    translations = np.zeros((2, 3, 3))
    translations[:, 1:, 1] = 1.0
    rotations = np.zeros((2, 3, 4))
    rotations[..., 3] = 1.0
    written = translations.astype(np.float32)
    written[1, 2, 0] = 0.25
    extents, error, frame, joint = _kernels.measure_rounding(
        parents,
        translations,
        rotations,
        None,
        written,
        rotations.astype(np.float32),
        None,
    )
    assert (error, frame, joint) == (0.25, 1, 2)
    assert_allclose(extents[0], [[0, 0, 0], [0, 2, 0]])
    assert_allclose(extents[1], [[0, 0, 0], [0.25, 2, 0]])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("types", np.array([5])),
        ("types", np.array([-1])),
        ("columns", np.array([1])),
        ("axes", np.zeros((2, 3))),
        ("rest_rotations", np.zeros((1, 3))),
        ("coordinates", np.zeros((3, 2))),
    ],
)
def test_joints_have_types_and_coordinates(name: str, value: Any) -> None:
    given = {
        "types": np.array([1]),
        "columns": np.array([0]),
        "axes": np.array([[0.0, 0.0, 1.0]]),
        "rest_translations": np.zeros((1, 3)),
        "rest_rotations": np.array([[0.0, 0.0, 0.0, 1.0]]),
        "coordinates": np.zeros((3, 1)),
    }
    assert _kernels.coordinates_to_local(**given)[0].shape == (3, 1, 3)
    with pytest.raises(ValueError, match=rf"^{name}: "):
        _kernels.coordinates_to_local(**{**given, name: value})
