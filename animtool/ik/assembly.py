"""Builds the kinematic chain of the moving joints from a rig, goals and a pose."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.ik.chain import BALL, PIN, REVOLUTION_TOLERANCE, SLIDE, Chain
from animtool.ik.driver_programs import (
    FOLLOWS_LEADER,
    FOLLOWS_PROGRAM,
    UNDRIVEN,
    CoordinateSource,
    DriverPrograms,
)
from animtool.ik.goals import Goal
from animtool.ik.limbs import limb_joints
from animtool.ik.sub_rig import UNLIMITED, coordinate_ranges, leader_of
from animtool.maths import so3
from animtool.rig.driver_plan import plan_of
from animtool.rig.joints import (
    LocalTransforms,
    coordinate_slices,
    local_from_coordinates,
)
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.limits import BallLimit
from animtool.rig.skeleton import Joint, JointType, Rig


@dataclass
class _Frame:
    """Transform of a joint's frame relative to a node of the chain [m]."""

    node: int
    translation: FloatArray
    rotation: FloatArray

    def transform(self, translation: FloatArray, rotation: FloatArray) -> _Frame:
        """Return a child's frame, transformed from this frame to the parent node."""
        position = self.translation + so3.rotate(self.rotation, translation)
        return _Frame(self.node, position, so3.multiply(self.rotation, rotation))


class _ChainBuilder:
    """Builds a chain joint by joint: its nodes, coordinates and limits."""

    def __init__(self, rig: Rig, pose: FloatArray) -> None:
        self.rig = rig
        self.slices = coordinate_slices(rig)
        self.ranges = coordinate_ranges(rig)
        self.followed_joints, self.geared_joints = _followed_joints(rig)
        self.nodes: list[list[int]] = []
        self.rest_matrices: list[FloatArray] = []
        self.offsets: list[FloatArray] = []
        self.gains: list[tuple[float, float]] = []
        self.limits: list[tuple[float, float, float, float]] = []
        self.rig_columns: list[int] = []
        self.is_length: list[bool] = []
        self.periods: list[tuple[float, float]] = []
        self.is_geared: list[bool] = []
        self.ball_rotations: list[tuple[int, FloatArray]] = []
        self.leader_column_by_joint: dict[int, int] = {}
        self.ball_column_by_joint: dict[int, int] = {}
        self.programs = DriverPrograms(rig, pose) if rig.is_driven else None

    def add_joint(self, joint_index: int, frame: _Frame) -> _Frame:
        """Append a joint's nodes below its rest frame; return the joint's frame."""
        joint = self.rig.joints[joint_index]
        first_column = self.slices[joint_index].start
        if joint.type in {JointType.PIN, JointType.PRISMATIC}:
            return self._add_axis_joint(joint_index, frame)
        if joint.type is JointType.FREE:
            for i in range(3):
                frame = self._add_slide(first_column + i, frame, np.eye(3)[i])
            return self._add_ball(first_column + 3, joint, frame)
        self.ball_column_by_joint[joint_index] = len(self.rig_columns)
        return self._add_ball(first_column, joint, frame)

    def sources(self) -> dict[int, CoordinateSource]:
        """Return the chain coordinates that drivers may read, by joint."""
        source_by_joint = {
            j: CoordinateSource(column)
            for j, column in self.ball_column_by_joint.items()
        }
        for j, joint in enumerate(self.rig.joints):
            if joint.type in {JointType.PIN, JointType.PRISMATIC}:
                leader, gain, shift = leader_of(self.rig, j)
                if leader in self.leader_column_by_joint:
                    column = self.leader_column_by_joint[leader]
                    source_by_joint[j] = CoordinateSource(column, gain, shift)
        return source_by_joint

    def _add_node(
        self,
        kind: int,
        frame: _Frame,
        rotation: FloatArray,
        coordinate_index: int,
        *,
        driver_kind: int = UNDRIVEN,
        gain: tuple[float, float] = (1.0, 0.0),
        limit: tuple[float, float, float, float] = (-np.inf, np.inf, 0.0, 0.0),
    ) -> _Frame:
        """Append a node to the chain; return its frame."""
        self.nodes.append([kind, frame.node, coordinate_index, driver_kind])
        self.rest_matrices.append(so3.to_matrix(so3.multiply(frame.rotation, rotation)))
        self.offsets.append(frame.translation)
        self.gains.append(gain)
        self.limits.append(limit)
        return _Frame(len(self.nodes) - 1, np.zeros(3), so3.conjugate(rotation))

    def _add_slide(self, column: int, frame: _Frame, axis: FloatArray) -> _Frame:
        """Append a prismatic node along an axis; return the frame that it moves."""
        self.rig_columns.append(column)
        self.is_length.append(True)
        self.periods.append(UNLIMITED)
        self.is_geared.append(False)
        rotation = _rotation_from_z(axis)
        return self._add_node(SLIDE, frame, rotation, len(self.rig_columns) - 1)

    def _add_axis_joint(self, joint_index: int, frame: _Frame) -> _Frame:
        """Append the node of a pin or prismatic joint; return its frame."""
        leader, gain, shift = leader_of(self.rig, joint_index)
        joint = self.rig.joints[joint_index]
        kind = PIN if joint.type is JointType.PIN else SLIDE
        rotation = _rotation_from_z(np.asarray(joint.axis, np.float64))
        if self.programs is not None and joint_index in self.programs.plan.joints:
            program = self.programs.request_program(joint_index)
            return self._add_node(
                kind, frame, rotation, program, driver_kind=FOLLOWS_PROGRAM
            )
        if leader in self.leader_column_by_joint:
            column = self.leader_column_by_joint[leader]
            return self._add_node(
                kind,
                frame,
                rotation,
                column,
                driver_kind=FOLLOWS_LEADER,
                gain=(gain, shift),
            )
        low, high = self.ranges.get(leader, UNLIMITED)
        is_length = self.rig.joints[leader].type is JointType.PRISMATIC
        column = self.leader_column_by_joint[leader] = len(self.rig_columns)
        self.rig_columns.append(self.slices[leader].start)
        self.is_length.append(is_length)
        is_full = high - low >= 2 * np.pi - REVOLUTION_TOLERANCE
        # A revolution of a joint moves those that follow it by another angle.
        is_periodic = (
            not is_length and gain == 1.0 and leader not in self.followed_joints
        )
        is_unlimited = is_full and is_periodic
        has_period = is_unlimited and math.isfinite(high - low)
        self.periods.append((low, high) if has_period else UNLIMITED)
        self.is_geared.append(not is_length and leader in self.geared_joints)
        limit = (*(UNLIMITED if is_unlimited else (low, high)), 0.0, 0.0)
        return self._add_node(
            kind, frame, rotation, column, gain=(gain, shift), limit=limit
        )

    def _add_ball(self, column: int, joint: Joint, frame: _Frame) -> _Frame:
        """Append the node of a ball joint; return its frame."""
        rotation, limit = so3.IDENTITY, (np.inf, np.inf, -np.inf, np.inf)
        if isinstance(joint.limits, BallLimit):
            twist_axis, first_swing_axis, second_swing_axis = joint.limits.axes
            basis = np.stack([first_swing_axis, second_swing_axis, twist_axis], axis=1)
            rotation = so3.from_matrix(basis)
            swing = joint.limits.swing or (np.inf, np.inf)
            twist = joint.limits.twist or UNLIMITED
            if twist[1] - twist[0] >= 2 * np.pi - REVOLUTION_TOLERANCE:
                twist = UNLIMITED
            limit = (*swing, *twist)
        first_column = len(self.rig_columns)
        self.rig_columns += range(column, column + 4)
        self.is_length += [False] * 4
        self.periods += [UNLIMITED] * 4
        self.is_geared += [False] * 4
        self.ball_rotations.append((first_column, so3.conjugate(rotation)))
        return self._add_node(BALL, frame, rotation, first_column, limit=limit)


def _rotation_from_z(axis: FloatArray) -> FloatArray:
    """Return the shortest rotation that takes z onto a unit axis."""
    if axis[2] < -1 + 1e-9:
        return np.array([1.0, 0.0, 0.0, 0.0])
    return so3.normalize(np.array([-axis[1], axis[0], 0.0, 1 + axis[2]]))


def _followed_joints(rig: Rig) -> tuple[set[int], set[int]]:
    """Return the joints that others follow, and those whose revolution moves them.

    A whole gain gives the same pose after a revolution; drivers and slides need not.
    """
    followed, geared = set[int](), set[int]()
    for j, joint in enumerate(rig.joints):
        if joint.mimic is not None:
            leader, gain, _ = leader_of(rig, j)
            followed.add(leader)
            if joint.type is not JointType.PIN or not float(gain).is_integer():
                geared.add(leader)
    if rig.is_driven:
        read = set[str]().union(*plan_of(rig).joints_read.values())
        leaders = {leader_of(rig, rig.index(name))[0] for name in read}
        return followed | leaders, geared | leaders
    return followed, geared


def assemble_chain(
    rig: Rig, goals: Sequence[Goal], moving_joints: set[int], pose: FloatArray
) -> tuple[Chain, list[Fault]]:
    """Return the chain of the moving joints; other joints are fixed at a pose ``(Q,)``.

    At least one joint above each goal moves.
    """
    local = local_from_coordinates(rig, pose[None])
    builder = _ChainBuilder(rig, pose)
    frame_by_joint: dict[int, _Frame] = {}
    joints_above_goals = {
        j for goal in goals for j in rig.upwards(rig.index(goal.joint))
    }
    root_frame = _Frame(-1, np.zeros(3), so3.IDENTITY)
    rest_poses = zip(rig.rest_translations, rig.rest_rotations, strict=True)
    poses = list(zip(local.translations[0], local.rotations[0], strict=True))
    for j, rest in enumerate(rest_poses):
        if j not in joints_above_goals:
            continue
        parent = frame_by_joint.get(rig.joints[j].parent, root_frame)
        if j in moving_joints:
            frame_by_joint[j] = builder.add_joint(j, parent.transform(*rest))
        else:
            frame_by_joint[j] = parent.transform(*poses[j])
    for j in sorted(moving_joints - joints_above_goals):
        # They move goals only through mimic joints: their position is irrelevant.
        builder.add_joint(j, root_frame)
    limbs, faults = _limb_nodes(rig, goals, moving_joints, frame_by_joint, local)
    return _build_chain(builder, rig, goals, frame_by_joint, limbs), faults


def _limb_nodes(
    rig: Rig,
    goals: Sequence[Goal],
    moving_joints: set[int],
    frame_by_joint: dict[int, _Frame],
    local: LocalTransforms,
) -> tuple[list[tuple[int, int]], list[Fault]]:
    """Return the root and middle node of each goal's limb, and faults in the limbs."""
    limbs = [(-1, -1)] * len(goals)
    faults: list[Fault] = []
    if not any(goal.pole > 0 for goal in goals):
        return limbs, faults
    world = forward_kinematics(rig, local.translations, local.rotations)
    origins = world.positions[0]
    for i, goal in enumerate(goals):
        if goal.pole <= 0:
            continue
        tip = rig.index(goal.joint)
        point = origins[tip] + world.linear[0, tip] @ np.asarray(goal.offset)
        limb = limb_joints(rig, goal, moving_joints, origins, point)
        if limb is None:
            message = f"the pole of {goal.joint!r} needs a limb of two bones that ends"
            faults.append(Fault("IK004", f"{message} there", where=f"goals[{i}]"))
        else:
            root, middle = limb
            limbs[i] = (frame_by_joint[root].node, frame_by_joint[middle].node)
    return limbs, faults


def _build_chain(
    builder: _ChainBuilder,
    rig: Rig,
    goals: Sequence[Goal],
    frame_by_joint: dict[int, _Frame],
    limbs: list[tuple[int, int]],
) -> Chain:
    """Return the chain of a builder, with lengths divided by the chain's length."""
    goal_frames = [frame_by_joint[rig.index(goal.joint)] for goal in goals]
    tool_offsets = [
        so3.rotate(end.rotation, np.asarray(goal.offset, np.float64))
        for goal, end in zip(goals, goal_frames, strict=True)
    ]
    goal_points = [
        end.translation + tool
        for end, tool in zip(goal_frames, tool_offsets, strict=True)
    ]
    chain_length = _chain_length(builder, goal_frames, goal_points)
    scales = np.where(builder.is_length, chain_length, 1.0)
    nodes, node_numbers = _node_rows(builder, scales, chain_length)
    goal_numbers = [
        [
            *(end.translation / chain_length),
            *(tool / chain_length),
            *so3.rotate(end.rotation, np.asarray(goal.aim_axis, np.float64)),
            *goal.weights,
        ]
        for goal, end, tool in zip(goals, goal_frames, tool_offsets, strict=True)
    ]
    levels = _priority_levels(goals)
    goal_nodes = [
        [end.node, *limb, level]
        for end, limb, level in zip(goal_frames, limbs, levels, strict=True)
    ]
    return Chain(
        nodes,
        node_numbers,
        np.array(goal_nodes, np.int64),
        np.array(goal_numbers, np.float64),
        np.array([end.rotation for end in goal_frames]),
        np.array(builder.rig_columns, np.int64),
        scales,
        np.array(builder.periods, np.float64),
        np.array(builder.is_geared, np.bool_),
        tuple(builder.ball_rotations),
        sum(
            3 if kind == BALL else 1
            for kind, _, _, driver_kind in builder.nodes
            if driver_kind == UNDRIVEN
        ),
        chain_length,
    )


def _node_rows(
    builder: _ChainBuilder, scales: FloatArray, length: float
) -> tuple[IntArray, FloatArray]:
    """Return the kernel arrays of a chain: nodes ``(N, 4)`` and their numbers.

    scales: Divisor of each coordinate ``(D,)``: chain length [m], or 1 for angles.
    """
    nodes = np.array(builder.nodes, np.int64).reshape(-1, 4)
    node_scales = np.where(nodes[:, 0] == SLIDE, length, 1.0)
    is_program = nodes[:, 3] == FOLLOWS_PROGRAM
    # Programs return metres and radians.
    columns = np.where(is_program, 0, nodes[:, 2])
    coordinate_scales = np.where(is_program, 1.0, scales[columns])
    gains = np.array(builder.gains)
    limits = np.array(builder.limits)
    is_single_axis = nodes[:, 0] != BALL
    limits[is_single_axis, :2] /= coordinate_scales[is_single_axis, None]
    node_numbers = np.concatenate(
        [
            np.array(builder.rest_matrices).reshape(-1, 9),
            np.array(builder.offsets) / length,
            (gains[:, 0] * coordinate_scales / node_scales)[:, None],
            (gains[:, 1] / node_scales)[:, None],
            limits,
        ],
        axis=1,
    )
    if builder.programs is not None:
        sources = builder.sources()
        program_indices, program_rows, program_values = builder.programs.arrays(
            sources, scales
        )
        nodes[is_program, 2] = np.array(program_indices, np.int64)[nodes[is_program, 2]]
        padding = np.zeros((len(program_rows), node_numbers.shape[1]))
        padding[:, :6] = np.array(program_values).reshape(-1, 6)
        nodes = np.concatenate([nodes, np.array(program_rows, np.int64).reshape(-1, 4)])
        node_numbers = np.concatenate([node_numbers, padding])
    return nodes, np.ascontiguousarray(node_numbers)


def _priority_levels(goals: Sequence[Goal]) -> list[int]:
    """Renumber the goals' priorities to consecutive levels from 0."""
    ranks = sorted({goal.priority for goal in goals})
    return [ranks.index(goal.priority) for goal in goals]


def _chain_length(
    builder: _ChainBuilder, goal_frames: list[_Frame], points: list[FloatArray]
) -> float:
    """Return the longest bone path to a goal, else the longest slide, else 1 [m]."""
    distances = np.zeros(len(builder.nodes))
    for n, (_, parent, _, _) in enumerate(builder.nodes):
        if parent >= 0:
            distances[n] = distances[parent] + np.linalg.norm(builder.offsets[n])
    longest = max(
        float(distances[end.node] + np.linalg.norm(point))
        for end, point in zip(goal_frames, points, strict=True)
    )
    if longest > 0:
        return longest
    nodes = zip(builder.nodes, builder.limits, strict=True)
    slide_ranges = [
        high - low
        for (kind, *_), (low, high, *_) in nodes
        if kind == SLIDE and 0 < high - low < np.inf
    ]
    return float(max(slide_ranges, default=1.0))
