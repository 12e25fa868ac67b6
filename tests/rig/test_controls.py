from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.rig.controls import (
    Control,
    Drive,
    evaluate_controls,
    evaluation_order,
)
from animtool.rig.expressions import parse_expression
from animtool.rig.parts import DependencyCycleError


def drive(target: str, text: str, unit: float = 1.0) -> Drive:
    return Drive(target, parse_expression(text), (), unit)


def test_drives_are_summed() -> None:
    controls = [
        Control("a", drives=(drive("shape/s", "a"), drive("shape/s", "2 * b"))),
        Control("b", default=0.5, drives=(Drive("shape/s", None, ((0, 1), (1, 3))),)),
    ]
    found = evaluate_controls(controls, {"a": np.array([0.0, 1.0])})
    assert_allclose(found.targets["shape/s"], [3, 4])
    assert list(found.controls) == ["a", "b"]


CHAIN = [
    Control("a", default=1.0, drives=(drive("control/b", "a + 1"),)),
    Control("b", default=10.0, drives=(drive("control/c", "b * 2"),)),
    Control("c", drives=(drive("joint/x.angle", "c", 0.5),)),
]


@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
def test_order_by_dependency(order: tuple[int, ...]) -> None:
    controls = [CHAIN[i] for i in order]
    assert evaluation_order(controls) == ["a", "b", "c"]
    found = evaluate_controls(controls, {})
    assert {name: v.tolist() for name, v in found.controls.items()} == {
        "a": [1.0],
        "b": [12.0],
        "c": [24.0],
    }
    assert_allclose(found.targets["joint/x.angle"], [12])


def test_a_control_depends_on_what_its_drivers_read() -> None:
    controls = [
        Control("a", drives=(drive("control/b", "a + c"),)),
        Control("b"),
        Control("c", default=2.0, drives=(drive("shape/s", "b"),)),
    ]
    assert evaluation_order(controls)[-1] == "b"
    assert_allclose(evaluate_controls(controls, {}).targets["shape/s"], [2])


@pytest.mark.parametrize(
    ("drives", "cycle"),
    [({"a": "a"}, {"a"}), ({"a": "b", "b": "c", "c": "a", "d": "a"}, {"a", "b", "c"})],
)
def test_circles(drives: dict[str, str], cycle: set[str]) -> None:
    controls = [
        Control(name, drives=(drive(f"control/{to}", name),))
        for name, to in drives.items()
    ]
    with pytest.raises(DependencyCycleError) as caught:
        evaluation_order(controls)
    assert set(caught.value.cycle) == cycle
    assert caught.value.cycle[0] == caught.value.cycle[-1]
    assert str(caught.value) == " → ".join(caught.value.cycle)


def test_static_controls_stay_one_value() -> None:
    keyed = {"a": np.zeros(5)}
    controls = [
        Control("a", drives=(drive("shape/moves", "a"), drive("shape/stays", "1"))),
        Control("b", drives=(drive("shape/still", "b"),)),
    ]
    found = evaluate_controls(controls, keyed)
    assert found.controls["b"].shape == (1,)
    shapes = {name: values.shape for name, values in found.targets.items()}
    assert shapes == {"shape/moves": (5,), "shape/stays": (1,), "shape/still": (1,)}
    assert keyed["a"].tolist() == [0] * 5


def test_a_curve_is_held_at_its_ends() -> None:
    curve = Drive("shape/s", None, ((0, 1), (1, 2), (3, -2)), 10.0)
    controls = [Control("a", drives=(curve,))]
    found = evaluate_controls(controls, {"a": np.array([-5.0, 0.5, 2.0, 9.0])})
    assert_allclose(found.targets["shape/s"], [10, 15, 0, -20])
