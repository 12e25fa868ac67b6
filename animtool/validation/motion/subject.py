"""Subject of the motion rules: a take with cached measurements."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TypeAlias

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.take import Take
from animtool.rig.kinematics import WorldTransforms, rest_world
from animtool.rig.sides import SidePairs, pair_sides

# Code, joint (empty for the take), frame (None for all), message, hint.
FaultFactory: TypeAlias = Callable[[str, str, float | None, str, str], Fault]

# A smaller rig has no reference size [m].
MIN_RIG_SIZE = 1e-9
# Bones shorter than this do not define the scale [size]; number of frames that do.
MIN_SCALE_BONE, SCALE_FRAME_COUNT = 0.02, 32
# Length ratio below which bones stretch, and are not scaled [1].
MIN_SCALE_RATIO = 1.5
# A first frame is a reference pose if this many joints leave it, each by this angle
# [rad] and by this multiple of the following steps, of which so many are used [1].
MIN_POSE_JOINTS, MIN_POSE_ANGLE = 3, math.radians(30.0)
POSE_STEP_RATIO, POSE_STEP_COUNT = 4.0, 8


@dataclass(frozen=True, eq=False)
class MotionSubject:
    """A take that motion rules check; its measurements are computed when first used."""

    take: Take  # F frames, J joints
    fault_at: FaultFactory  # creates a fault with its location in the file
    # Time code of each sample in the file ``(F,)``; None if the take's clock is exact.
    time_codes: FloatArray | None = None
    # First and last time code of the motion as stated in the file.
    frame_range: tuple[float, float] | None = None
    # Intentional cuts between frames ``(F - 1,)``.
    is_intended_cut: BoolArray | None = None
    # Whether the rig's rest pose is known; a USD layer alone has none.
    has_rest: bool = True
    # Whether the file states its unit and up axis; a BVH does not.
    has_units: bool = True
    # Joints that influence points of a mesh, directly or through a descendant; None if
    # no skinned mesh is known.
    influencing_joints: frozenset[str] | None = None
    # World positions of the joints in the bind pose ``(J, 3)`` [m].
    bind_positions: FloatArray | None = None
    # Frame rate of the file, if it differs from its time codes.
    playback_rate: float | None = None
    # ``USD``, or ``clip`` for a clip on a rig; empty for formats that only options of
    # reading give another unit or up axis.
    file_format: str = ""
    # Whether samples were intentionally left out, to be restored by interpolation.
    is_reduced: bool = False

    def fault(
        self, code: str, joint: int | None, frame: int | None, message: str, hint: str
    ) -> Fault:
        """Return a fault of a joint at a frame by index, located in the file."""
        name = "" if joint is None else self.take.rig.joints[joint].name
        time_code = None if frame is None else float(self.times[frame])
        fault = self.fault_at(code, name, time_code, message, hint)
        return replace(fault, frame=time_code, joint=name or None)

    @property
    def frame_count(self) -> int:
        """Number of frames."""
        return self.take.motion.frames

    @cached_property
    def times(self) -> FloatArray:
        """Time code of each frame ``(F,)``, exact or as stored in the file."""
        return self.take.clock.times if self.time_codes is None else self.time_codes

    @cached_property
    def interval(self) -> float:
        """Median time between two frames [s]."""
        if self.frame_count < 2:
            return 1.0 / float(self.take.clock.rate)
        return float(np.median(np.diff(self.times))) / float(self.take.clock.fps)

    @cached_property
    def _step_rates(self) -> FloatArray:
        """Median time step divided by each time step ``(F - 1,)`` [1]."""
        steps = np.diff(self.times)
        return np.asarray(np.median(steps) / steps if len(steps) else steps)

    @property
    def rotating_joints(self) -> IntArray:
        """Indices of the rotating joints ``(A,)``."""
        return self.take.motion.rotations.animated

    @property
    def translating_joints(self) -> IntArray:
        """Indices of the joints that move relative to their parents ``(B,)``."""
        return self.take.motion.translations.animated

    @cached_property
    def rotation_steps(self) -> FloatArray:
        """Rotation vectors from each frame to the next ``(F - 1, A, 3)`` [rad].

        The rotations are in the parent's space, and scaled to the median interval if
        samples are uneven.
        """
        rotations = self.take.motion.rotations.values
        rotation_vectors = so3.log(
            so3.multiply(rotations[1:], so3.conjugate(rotations[:-1]))
        )
        return np.asarray(rotation_vectors * self._step_rates[:, None, None])

    @cached_property
    def translation_steps(self) -> FloatArray:
        """Translation from each frame to the next ``(F - 1, B, 3)`` [m]."""
        steps = np.diff(self.take.motion.translations.values, axis=0)
        return np.asarray(steps * self._step_rates[:, None, None])

    @cached_property
    def speeds(self) -> FloatArray:
        """Combined motion of all joints from each frame to the next ``(F - 1,)``.

        The square root of the sum of squared rotations [rad] and squared translations,
        in units of half the size of the rig.
        """
        squared_rotations, squared_translations = (
            np.einsum("fjc,fjc->f", steps, steps)
            for steps in (self.rotation_steps, self.translation_steps)
        )
        return np.asarray(
            np.sqrt(squared_rotations + squared_translations * (2.0 / self.size) ** 2)
        )

    @cached_property
    def joints_leaving_pose(self) -> IntArray:
        """Indices of the joints that leave a first frame that is a reference pose.

        Empty if that frame is part of the motion.
        """
        if (
            self.frame_count < POSE_STEP_COUNT
            or not len(self.rotating_joints)
            or self.cut_mask()[0]
        ):
            return np.zeros(0, np.int64)
        first_angles, *later_angles = np.linalg.norm(
            self.rotation_steps[:POSE_STEP_COUNT], axis=2
        )
        is_leaving_pose = first_angles > MIN_POSE_ANGLE
        is_leaving_pose &= first_angles > POSE_STEP_RATIO * np.max(later_angles, axis=0)
        joints = np.asarray(self.rotating_joints[is_leaving_pose])
        return joints if len(joints) >= MIN_POSE_JOINTS else joints[:0]

    @cached_property
    def without_first_pose(self) -> MotionSubject:
        """The take without its first frame, if this frame is a reference pose."""
        if not len(self.joints_leaving_pose):
            return self
        clock = self.take.clock
        clock = replace(clock, start=clock.start + clock.step, count=clock.count - 1)
        motion = self.take.motion.select(slice(1, None))
        take = replace(self.take, clock=clock, motion=motion, curve=None)
        time_codes, is_cut = self.time_codes, self.is_intended_cut
        time_codes = None if time_codes is None else time_codes[1:]
        is_cut = None if is_cut is None else is_cut[1:]
        return replace(self, take=take, time_codes=time_codes, is_intended_cut=is_cut)

    @cached_property
    def world(self) -> WorldTransforms:
        """World transforms of all joints over the frames."""
        return self.take.world()

    @property
    def positions(self) -> FloatArray:
        """Joint positions, world ``(F, J, 3)`` [m]."""
        return self.world.positions

    @cached_property
    def rest_positions(self) -> FloatArray:
        """Joint positions at rest, world ``(J, 3)`` [m]."""
        return np.asarray(rest_world(self.take.rig).positions[0])

    @cached_property
    def sides(self) -> SidePairs:
        """Pairs of left and right joints, matched by their names."""
        return pair_sides(self.take.rig.names, self.take.rig.parents)

    @cached_property
    def rest_size(self) -> float:
        """Diagonal of the joints' bounds at rest [m]."""
        if not len(self.rest_positions):
            return MIN_RIG_SIZE
        extent = self.rest_positions.max(axis=0) - self.rest_positions.min(axis=0)
        return max(float(np.linalg.norm(extent)), MIN_RIG_SIZE)

    @cached_property
    def size(self) -> float:
        """Diagonal of the joints' bounds at rest, at the animated scale [m]."""
        return max(self.rest_size * self._scale, MIN_RIG_SIZE)

    @cached_property
    def _scale(self) -> float:
        """Median ratio of animated to rest bone lengths, world."""
        parents = self.take.rig.parents
        child_joints = np.flatnonzero(parents >= 0)
        if not self.has_rest or not len(child_joints) or not self.frame_count:
            return 1.0
        rest_vectors = (
            self.rest_positions[child_joints]
            - self.rest_positions[parents[child_joints]]
        )
        rest_lengths = np.linalg.norm(rest_vectors, axis=1)
        is_measured = rest_lengths > MIN_SCALE_BONE * self.rest_size
        child_joints, rest_lengths = (
            child_joints[is_measured],
            rest_lengths[is_measured],
        )
        if not len(child_joints):
            return 1.0
        frame_indices = np.unique(
            np.linspace(0, self.frame_count - 1, SCALE_FRAME_COUNT).astype(int)
        )
        positions = self.positions[frame_indices]
        animated_vectors = (
            positions[:, child_joints] - positions[:, parents[child_joints]]
        )
        lengths = np.linalg.norm(animated_vectors, axis=2)
        scale = float(np.median(lengths / rest_lengths))
        return scale if max(scale, 1.0 / max(scale, 1e-12)) > MIN_SCALE_RATIO else 1.0

    @cached_property
    def up_vector(self) -> FloatArray:
        """Unit up vector ``(3,)``."""
        return np.array(self.take.rig.up.vector)

    @cached_property
    def heights(self) -> FloatArray:
        """Heights of the joints above the origin ``(F, J)`` [m]."""
        return np.asarray(self.positions @ self.up_vector)

    def ground_positions(self, joints: IntArray) -> FloatArray:
        """Return horizontal joint positions ``(F, len(joints), 3)`` [m]."""
        joint_positions = self.positions[:, joints]
        return np.asarray(
            joint_positions
            - (joint_positions @ self.up_vector)[..., None] * self.up_vector
        )

    def cut_mask(self) -> BoolArray:
        """Return a mask of the steps that are intended cuts ``(F - 1,)``."""
        step_count = max(self.frame_count - 1, 0)
        if self.is_intended_cut is None:
            return np.zeros(step_count, bool)
        return self.is_intended_cut.copy()

    def time_text(self, frame: int) -> str:
        """Return the time code of a frame for a message."""
        return f"{self.times[frame]:.10g}"


def fault_factory_at(path: Path, where: str | None = None) -> FaultFactory:
    """Return a factory of faults in a file, at one location or at their joints."""

    def fault_at(
        code: str, joint: str, frame: float | None, message: str, hint: str
    ) -> Fault:
        del frame
        return Fault(code, message, str(path), (), hint, where=where or joint or None)

    return fault_at
