"""Compiles joint drivers to kernel programs with derivatives."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import field

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.ik.goals import Goal, path_to_root
from animtool.ik.sub_rig import leader_of
from animtool.rig.controls import Control
from animtool.rig.driver_plan import DriverPlan, plan_of
from animtool.rig.drivers import (
    ANGLE,
    SLIDE,
    SWING,
    SWING_PARTS,
    TWIST,
    Driver,
    smooth_slopes,
    split_coordinate,
)
from animtool.rig.driving import REVOLUTION_TOLERANCE, ball_part_values
from animtool.rig.joints import coordinate_slices
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Joint, JointType, Mimic, Rig

# Node kind of the instructions of programs.
INSTRUCTION = 3
# Driver kinds of a node: its own coordinate, that of a leader, or a program's result.
UNDRIVEN, FOLLOWS_LEADER, FOLLOWS_PROGRAM = 0, 1, 2
# Operations, in the kernel's order.
_OPERATIONS = (
    *("number", "coordinate", "ball", "result", "point", "curve"),
    *("+", "-", "*", "/", "neg", "abs", "atan2", "ceil", "clamp", "cos", "exp"),
    *("floor", "lerp", "log", "max", "min", "pow", "sign", "sin", "smoothstep"),
    *("sqrt", "tan"),
)
_OPERATION_NUMBER_BY_NAME = {name: i for i, name in enumerate(_OPERATIONS)}

# An operation, its reference (counted from 1), and its numbers.
_Instruction = tuple[str, int, tuple[float, ...]]


def with_driver_sources(
    rig: Rig,
    joints_of_goals: set[int],
    goals: Sequence[Goal],
    joints: Collection[str] | None,
) -> set[int]:
    """Return the moving joints, including joints that drive a driven joint.

    A driven joint moves if one of its sources may move, whether it is named or not.
    """
    plan, moving_joints = plan_of(rig), set(joints_of_goals)
    # Mimic joints that move take their leaders along.
    leaders = {leader_of(rig, j)[0] for j in joints_of_goals}
    joints_above_goals = {
        j for goal in goals for j in path_to_root(rig, goal.joint, goal.root)
    }
    for j in sorted(joints_above_goals.intersection(plan.joints)):
        if joints is None and j not in joints_of_goals:
            # It moves no goal.
            continue
        movable_sources = {
            source
            for source in plan.sources_of(j)
            if (joints is None or rig.names[source] in joints or source in leaders)
            and rig.joints[source].type is not JointType.FIXED
        }
        moving_joints.discard(j)
        moving_joints |= movable_sources | {j} if movable_sources else set()
    return moving_joints


@dataclass(frozen=True, slots=True)
class CoordinateSource:
    """Column of a joint's coordinate in the chain, with a mimic's gain and shift."""

    column: int  # first column in the chain's coordinates
    gain: float = 1.0  # gain of a mimic joint
    shift: float = 0.0


@dataclass(slots=True)
class DriverPrograms:
    """The programs of a rig's driven joints, and of the controls that these read.

    Attributes:
        rig: A rig with drivers.
        pose: Coordinates ``(Q,)`` of static joints.
        requested_programs: Targets whose programs the chain uses, in order.
    """

    rig: Rig
    pose: FloatArray
    requested_programs: dict[str, int] = field(default_factory=dict)
    # Index of each program by target, in evaluation order.
    _program_index_by_target: dict[str, int] = field(default_factory=dict, init=False)
    # Chain coordinates by joint, and the divisor of each coordinate.
    _source_by_joint: Mapping[int, CoordinateSource] = field(
        default_factory=dict, init=False
    )
    _coordinate_scales: FloatArray = field(
        default_factory=lambda: np.zeros(0), init=False
    )

    @property
    def plan(self) -> DriverPlan:
        """Evaluation order of the rig's drivers."""
        return plan_of(self.rig)

    def request_program(self, joint: int) -> int:
        """Request a driven joint's program; return its index."""
        target = f"joint/{self.rig.names[joint]}"
        return self.requested_programs.setdefault(target, len(self.requested_programs))

    def arrays(
        self, source_by_joint: Mapping[int, CoordinateSource], scales: FloatArray
    ) -> tuple[list[int], list[list[int]], list[list[float]]]:
        """Return the indices of the requested programs, and the arrays of all programs.

        They have a row for each instruction: nodes ``(., 4)`` and numbers ``(., 6)``.

        Args:
            source_by_joint: Chain coordinates by joint.
            scales: Divisor of each chain coordinate.
        """
        self._source_by_joint, self._coordinate_scales = source_by_joint, scales
        needed_targets = set(self.requested_programs)
        for target in reversed(self.plan.order):
            if target in needed_targets:
                needed_targets.update(self._targets_read_by(target))
        order = [target for target in self.plan.order if target in needed_targets]
        self._program_index_by_target = {target: i for i, target in enumerate(order)}
        nodes: list[list[int]] = []
        instruction_numbers: list[list[float]] = []
        for target, program_index in self._program_index_by_target.items():
            for operation_name, reference, values in self._target_program(target):
                # The reference is counted from 1: 0 marks joint rows.
                operation = _OPERATION_NUMBER_BY_NAME[operation_name]
                nodes.append([INSTRUCTION, program_index, operation, reference + 1])
                instruction_numbers.append([*values, *[0.0] * (6 - len(values))])
        return (
            [
                self._program_index_by_target[target]
                for target in self.requested_programs
            ],
            nodes,
            instruction_numbers,
        )

    def _targets_read_by(self, target: str) -> list[str]:
        """Return the joints and controls whose values a target's program reads."""
        kind, _, name = target.partition("/")
        source_names: list[str] = []
        if kind == "joint":
            driver = self.plan.driver_of(self.rig.index(name))
            if isinstance(driver, Mimic):
                return [f"joint/{driver.joint}"]
            source_names += driver.names
        else:
            control = self._control_of(name)
            if control.driven is not None:
                source_names += control.driven.names
            else:
                source_names += [
                    source for drive in self._drives_of(name) for source in drive.names
                ]
        return [
            f"joint/{joint}"
            if (joint := split_coordinate(source)[0])
            else f"control/{source}"
            for source in source_names
        ]

    def _control_of(self, name: str) -> Control:
        """Return a control of the rig by its name."""
        return next(control for control in self.rig.controls if control.name == name)

    def _drives_of(self, control: str) -> list[Driver]:
        """Return the drives that other controls add to a control."""
        return [
            Driver(drive.expression, master.name, drive.curve, drive.is_smooth)
            for master in self.rig.controls
            for drive in master.drives
            if drive.target == f"control/{control}"
        ]

    def _target_program(self, target: str) -> list[_Instruction]:
        """Return the program that computes a target: a control or a driven joint."""
        kind, _, name = target.partition("/")
        if kind == "control":
            control = self._control_of(name)
            if control.driven is not None:
                return self._driver_program(control.driven)
            program: list[_Instruction] = [("number", 0, (control.default,))]
            for drive in self._drives_of(name):
                program += [*self._driver_program(drive), ("+", 0, ())]
            return program
        joint_index = self.rig.index(name)
        driver, joint = self.plan.driver_of(joint_index), self.rig.joints[joint_index]
        if isinstance(driver, Mimic):
            leader = self.rig.joints[self.rig.index(driver.joint)]
            part = SLIDE if leader.type is JointType.PRISMATIC else ANGLE
            program = self._source_program(f"{leader.name}.{part}")
            program += [*_multiply(driver.gain), *_add(driver.offset)]
        else:
            program = self._driver_program(driver)
        if isinstance(joint.limits, RangeLimit):
            limits = (joint.limits.low, joint.limits.high)
            program += [("number", 0, (limit,)) for limit in limits]
            program.append(("clamp", 0, ()))
        return program

    def _driver_program(self, driver: Driver) -> list[_Instruction]:
        """Return the program that evaluates a driver's expression or curve."""
        program: list[_Instruction] = []
        if driver.expression is None:
            program += self._input_program(driver, driver.curve_input)
            slopes = [0.0] * len(driver.curve)
            if driver.is_smooth and len(driver.curve) > 1:
                slopes = smooth_slopes(driver.curve).tolist()
            program += [
                ("point", 0, (x, y, slope))
                for (x, y), slope in zip(driver.curve, slopes, strict=True)
            ]
            program.append(("curve", len(driver.curve), (float(driver.is_smooth),)))
        else:
            for kind, value in driver.expression.postfix_program():
                if kind == "name":
                    program += self._input_program(driver, str(value))
                elif kind == "number":
                    program.append(("number", 0, (float(value),)))
                else:
                    program.append((str(value), 0, ()))
        return program + _multiply(driver.unit)

    def _input_program(self, driver: Driver, name: str) -> list[_Instruction]:
        """Return the program that reads a driver's input in its unit."""
        program = self._source_program(name)
        return program + _multiply(1.0 / driver.unit_of(name))

    def _source_program(self, name: str) -> list[_Instruction]:
        """Return the program that reads a control or a joint coordinate."""
        joint_name, part = split_coordinate(name)
        target = f"joint/{joint_name}" if joint_name else f"control/{name}"
        if target in self._program_index_by_target:
            return [("result", self._program_index_by_target[target] + 1, (1.0,))]
        if not joint_name:
            return [("number", 0, (self._control_of(name).default,))]
        joint_index = self.rig.index(joint_name)
        joint = self.rig.joints[joint_index]
        if joint_index not in self._source_by_joint:
            return [("number", 0, (self._static_coordinate(joint_index, part),))]
        source = self._source_by_joint[joint_index]
        column = source.column
        if joint.type is JointType.BALL:
            return [("ball", column + 1, _swing_twist_weights(joint, part))]
        program: list[_Instruction] = [
            ("coordinate", column + 1, (float(self._coordinate_scales[column]),))
        ]
        return [*program, *_multiply(source.gain), *_add(source.shift)]

    def _static_coordinate(self, joint_index: int, part: str) -> float:
        """Return the value of a static joint's coordinate [rad], [m]."""
        coordinates = self.pose[coordinate_slices(self.rig)[joint_index]][None]
        joint = self.rig.joints[joint_index]
        if joint.type is JointType.BALL:
            return float(ball_part_values(joint, part, coordinates)[0])
        return float(coordinates[0, 0])


def _multiply(factor: float) -> list[_Instruction]:
    """Return the instructions that multiply by a factor; none for 1."""
    return [] if factor == 1.0 else [("number", 0, (factor,)), ("*", 0, ())]


def _add(term: float) -> list[_Instruction]:
    """Return the instructions that add a term; none for 0."""
    return [] if term == 0.0 else [("number", 0, (term,)), ("+", 0, ())]


def _swing_twist_weights(joint: Joint, part: str) -> tuple[float, ...]:
    """Return weights of twist, two swings and swing angle, and the centre of twist."""
    limits = joint.limits
    assert isinstance(limits, BallLimit)
    low, high = limits.twist or (-np.inf, np.inf)
    twist_centre = (
        (low + high) / 2 if high - low < 2 * np.pi - REVOLUTION_TOLERANCE else 0.0
    )
    if part in (TWIST, SWING):
        return (float(part == TWIST), 0.0, 0.0, float(part == SWING), twist_centre)
    first_axis, second_axis = limits.axes[1:, SWING_PARTS.index(part)].tolist()
    return (0.0, first_axis, second_axis, 0.0, twist_centre)
