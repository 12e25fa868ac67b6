"""A rig's active joints as the kernel takes them: one axis convention, one scale."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.errors import Fault, OptionError
from animtool.maths import so3
from animtool.take import Take


def refuse_scales(
    take: Take, effectors: Iterable[tuple[str, str]], path: Path | None = None
) -> None:
    """Refuse scales of what an effector hangs from: a chain has lengths that stay.

    Args:
        take: Of a rig.
        effectors: Their names, and their joints.
        path: The targets file that asks for them, if there is one.

    Raises:
        OptionError: A joint is scaled, with a fault for each (TGT016).
    """
    channel = take.motion.scales
    if channel is None:
        return
    scaled = (channel.rest != 1.0).any(axis=1)
    scaled[channel.animated] |= (channel.values != 1.0).any(axis=(0, 2))
    faults = {}
    place = None if path is None else str(path)
    for effector, joint in effectors:
        j = take.rig.index(joint)
        while j >= 0:
            if scaled[j]:
                name = take.rig.names[j]
                message = f"{effector!r} hangs from {name!r}, which is scaled"
                hint = "inverse kinematics is for joints without scale"
                faults[name] = Fault("TGT016", message, place, (), hint)
            j = take.rig.joints[j].parent
    if faults:
        raise OptionError(list(faults.values()))


PIN, SLIDE, BALL = 0, 1, 2
# Limits this close to a whole turn apart leave no gap [rad].
GAP = 1e-6


@dataclass(frozen=True)
class Chain:
    """Nodes: joints turned so that z is what they turn, slide or twist about."""

    nodes: IntArray  # kind, parent, coordinate, whether it follows ``(N, 4)``
    # Rest rotation and offset, gain, shift, limits ``(N, 18)``, lengths in shares of
    # ``length``.
    numbers: FloatArray
    goals: IntArray  # node, root and middle of the limb, level ``(E, 4)``
    # Offset in the node's frame, of the joint and from the joint, aim axis, weights
    # ``(E, 9 + K)``.
    goal_numbers: FloatArray
    # Node_from_joint quaternions ``(E, 4)`` of the goals' joints.
    goal_frames: FloatArray
    columns: IntArray  # of the rig's coordinates, those of the chain, in its order
    scales: FloatArray  # what each of them is divided by
    # Least and largest of each that turns all the way round, else infinite ``(C, 2)``.
    periods: FloatArray
    # ``(first column of a ball, ball_from_joint quaternion)``.
    turns: tuple[tuple[int, FloatArray], ...]
    degrees: int  # degrees of freedom
    length: float  # [m]

    @cached_property
    def turning(self) -> IntArray:
        """Columns of the joints that turn all the way round."""
        return np.flatnonzero(np.isfinite(self.periods[:, 0]))

    @cached_property
    def _balls(self) -> tuple[IntArray, FloatArray]:
        """Columns ``(T, 4)`` of ball joints, and their turns ``(T, 4)``."""
        first = np.array([place for place, _ in self.turns], np.int64)
        turns = np.array([turn for _, turn in self.turns]).reshape(-1, 4)
        return first[:, None] + np.arange(4), turns

    def from_rig(self, coordinates: FloatArray) -> FloatArray:
        """Return the chain's coordinates ``(B, C)`` of the rig's ``(B, Q)``."""
        q = np.ascontiguousarray(coordinates[:, self.columns] / self.scales)
        columns, turns = self._balls
        q[:, columns] = _conjugated(so3.normalize(q[:, columns]), turns)
        return q

    def into_rig(self, q: FloatArray, coordinates: FloatArray) -> FloatArray:
        """Return the rig's coordinates ``(B, Q)`` with the chain's in place."""
        q = q.copy()
        columns, turns = self._balls
        q[:, columns] = _conjugated(q[:, columns], so3.conjugate(turns))
        if len(self.turning):
            low, high = self.periods[self.turning].T
            own = q[:, self.turning]
            whole = np.round((own - (low + high) / 2) / (2 * np.pi))
            inside = np.clip(own - 2 * np.pi * whole, low, high)
            q[:, self.turning] = np.where((own < low) | (own > high), inside, own)
        out = coordinates.copy()
        out[:, self.columns] = q * self.scales
        return out


def _conjugated(q: FloatArray, turn: FloatArray) -> FloatArray:
    """Return rotations ``(B, T, 4)`` as seen from turned frames ``(T, 4)``."""
    return np.concatenate([so3.rotate(turn, q[..., :3]), q[..., 3:]], axis=-1)
