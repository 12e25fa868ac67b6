"""Controls solved for from what they drive."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.rig.control_inverse import keys_of_controls, solve_controls
from animtool.rig.controls import Control, Drive, evaluate_controls
from animtool.rig.expressions import parse_expression

RAMP = np.linspace(0.05, 0.95, 7)


def drive(target: str, text: str) -> Drive:
    return Drive(target, parse_expression(text))


def solved(controls, values, **options):
    """Solve for what values drive; return the solution and what was wanted."""
    frames = len(next(iter(values.values())))
    wanted = {
        target: np.broadcast_to(value, (frames,))
        for target, value in evaluate_controls(controls, values).targets.items()
    }
    wanted |= options.pop("other", {})
    start = {c.name: np.full(frames, c.default) for c in controls}
    tolerances = dict.fromkeys(wanted, 1e-6)
    return solve_controls(controls, wanted, tolerances, start, **options)


@pytest.mark.parametrize(
    "drives",
    [
        (drive("joint/a.angle", "c * 3 + 1"),),
        (Drive("joint/a.angle", curve=((0, 0), (0.3, 5), (1, 6))),),
        (Drive("joint/a.angle", curve=((0, 4), (0.5, 1), (1, -6))),),
        (drive("shape/s", "clamp(c, 0, 1)"), drive("shape/t", "clamp(-c, 0, 1)")),
        (drive("joint/a.angle", "sin(c)"), drive("joint/b.slide", "c * c")),
        (Drive("shape/s", curve=((0, 0), (0.5, 0), (1, 1))), drive("shape/t", "c/2")),
    ],
)
def test_a_control_alone_is_exact(drives) -> None:
    control = Control("c", -1.0, 1.0, 0.0, drives)
    found = solved([control], {"c": RAMP})
    assert_allclose(found.values["c"], RAMP, atol=1e-10)
    assert found.solved_names == ("c",)
    assert not found.reset_names


def test_a_control_without_a_range_is_solved_for_far_off() -> None:
    found = solved(
        [Control("c", drives=(drive("joint/a.angle", "c / 9"),))], {"c": 70 * RAMP}
    )
    assert_allclose(found.values["c"], 70 * RAMP, atol=1e-9)


def test_controls_that_share_targets_are_solved_together() -> None:
    controls = [
        Control("a", 0, 1, 0, (drive("shape/s", "a"), drive("shape/t", "a * 2"))),
        Control("b", 0, 1, 0, (drive("shape/t", "b"), drive("shape/u", "b * a"))),
    ]
    values = {"a": RAMP, "b": RAMP[::-1]}
    found = solved(controls, values)
    for name, value in values.items():
        assert_allclose(found.values[name], value, atol=1e-9)


def test_values_stay_in_the_range() -> None:
    control = Control("c", 0.0, 0.5, 0.0, (drive("joint/a.angle", "c"),))
    found = solved([control], {"c": RAMP})
    assert found.reset_names == ("c",)
    assert not found.values["c"].any()


def test_a_control_whose_targets_disagree_is_released_alone() -> None:
    controls = [
        Control("a", -9, 9, 0, (drive("shape/s", "a"), drive("shape/t", "a"))),
        Control("b", -9, 9, 0, (drive("shape/t", "b"), drive("shape/u", "b"))),
    ]
    found = solved(controls, {"a": 0 * RAMP, "b": RAMP}, other={"shape/s": RAMP**2})
    assert found.reset_names == ("a",)
    assert_allclose(found.values["b"], RAMP, atol=1e-10)
    assert not found.values["a"].any()


def test_a_target_with_keys_of_its_own_is_no_evidence() -> None:
    control = Control("c", 0, 1, 0, (drive("joint/a.angle", "c"),))
    found = solved([control], {"c": RAMP}, keyed_targets={"joint/a.angle"})
    assert found.reset_names == ("c",)


def test_a_start_that_explains_all_is_left_as_it_is() -> None:
    both = (drive("control/l", "m"), drive("control/r", "m"))
    controls = [
        Control("m", 0, 1, 0, both),
        Control("l", 0, 1, 0, (drive("shape/s", "l"),)),
        Control("r", 0, 1, 0, (drive("shape/t", "r"),)),
    ]
    keyed = {"m": RAMP / 2, "l": RAMP / 3, "r": np.zeros(7)}
    driven = evaluate_controls(controls, keyed)
    start = keys_of_controls(controls, driven.controls)
    for name, value in keyed.items():
        assert_allclose(start[name], value, atol=1e-15)
    tolerances = dict.fromkeys(driven.targets, 1e-6)
    found = solve_controls(controls, driven.targets, tolerances, start)
    assert all((found.values[name] == start[name]).all() for name in start)


def test_whole_turns_of_one_angle_place_the_others() -> None:
    drives = (drive("joint/a.angle", "c"), drive("joint/b.angle", "-c"))
    control = Control("c", -20, 20, 0, drives)
    values = 8 + 3 * RAMP
    wanted = {"joint/a.angle": values, "joint/b.angle": 2 * np.pi - values}
    found = solve_controls(
        [control], wanted, dict.fromkeys(wanted, 1e-6), {"c": np.zeros(7)}
    )
    assert not found.reset_names
    assert_allclose(found.values["c"], values, atol=1e-9)


def test_where_an_expression_has_no_value_nothing_is_solved() -> None:
    control = Control("c", 0, 1, 0, (drive("joint/a.angle", "1 / (c - c)"),))
    found = solve_controls(
        [control], {"joint/a.angle": RAMP}, {"joint/a.angle": 1e-6}, {"c": 0 * RAMP}
    )
    assert found.reset_names == ("c",)
    assert np.isfinite(found.values["c"]).all()


def test_rounding_moves_no_control_that_is_still() -> None:
    controls = [
        Control("a", -9, 9, 0, (drive("shape/s", "a"), drive("shape/t", "a"))),
        Control("b", -9, 9, 0, (drive("shape/t", "b"), drive("shape/u", "b"))),
    ]
    rounded = RAMP.astype(np.float32).astype(float)
    wanted = {"shape/s": RAMP, "shape/t": rounded, "shape/u": 0 * RAMP}
    start = {"a": 0 * RAMP, "b": 0 * RAMP}
    found = solve_controls(controls, wanted, dict.fromkeys(wanted, 1e-6), start)
    assert not found.values["b"].any()
    assert_allclose(found.values["a"], RAMP, atol=1e-6)
    assert not found.reset_names
