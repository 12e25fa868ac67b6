"""Converts joint equalities: linear ones to mimic joints, nonlinear ones to drivers."""

from __future__ import annotations

from dataclasses import field
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import cycle_text, excerpt
from animtool.core.record import dataclass
from animtool.formats.robots.diagnostics import XmlDiagnostics
from animtool.rig.drivers import ANGLE, SLIDE, Driver, split_coordinate
from animtool.rig.expressions import parse_expression
from animtool.rig.skeleton import Mimic

# Rounding of limits and coefficients in a file [rad], [m].
LIMIT_TOLERANCE = 1e-6
# Values of a leader at which a polynomial is compared with limits.
LEADER_VALUES = 181
_JOINT_EQUALITY = 2
_SLIDE_JOINT = 2


@dataclass(slots=True, eq=False)
class JointEqualities:
    """Mimics and drivers of the joints that equalities constrain, by joint index."""

    mimics: dict[int, Mimic] = field(default_factory=dict)
    drivers: dict[int, Driver] = field(default_factory=dict)

    @staticmethod
    def from_model(model: Any, diagnostics: XmlDiagnostics) -> JointEqualities:
        """Return the active equalities of a model; record unsupported ones."""
        # Leader and polynomial of each constrained joint.
        constraints: dict[int, tuple[int, list[float]]] = {}
        for constraint in range(model.neq):
            if model.eq_type[constraint] != _JOINT_EQUALITY:
                continue
            if not model.eq_active0[constraint]:
                diagnostics.record_ignored(["equality that is not active"])
                continue
            follower = int(model.eq_obj1id[constraint])
            leader = int(model.eq_obj2id[constraint])
            name = model.joint(follower).name
            if follower in constraints:
                message = f"joint {excerpt(name)} is tied to two others by equality"
                hint = "keep the one that moves it"
                diagnostics.add("MJC010", None, message, hint, joint=name)
                continue
            constraints[follower] = (
                leader,
                np.array(model.eq_data[constraint][:5]).tolist(),
            )
        equalities = JointEqualities()
        if not _has_cycles(model, constraints, diagnostics):
            for follower in constraints:
                equalities._add_constraint(model, follower, constraints)
        return equalities

    def joints_beyond_limits(self, model: Any) -> list[int]:
        """Return the limited joints that equalities may move beyond their limits.

        Joints that follow an unlimited joint are only reported if no value of that has
        all of them within limits; those that follow it nonlinearly are not.
        """
        beyond = []
        leader_ranges: dict[int, tuple[float, float]] = {}
        for follower in np.flatnonzero(model.jnt_limited).tolist():
            low, high = np.array(model.jnt_range[follower]).tolist()
            driver, mimic = self.drivers.get(follower), self.mimics.get(follower)
            reachable_values = []
            if driver is not None:
                reachable_values = _driver_values(model, driver)
            elif mimic is not None and (leader := model.joint(mimic.joint)).limited[0]:
                reachable_values = [
                    mimic.gain * end + mimic.offset for end in leader.range
                ]
            elif mimic is not None and mimic.gain:
                ends = sorted((end - mimic.offset) / mimic.gain for end in (low, high))
                start, stop = leader_ranges.get(leader.id, (-np.inf, np.inf))
                leader_ranges[leader.id] = max(start, ends[0]), min(stop, ends[1])
                if np.subtract(*leader_ranges[leader.id]) > LIMIT_TOLERANCE:
                    beyond.append(follower)
            is_inside = [low - LIMIT_TOLERANCE <= v <= high + LIMIT_TOLERANCE
                         for v in reachable_values]  # fmt: skip
            if not all(is_inside):
                beyond.append(follower)
        return beyond

    def _add_constraint(
        self, model: Any, follower: int, constraints: dict[int, tuple[int, list[float]]]
    ) -> None:
        """Add a mimic or driver for a joint that follows another one or a constant."""
        leader, polynomial = constraints[follower]
        offset, gain = _linear_part(model, follower, leader, polynomial)
        is_nonlinear = leader >= 0 and any(polynomial[2:])
        while not is_nonlinear and leader in constraints:
            outer_leader, leader_polynomial = constraints[leader]
            if outer_leader < 0 or any(leader_polynomial[2:]):
                break
            leader_offset, leader_gain = _linear_part(
                model, leader, outer_leader, leader_polynomial
            )
            offset, gain = offset + gain * leader_offset, gain * leader_gain
            leader = outer_leader
        if leader < 0:
            text = repr(offset)
            self.drivers[follower] = Driver(
                parse_expression(text, allows_coordinates=True)
            )
        elif is_nonlinear:
            self.drivers[follower] = _polynomial_driver(
                model, follower, leader, polynomial
            )
        elif leader in constraints:
            # Linear in a joint that itself has a driver.
            polynomial = [polynomial[0], polynomial[1], 0.0, 0.0, 0.0]
            self.drivers[follower] = _polynomial_driver(
                model, follower, constraints[follower][0], polynomial
            )
        else:
            self.mimics[follower] = Mimic(model.joint(leader).name, gain, offset)


def _reference_value(model: Any, joint: int) -> float:
    return float(model.qpos0[model.jnt_qposadr[joint]])


def _linear_part(
    model: Any, follower: int, leader: int, polynomial: list[float]
) -> tuple[float, float]:
    """Return offset and gain of the linear part for coordinates from 0, not ``ref``."""
    offset = _reference_value(model, follower) + polynomial[0]
    if leader < 0:
        return offset, 0.0
    return offset - polynomial[1] * _reference_value(model, leader), polynomial[1]


def _driver_values(model: Any, driver: Driver) -> list[float]:
    """Return values of a driver over the range of its joint; none if it has no limits.

    One value is that of a constant.
    """
    values: dict[str, FloatArray] = {}
    for name in driver.names:
        leader = model.joint(split_coordinate(name)[0])
        if not leader.limited[0]:
            return []
        low, high = leader.range.tolist()
        values[name] = np.linspace(low, high, LEADER_VALUES)
    return [float(value) for value in driver.evaluate(values)]


def _polynomial_driver(
    model: Any, follower: int, leader: int, polynomial: list[float]
) -> Driver:
    """Return a polynomial as a driver, by Horner's scheme."""
    component = SLIDE if model.jnt_type[leader] == _SLIDE_JOINT else ANGLE
    leader_value = repr(f"{model.joint(leader).name}.{component}")
    leader_offset = f"({leader_value} - {_reference_value(model, leader)!r})"
    coefficients = polynomial
    while coefficients[-1] == 0.0 and len(coefficients) > 1:
        coefficients = coefficients[:-1]
    text = repr(coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        text = f"({coefficient!r} + {leader_offset} * {text})"
    text = f"{_reference_value(model, follower)!r} + {text}"
    return Driver(parse_expression(text, allows_coordinates=True))


def _has_cycles(
    model: Any,
    constraints: dict[int, tuple[int, list[float]]],
    diagnostics: XmlDiagnostics,
) -> bool:
    """Record cycles of constrained joints; return whether there are any."""
    checked_joints: set[int] = set()
    has_cycles = False
    for first_joint in constraints:
        path: list[int] = []
        joint = first_joint
        while joint in constraints and joint not in checked_joints:
            if joint in path:
                names = [model.joint(j).name for j in path[path.index(joint) :]]
                message = f"joints are tied in a ring: {cycle_text([*names, names[0]])}"
                hint = "remove one of these equalities"
                diagnostics.add("MJC010", None, message, hint, joint=names[0])
                has_cycles = True
                break
            path.append(joint)
            joint = constraints[joint][0]
        checked_joints.update(path)
    return has_cycles
