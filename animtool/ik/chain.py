"""The kinematic chain of a rig's moving joints, in the layout of the IK kernels."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.ik.driver_programs import FOLLOWS_PROGRAM
from animtool.maths import so3

PIN, SLIDE, BALL = 0, 1, 2
# A limit range within this of a full revolution has no gap [rad].
REVOLUTION_TOLERANCE = 1e-6
# A limit range exceeding a full revolution by at most this counts as one [rad].
REVOLUTION_EXCESS = 0.02
# Beyond the angle of any pin [rad].
MAX_ANGLE = 1e9


@dataclass(frozen=True)
class Chain:
    """Nodes of joints, each rotated so that z is its rotation, slide or twist axis."""

    # Kind, parent, coordinate, and 1 for a mimic or 2 for a driver program ``(N, 4)``;
    # then the rows of programs (`driver_programs`).
    nodes: IntArray
    # Rest rotation and offset, gain, shift, limits ``(N, 18)``; lengths are fractions
    # of ``length``.
    node_numbers: FloatArray
    goal_nodes: IntArray  # node, root and middle of the limb, level ``(E, 4)``
    # Offset in the node's frame, of the joint and from the joint, aim axis, weights
    # ``(E, 9 + K)``.
    goal_numbers: FloatArray
    # Node_from_joint quaternions ``(E, 4)`` of the goals' joints.
    goal_rotations: FloatArray
    rig_columns: IntArray  # rig coordinate of each chain coordinate ``(C,)``
    scales: FloatArray  # divisor of each chain coordinate ``(C,)``
    # Limits of each coordinate that covers a full revolution, else infinite ``(C, 2)``.
    periods: FloatArray
    # Mask of the pins whose revolution moves a joint that follows them ``(C,)``.
    is_geared: BoolArray
    # ``(first column of a ball, ball_from_joint quaternion)``.
    ball_rotations: tuple[tuple[int, FloatArray], ...]
    degrees: int  # degrees of freedom
    length: float  # unit of lengths: the longest bone path to a goal [m]

    @property
    def kernel_arrays(self) -> tuple[IntArray, FloatArray, IntArray, FloatArray]:
        """Chain and goal arrays, the first arguments of IK kernels."""
        return self.nodes, self.node_numbers, self.goal_nodes, self.goal_numbers

    @cached_property
    def full_revolution_columns(self) -> IntArray:
        """Columns of the joints that cover a full revolution."""
        return np.flatnonzero(np.isfinite(self.periods[:, 0]))

    @cached_property
    def _ball_columns(self) -> tuple[IntArray, FloatArray]:
        """Columns ``(T, 4)`` of ball joints, and their frames ``(T, 4)``."""
        first = np.array([column for column, _ in self.ball_rotations], np.int64)
        ball_rotations = np.array([frame for _, frame in self.ball_rotations]).reshape(
            -1, 4
        )
        return first[:, None] + np.arange(4), ball_rotations

    def from_rig(self, coordinates: FloatArray) -> FloatArray:
        """Return chain coordinates ``(B, C)`` from rig coordinates ``(B, Q)``."""
        q = np.ascontiguousarray(coordinates[:, self.rig_columns] / self.scales)
        columns, ball_rotations = self._ball_columns
        q[:, columns] = _conjugate(so3.normalize(q[:, columns]), ball_rotations)
        return q

    def into_rig(
        self, chain_coordinates: FloatArray, coordinates: FloatArray
    ) -> FloatArray:
        """Return rig coordinates ``(B, Q)`` updated from the chain's ``(B, C)``."""
        chain_coordinates = chain_coordinates.copy()
        columns, ball_rotations = self._ball_columns
        chain_coordinates[:, columns] = _conjugate(
            chain_coordinates[:, columns], so3.conjugate(ball_rotations)
        )
        if len(self.full_revolution_columns):
            low, high = self.periods[self.full_revolution_columns].T
            angles = chain_coordinates[:, self.full_revolution_columns]
            revolutions = np.round((angles - (low + high) / 2) / (2 * np.pi))
            wrapped_angles = np.clip(angles - 2 * np.pi * revolutions, low, high)
            chain_coordinates[:, self.full_revolution_columns] = np.where(
                (angles < low) | (angles > high), wrapped_angles, angles
            )
        rig_coordinates = coordinates.copy()
        rig_coordinates[:, self.rig_columns] = chain_coordinates * self.scales
        return rig_coordinates


def _conjugate(q: FloatArray, frame: FloatArray) -> FloatArray:
    """Conjugate rotations ``(B, T, 4)`` by frame rotations ``(T, 4)``."""
    return np.concatenate([so3.rotate(frame, q[..., :3]), q[..., 3:]], axis=-1)


def joint_steps(chain: Chain, start: FloatArray, end: FloatArray) -> FloatArray:
    """Return steps between poses ``(..., D)``, from coordinates ``(..., C)``.

    Pins step in radians, slides in fractions of the chain's length, balls in rotation
    vectors [rad] in their rest frame. Pins without limits take the short direction.
    """
    start, end = np.broadcast_arrays(start, end)
    steps = np.zeros((*start.shape[:-1], chain.degrees))
    columns, first_dofs, is_ball = _joint_columns(chain)
    angles = end[..., columns[~is_ball]] - start[..., columns[~is_ball]]
    revolutions = 2 * np.pi * np.round(angles / (2 * np.pi))
    angles -= np.where(_unlimited_pins(chain)[~is_ball], revolutions, 0.0)
    steps[..., first_dofs[~is_ball]] = angles
    for column, dof in zip(columns[is_ball], first_dofs[is_ball], strict=True):
        ball_columns = slice(column, column + 4)
        rotation = so3.multiply(
            end[..., ball_columns], so3.conjugate(start[..., ball_columns])
        )
        steps[..., dof : dof + 3] = so3.log(rotation)
    return steps


def apply_steps(chain: Chain, start: FloatArray, step: FloatArray) -> FloatArray:
    """Add joint steps ``(..., D)`` to poses ``(..., C)``, ignoring limits."""
    shape = np.broadcast_shapes(start.shape[:-1], step.shape[:-1])
    poses = np.array(np.broadcast_to(start, (*shape, start.shape[-1])))
    columns, first_dofs, is_ball = _joint_columns(chain)
    poses[..., columns[~is_ball]] += step[..., first_dofs[~is_ball]]
    for column, dof in zip(columns[is_ball], first_dofs[is_ball], strict=True):
        ball_columns = slice(column, column + 4)
        rotation = so3.exp(step[..., dof : dof + 3])
        poses[..., ball_columns] = so3.multiply(rotation, poses[..., ball_columns])
    return poses


def _joint_columns(chain: Chain) -> tuple[IntArray, IntArray, BoolArray]:
    """Return each joint's first coordinate and degree of freedom, and a ball mask."""
    nodes = chain.nodes[chain.nodes[:, 3] == 0]
    is_ball = nodes[:, 0] == BALL
    dof_counts = np.where(is_ball, 3, 1)
    return nodes[:, 2], np.cumsum(dof_counts) - dof_counts, is_ball


def unwrap_angles(chain: Chain, poses: FloatArray) -> FloatArray:
    """Unwrap the angles of unlimited pins in poses ``(F, C)``."""
    columns = _joint_columns(chain)[0][_unlimited_pins(chain)]
    unwrapped_poses = poses.copy()
    unwrapped_poses[:, columns] = np.unwrap(poses[:, columns], axis=0)
    return unwrapped_poses


def with_periods(chain: Chain) -> FloatArray:
    """Return ``node_numbers`` with limits for pins that exceed a revolution.

    Limits one revolution apart, or slightly more such as ±180.1°, are left out: an
    angle that crosses one continues at the other.
    """
    node_numbers = chain.node_numbers.copy()
    for row, (kind, _, column, driver_kind) in zip(
        node_numbers, chain.nodes, strict=True
    ):
        # Driven joints have no limits here.
        if kind != PIN or driver_kind == FOLLOWS_PROGRAM:
            continue
        low, high = chain.periods[column]
        if high - low > 2 * np.pi + REVOLUTION_EXCESS and np.isfinite(low):
            row[14:16] = low, high
    return node_numbers


def with_geared_limits(chain: Chain) -> FloatArray:
    """Return the chain's ``numbers``, with limits for pins whose revolutions differ.

    Those of geared pins without limits are too wide to matter.
    """
    numbers = with_periods(chain)
    is_pin = (chain.nodes[:, 0] == PIN) & (chain.nodes[:, 3] != FOLLOWS_PROGRAM)
    geared_rows = np.flatnonzero(is_pin)
    geared_rows = geared_rows[chain.is_geared[chain.nodes[geared_rows, 2]]]
    limits = numbers[geared_rows, 14:16]
    numbers[geared_rows, 14:16] = np.clip(limits, -MAX_ANGLE, MAX_ANGLE)
    return numbers


def _unlimited_pins(chain: Chain) -> BoolArray:
    """Return a mask of the joints that are pins without angle limits."""
    is_independent = chain.nodes[:, 3] == 0
    limits = with_geared_limits(chain)[is_independent, 14:16]
    is_unlimited = ~np.isfinite(limits).any(axis=1)
    return np.asarray((chain.nodes[is_independent, 0] == PIN) & is_unlimited)
