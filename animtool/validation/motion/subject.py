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
FaultAt: TypeAlias = Callable[[str, str, float | None, str, str], Fault]

# A smaller rig has no reference size [m].
MIN_SIZE = 1e-9
# Bones shorter than this do not define the scale [size]; number of frames that do.
SHORT_BONE, SCALE_FRAMES = 0.02, 32
# Length ratio below which bones stretch, and are not scaled [1].
SCALE_RATIO = 1.5
# A first frame is a reference pose if this many joints leave it, each by this angle
# [rad] and by this multiple of the following steps, of which so many are used [1].
POSE_JOINTS, POSE_ANGLE, POSE_STEP_RATIO, POSE_STEPS = 3, math.radians(30.0), 4.0, 8


@dataclass(frozen=True, eq=False)
class MotionSubject:
    """One take of a file of any format."""

    take: Take  # F frames, J joints
    fault_at: FaultAt  # creates a fault with its location in the file
    # Time code of each sample in the file ``(F,)``; None if the take's clock is exact.
    codes: FloatArray | None = None
    # First and last time code of the motion as stated in the file.
    frame_range: tuple[float, float] | None = None
    # Intentional cuts between frames ``(F - 1,)``.
    intended_cuts: BoolArray | None = None
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
        """Return a fault of a joint at a frame, both by index."""
        name = "" if joint is None else self.take.rig.joints[joint].name
        time_code = None if frame is None else float(self.times[frame])
        fault = self.fault_at(code, name, time_code, message, hint)
        return replace(fault, frame=time_code, joint=name or None)

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.take.motion.frames

    @cached_property
    def times(self) -> FloatArray:
        """Time code of every frame ``(F,)``."""
        return self.take.clock.times if self.codes is None else self.codes

    @cached_property
    def interval(self) -> float:
        """Median time between two frames [s]."""
        if self.frames < 2:
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
        values = self.take.motion.rotations.values
        vectors = so3.log(so3.multiply(values[1:], so3.conjugate(values[:-1])))
        return np.asarray(vectors * self._step_rates[:, None, None])

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
        rotations, translations = (
            np.einsum("fjc,fjc->f", steps, steps)
            for steps in (self.rotation_steps, self.translation_steps)
        )
        return np.asarray(np.sqrt(rotations + translations * (2.0 / self.size) ** 2))

    @cached_property
    def joints_leaving_pose(self) -> IntArray:
        """Indices of the joints that leave a first frame that is a reference pose.

        Empty if that frame is part of the motion.
        """
        if self.frames < POSE_STEPS or not len(self.rotating_joints) or self.cuts()[0]:
            return np.zeros(0, np.int64)
        first_angles, *later_angles = np.linalg.norm(
            self.rotation_steps[:POSE_STEPS], axis=2
        )
        leaves_pose = first_angles > POSE_ANGLE
        leaves_pose &= first_angles > POSE_STEP_RATIO * np.max(later_angles, axis=0)
        joints = np.asarray(self.rotating_joints[leaves_pose])
        return joints if len(joints) >= POSE_JOINTS else joints[:0]

    @cached_property
    def without_first_pose(self) -> MotionSubject:
        """The take without its first frame, if this frame is a reference pose."""
        if not len(self.joints_leaving_pose):
            return self
        clock = self.take.clock
        clock = replace(clock, start=clock.start + clock.step, count=clock.count - 1)
        motion = self.take.motion.select(slice(1, None))
        take = replace(self.take, clock=clock, motion=motion, curve=None)
        codes, cuts = self.codes, self.intended_cuts
        codes = None if codes is None else codes[1:]
        cuts = None if cuts is None else cuts[1:]
        return replace(self, take=take, codes=codes, intended_cuts=cuts)

    @cached_property
    def world(self) -> WorldTransforms:
        """World transforms of the joints."""
        return self.take.world()

    @property
    def positions(self) -> FloatArray:
        """Joint positions, world ``(F, J, 3)`` [m]."""
        return self.world.positions

    @cached_property
    def rest(self) -> FloatArray:
        """Joint positions at rest, world ``(J, 3)`` [m]."""
        return np.asarray(rest_world(self.take.rig).positions[0])

    @cached_property
    def sides(self) -> SidePairs:
        """Pairs of left and right joints, by name."""
        return pair_sides(self.take.rig.names, self.take.rig.parents)

    @cached_property
    def rest_size(self) -> float:
        """Diagonal of the joints' bounds at rest [m]."""
        if not len(self.rest):
            return MIN_SIZE
        extent = self.rest.max(axis=0) - self.rest.min(axis=0)
        return max(float(np.linalg.norm(extent)), MIN_SIZE)

    @cached_property
    def size(self) -> float:
        """Diagonal of the joints' bounds at rest, at the animated scale [m]."""
        return max(self.rest_size * self._scale, MIN_SIZE)

    @cached_property
    def _scale(self) -> float:
        """Median ratio of animated to rest bone lengths, world."""
        parents = self.take.rig.parents
        bones = np.flatnonzero(parents >= 0)
        if not self.has_rest or not len(bones) or not self.frames:
            return 1.0
        rest_bones = self.rest[bones] - self.rest[parents[bones]]
        rest_lengths = np.linalg.norm(rest_bones, axis=1)
        is_measured = rest_lengths > SHORT_BONE * self.rest_size
        bones, rest_lengths = bones[is_measured], rest_lengths[is_measured]
        if not len(bones):
            return 1.0
        frames = np.unique(np.linspace(0, self.frames - 1, SCALE_FRAMES).astype(int))
        positions = self.positions[frames]
        animated_bones = positions[:, bones] - positions[:, parents[bones]]
        lengths = np.linalg.norm(animated_bones, axis=2)
        scale = float(np.median(lengths / rest_lengths))
        return scale if max(scale, 1.0 / max(scale, 1e-12)) > SCALE_RATIO else 1.0

    @cached_property
    def up(self) -> FloatArray:
        """Unit up vector ``(3,)``."""
        return np.array(self.take.rig.up.vector)

    @cached_property
    def heights(self) -> FloatArray:
        """Heights of the joints above the origin ``(F, J)`` [m]."""
        return np.asarray(self.positions @ self.up)

    def ground_positions(self, joints: IntArray) -> FloatArray:
        """Return horizontal joint positions ``(F, len(joints), 3)`` [m]."""
        points = self.positions[:, joints]
        return np.asarray(points - (points @ self.up)[..., None] * self.up)

    def cuts(self) -> BoolArray:
        """Return a mask of the steps that are intended cuts ``(F - 1,)``."""
        steps = max(self.frames - 1, 0)
        if self.intended_cuts is None:
            return np.zeros(steps, bool)
        return self.intended_cuts.copy()

    def time_text(self, frame: int) -> str:
        """Return the time code of a frame for a message."""
        return f"{self.times[frame]:.10g}"


def faults_at(path: Path, where: str) -> FaultAt:
    """Return a function that locates every fault of a take at one place in a file."""

    def fault_at(
        code: str, joint: str, frame: float | None, message: str, hint: str
    ) -> Fault:
        del joint, frame
        return Fault(code, message, str(path), (), hint, where=where)

    return fault_at
