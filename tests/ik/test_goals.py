"""Targets that do not fit their goals."""

from __future__ import annotations

import numpy as np
import pytest
from support.faults import raises

from animtool.core.errors import OptionError
from animtool.ik import Goal, Targets
from animtool.ik.goals import GOAL_KINDS, WEIGHT_COLUMNS, GoalKind, pack

GOALS = (Goal("a", orientation=1.0), Goal("b", position=0.0, aim=1.0))


def test_what_is_asked_for_must_be_there() -> None:
    with pytest.raises(OptionError) as caught:
        pack(Targets(), GOALS)
    assert [fault.code for fault in caught.value.faults] == ["IK010"] * 3


def test_shapes_and_counts_must_agree() -> None:
    targets = Targets(np.zeros((2, 2, 3)), np.ones((3, 2, 4)), np.zeros((2, 3)))
    with pytest.raises(OptionError) as caught:
        pack(targets, GOALS)
    assert [fault.code for fault in caught.value.faults] == ["IK010"] * 2


@pytest.mark.parametrize(
    ("part", "value"), [(0, np.nan), (0, np.inf), (1, np.nan), (1, 0.0), (2, np.nan)]
)
def test_numbers_must_be_finite_and_rotations_not_zero(part: int, value: float) -> None:
    parts = [np.zeros((1, 2, 3)), np.ones((1, 2, 4)), np.zeros((1, 2, 3))]
    parts[part][:] = value
    with pytest.raises(OptionError) as caught:
        pack(Targets(*parts), GOALS)
    assert [fault.code for fault in caught.value.faults] == ["TGT007"]


def test_what_is_not_asked_for_may_be_anything() -> None:
    positions = np.array([[[1.0, 2.0, 3.0], [np.nan] * 3]])
    packed = pack(Targets(positions, np.ones((1, 2, 4)), np.zeros((1, 2, 3))), GOALS)
    assert np.isfinite(packed).all()


def test_directions_count_however_far_a_point_is() -> None:
    far = np.array([[[0.0, 0.0, 0.0], [3e300, 4e300, 0.0]]])
    turn = np.full((1, 2, 4), 1e300)
    packed = pack(Targets(far, turn, far), GOALS)
    aim, rotation = packed[0, 1, 7:10], packed[0, 0, 3:7]
    np.testing.assert_allclose(aim / np.linalg.norm(aim), [0.6, 0.8, 0.0])
    np.testing.assert_allclose(rotation / np.linalg.norm(rotation), 0.5)
    np.testing.assert_array_equal(packed[0, :, :3], far[0])


def test_weights_must_fit_the_goals_and_be_numbers_from_zero() -> None:
    parts = [np.zeros((2, 2, 3)), np.ones((2, 2, 4)), np.zeros((2, 2, 3)), None]
    for weights, code in [
        (np.ones((2, 2)), "IK010"),
        (np.ones((3, 2, len(GOAL_KINDS))), "IK010"),
        (np.full((2, 2, len(GOAL_KINDS)), -1.0), "TGT007"),
        (np.full((2, 2, len(GOAL_KINDS)), np.nan), "TGT007"),
    ]:
        with pytest.raises(OptionError) as caught:
            pack(Targets(*parts, weights), GOALS)
        assert caught.value.code == code


def test_a_target_may_be_anything_in_the_frames_that_do_not_ask_for_it() -> None:
    positions = np.zeros((2, 2, 3))
    positions[1] = np.nan
    rotations = np.ones((2, 2, 4))
    rotations[1] = 0.0
    aims, weights = np.zeros((2, 2, 3)), np.ones((2, 2, len(GOAL_KINDS)))
    weights[1, :, :2] = 0.0
    packed = pack(Targets(positions, rotations, aims, None, weights), GOALS)
    assert np.isfinite(packed).all()
    np.testing.assert_array_equal(packed[..., WEIGHT_COLUMNS], weights)
    weights[1, 0, 0] = 0.5
    with pytest.raises(OptionError) as caught:
        pack(Targets(positions, rotations, aims, None, weights), GOALS)
    assert caught.value.code == "TGT007"


@pytest.mark.parametrize("values", ["abc", [[[0, 1, 2]], [[0, 1]]], [[[0, 1, "x"]]]])
def test_targets_that_are_no_numbers_are_refused_by_name(values: object) -> None:
    with raises(OptionError, "IK010"):
        pack(Targets(positions=values), (Goal("a"),))  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", GOAL_KINDS, ids=lambda kind: str(kind.name))
def test_a_target_in_the_place_of_a_weight_is_refused(kind: GoalKind) -> None:
    target = [0.0] * kind.value_type.value
    with pytest.raises(OptionError) as caught:
        Goal("head", **{kind.name: target})  # type: ignore[arg-type]
    (fault,) = caught.value.faults
    assert fault.code == "TGT007"
    assert f"Targets({kind.targets_field}=" in (fault.hint or "")
    assert Goal("head", **{kind.name: np.float32(2)}).weights.count(2.0) == 1  # type: ignore[arg-type]
