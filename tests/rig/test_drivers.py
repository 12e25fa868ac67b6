"""Drivers: their curves, and what they come to on coordinates."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from animtool.core.errors import OptionError
from animtool.maths import so3
from animtool.rig.controls import Control, Drive
from animtool.rig.driver_plan import (
    coordinate_fault,
    evaluation_order_of_drivers,
    plan_of,
    readable_parts,
)
from animtool.rig.drivers import Driver, curve_values, split_coordinate
from animtool.rig.driving import (
    ball_part_values,
    driven_coordinates,
    evaluate_drivers,
)
from animtool.rig.expressions import parse_expression
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.parts import Shape
from animtool.rig.skeleton import Joint, JointType, Mimic, Rig

X = (1.0, 0.0, 0.0)


def expr(text: str, unit: float = 1.0, angle: float = 1.0) -> Driver:
    return Driver(
        parse_expression(text, allows_coordinates=True), unit=unit, angle_unit=angle
    )


def test_a_smooth_curve_has_a_continuous_slope_and_never_overshoots() -> None:
    points = ((0.0, 0.0), (1.0, 0.0), (2.0, 9.0), (3.0, 10.0), (7.0, 4.0))
    x = np.linspace(-1, 8, 90001)
    values = curve_values(points, x, is_smooth=True)
    corners = np.array(points)
    assert (
        np.abs(
            curve_values(points, corners[:, 0], is_smooth=True) - corners[:, 1]
        ).max()
        < 1e-12
    )
    for (a, low), (b, high) in pairwise(points):
        inside = values[(x >= a) & (x <= b)]
        assert inside.min() >= min(low, high) - 1e-12
        assert inside.max() <= max(low, high) + 1e-12
        assert (np.diff(inside) * np.sign(high - low) >= -1e-12).all()
    slopes = np.diff(values) / np.diff(x)
    assert np.abs(np.diff(slopes)).max() < 0.01
    assert slopes[0] == slopes[-1] == 0
    # Not so along straight lines.
    straight = np.diff(curve_values(points, x)) / np.diff(x)
    assert np.abs(np.diff(straight)).max() > 1


def test_curves_are_held_at_their_ends_and_keep_what_is_no_number() -> None:
    points = ((0.0, 1.0), (1.0, 2.0))
    for smooth in (False, True):
        x = np.array([-np.inf, -5.0, 1.0, np.inf, np.nan])
        found = curve_values(points, x, is_smooth=smooth)
        assert found[:4].tolist() == [1, 1, 2, 2]
        assert np.isnan(found[4])
    assert curve_values(((2.0, 3.0),), np.array([0.0]), is_smooth=True).tolist() == [3]


def test_a_control_drives_along_a_smooth_curve() -> None:
    drive = Drive("shape/a", None, ((0.0, 0.0), (1.0, 1.0)), 1.0, is_smooth=True)
    values = {"c": np.array([0.25])}
    assert drive.evaluate("c", values)[0] == pytest.approx(0.15625)


def arm(**roll: object) -> Rig:
    limits = BallLimit(None, (-2.0, 2.0), X)
    return Rig(
        "arm",
        (
            Joint("elbow", -1, JointType.PIN, limits=RangeLimit(0.0, 2.5)),
            Joint("roll", 0, JointType.PIN, axis=X, **roll),  # type: ignore[arg-type]
            Joint("wrist", 0, JointType.BALL, limits=limits),
            Joint("end", 2, JointType.FIXED),
        ),
    )


def test_a_roll_takes_half_of_the_twist_whatever_the_sign_of_quaternions() -> None:
    rig = arm(driven=expr("wrist.twist / 2"))
    turn = so3.multiply(
        so3.from_axis_angle((0, 1, 0), np.array([0.7, 0.7])),
        so3.from_axis_angle(X, np.array([1.1, 1.1])),
    )
    turn[1] *= -1
    q = np.zeros((2, 6))
    q[:, 2:] = turn
    assert driven_coordinates(plan_of(rig), q)[:, 1].tolist() == pytest.approx(
        [0.55] * 2
    )


def test_the_parts_of_a_ball() -> None:
    ball = Joint("b", -1, JointType.BALL, limits=BallLimit(None, (0.0, 5.0), X))
    swing = so3.exp(np.array([[0.0, 0.3, -0.4]]))
    turn = so3.multiply(swing, so3.from_axis_angle(X, np.array([4.0])))
    assert ball_part_values(ball, "twist", turn)[0] == pytest.approx(4.0)
    assert ball_part_values(ball, "swing", turn)[0] == pytest.approx(0.5)
    assert ball_part_values(ball, "swing_y", turn)[0] == pytest.approx(0.3)
    assert ball_part_values(ball, "swing_z", turn)[0] == pytest.approx(-0.4)
    # Within half a turn of 0 without limits; open at a swing of half a turn.
    free = Joint("b", -1, JointType.BALL, limits=BallLimit(twist_axis=X))
    assert ball_part_values(free, "twist", turn)[0] == pytest.approx(4.0 - 2 * np.pi)
    half = np.array([[0.0, 1.0, 0.0, 0.0]])
    assert ball_part_values(free, "twist", half)[0] == 0
    assert ball_part_values(free, "swing", half)[0] == pytest.approx(np.pi)


@pytest.mark.parametrize(
    ("kind", "limits", "parts"),
    [
        (JointType.PIN, None, ["angle"]),
        (JointType.PRISMATIC, None, ["slide"]),
        (JointType.FIXED, None, []),
        (JointType.FREE, None, []),
        (JointType.BALL, None, []),
        (
            JointType.BALL,
            BallLimit(twist_axis=X),
            ["twist", "swing", "swing_y", "swing_z"],
        ),
        (JointType.BALL, BallLimit(twist=(0.0, 0.0)), ["swing", "swing_x", "swing_z"]),
    ],
)
def test_what_drivers_read(
    kind: JointType, limits: BallLimit | None, parts: list[str]
) -> None:
    assert readable_parts(Joint("j", -1, kind, limits=limits)) == parts


@pytest.mark.parametrize(
    ("name", "code", "hint"),
    [
        ("elbw.angle", "RIG008", "elbow"),
        ("elbow.slide", "RIG033", "angle"),
        ("wrist.twst", "RIG033", "twist"),
        ("wrist.swing_x", "RIG033", "swing_y"),
        ("end.angle", "RIG033", "pin"),
        ("elbow", "RIG012", "elbow.angle"),
        ("grp", "RIG012", "grip"),
        ("bulge", "RIG012", "read the input of the shape's driver instead"),
    ],
)
def test_what_cannot_be_read(name: str, code: str, hint: str) -> None:
    limits = BallLimit(twist_axis=X)
    rig = Rig(
        "arm",
        (
            Joint("elbow", -1, JointType.PIN),
            Joint("wrist", 0, JointType.BALL, limits=limits),
            Joint("end", 0, JointType.FIXED),
        ),
        shapes=(Shape("bulge"),),
        controls=(Control("grip"),),
    )
    fault = coordinate_fault(rig, name)
    assert fault is not None
    assert fault.code == code
    assert hint in str(fault.hint)


def test_drivers_run_in_the_order_that_they_read_each_other() -> None:
    joints = (
        Joint("c", -1, JointType.PIN, driven=expr("b.angle + 1")),
        Joint("b", -1, JointType.PIN, driven=expr("a.angle * 2")),
        Joint("a", -1, JointType.PIN),
        Joint("m", -1, JointType.PIN, mimic=Mimic("c", 10.0)),
    )
    rig = Rig("row", joints)
    assert evaluation_order_of_drivers(rig) == ["joint/b", "joint/c", "joint/m"]
    assert driven_coordinates(plan_of(rig), np.array([[0.0, 0, 3, 0]])).tolist() == [
        [7, 6, 3, 70]
    ]
    assert plan_of(rig).sources_of(3) == [2]
    assert plan_of(rig).dependent_joints(["a"]) == ["c", "b", "m"]


def test_a_circle_has_its_code() -> None:
    joints = (
        Joint("a", -1, JointType.PIN, driven=expr("b.angle")),
        Joint("b", -1, JointType.PIN, mimic=Mimic("a")),
    )
    with pytest.raises(OptionError) as caught:
        plan_of(Rig("ring", joints))
    assert [fault.code for fault in caught.value.faults] == ["RIG032"]
    assert "a → b → a" in caught.value.faults[0].message


def test_limits_of_a_driven_joint_hold_before_it_drives_others() -> None:
    joints = (
        Joint("a", -1, JointType.PIN),
        Joint(
            "b", -1, JointType.PIN, limits=RangeLimit(0, 1), driven=expr("a.angle * 3")
        ),
        Joint("c", -1, JointType.PIN, driven=expr("b.angle")),
    )
    plan = plan_of(Rig("row", joints))
    done = evaluate_drivers(plan, lambda _: np.array([0.2, 1.0]), {})
    assert done.joints[1].tolist() == pytest.approx([0.6, 1.0])
    assert done.excess[1].tolist() == pytest.approx([0.0, 2.0])
    assert done.joints[2].tolist() == pytest.approx([0.6, 1.0])


def test_driven_controls_drive_shapes_and_controls() -> None:
    bend = Control(
        "bend",
        drives=(
            Drive("control/more", parse_expression("bend * 2")),
            Drive("shape/a", parse_expression("bend")),
        ),
        driven=expr("elbow.angle"),
    )
    more = Control(
        "more", default=0.5, drives=(Drive("shape/b", parse_expression("more")),)
    )
    rig = Rig(
        "arm",
        (Joint("elbow", -1, JointType.PIN),),
        shapes=(Shape("a"), Shape("b"), Shape("c", combine=("a", "b")), Shape("d")),
        controls=(more, bend),
    )
    plan = plan_of(rig)
    assert (plan.controls, plan.shapes) == (("bend", "more"), ("a", "b"))
    assert plan.combination_shapes == ("c",)
    done = evaluate_drivers(plan, lambda _: np.array([0.25]), {"more": np.array([9.0])})
    assert done.controls["more"].tolist() == [1.0]
    assert done.shapes["b"].tolist() == [1.0]


def test_the_other_side_reads_the_other_side() -> None:
    names = {"wrist_l": "wrist_r"}
    twist = expr("wrist_l.twist + wrist_l.swing_x").mirrored(names)
    assert twist.names == ("wrist_r.swing_x", "wrist_r.twist")
    up = expr("wrist_l.swing_y + 1").mirrored(names)
    assert up.evaluate({"wrist_r.swing_y": np.array([0.5])}).tolist() == [0.5]
    curve = Driver(None, "wrist_l.swing_z", ((0.0, 0.0), (1.0, 5.0))).mirrored(names)
    assert (curve.curve_input, curve.curve) == (
        "wrist_r.swing_z",
        ((-1.0, 5.0), (0.0, 0.0)),
    )


def test_names_with_dots_and_without() -> None:
    assert split_coordinate("a.b.angle") == ("a.b", "angle")
    assert split_coordinate("grip") == ("", "")
    quoted = expr("'rig:elbow-1.angle' / 2")
    assert quoted.names == ("rig:elbow-1.angle",)
