"""Target tracks of a targets file, sampled over the frames of a take."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.clock import MAX_FRAME_COUNT, Clock
from animtool.core.errors import Fault, OptionError, counted
from animtool.core.old_names import rename_attributes
from animtool.core.rates import rate_label
from animtool.core.record import dataclass
from animtool.ik.goals import GOAL_KINDS, Goal, GoalKind, Targets
from animtool.ik.limbs import bend_angle, limb_joints
from animtool.ik.values import (
    ArrayRows,
    KeyedValue,
    SampledValue,
    SampleFrames,
    Span,
    blend_holds,
    hold_weights,
    interpolate_rows,
    smoothstep,
)
from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.parts import IkChain
from animtool.rig.skeleton import JointType, Rig

# A direction shorter than this fraction of its reference length is undefined.
MIN_DIRECTION = 1e-6
# Limbs that bend by less than the first angle count as straight, by more than the
# second as bent [rad].
STRAIGHT_ANGLE, BENT_ANGLE = np.radians([5.0, 20.0])
# Frames per second of a file without a rate.
DEFAULT_RATE = Fraction(24)


@dataclass(frozen=True, slots=True)
class FreeEffector:
    """Motion of an effector while its goal is inactive."""

    rig: Rig  # J joints
    goal: Goal  # the effector, its point and axis
    world: WorldTransforms  # joints in F frames, solved without the goal

    def position(self) -> FloatArray:
        """Return the world positions of the effector's point ``(F, 3)`` [m]."""
        j = self.rig.index(self.goal.joint)
        offset = self.world.linear[:, j] @ np.array(self.goal.offset)
        return np.asarray(self.world.positions[:, j] + offset)

    def orientation(self) -> FloatArray:
        """Return the world rotations of the effector's joint ``(F, 4)``."""
        linear = self.world.linear[:, self.rig.index(self.goal.joint)]
        return so3.align_signs(so3.split_scale(linear)[0])

    def blend_from_free_motion(
        self, kind: GoalKind, values: FloatArray, weights: FloatArray
    ) -> FloatArray:
        """Return targets blended from the effector's free motion to their values.

        Points move along lines, rotations along the shortest arc; aim and pole points
        rotate about the effector or the limb's root. Points at the end of a straight
        limb rotate about its root too, at the distance of an evenly bending limb: on a
        straight line, the first degrees of its bend would take no time.

        ``values``: the targets, points ``(F, 3)`` or rotations ``(F, 4)``; ``weights``
        ``(F,)``.
        """
        blended_values = values.copy()
        is_fading = (weights > 0) & (weights < 1)
        fraction = weights[is_fading]
        if not len(fraction):
            return blended_values
        if kind.is_rotation:
            rotations = self.orientation()[is_fading]
            rotations = so3.slerp(rotations, values[is_fading], fraction)
            blended_values[is_fading] = rotations
            return so3.align_signs(blended_values)
        if not kind.is_direction:
            positions = self._blend_positions(values, is_fading, fraction)
            blended_values[is_fading] = positions
            return blended_values
        if kind.depends_on_rotation:
            origins = self.position()
            directions = so3.rotate(self.orientation(), np.array(self.goal.aim_axis))
        else:
            origins, directions = self._bend_directions(values)
        offsets = values[is_fading] - origins[is_fading]
        swung_offsets = swing_towards(directions[is_fading], offsets, fraction)
        blended_values[is_fading] = origins[is_fading] + swung_offsets
        return blended_values

    def _blend_positions(
        self, values: FloatArray, is_fading: BoolArray, fraction: FloatArray
    ) -> FloatArray:
        """Return the blended positions of the selected rows ``(N, 3)``."""
        start, end = self.position()[is_fading], values[is_fading]
        straight_positions = start + fraction[:, None] * (end - start)
        limb = self.limb()
        if limb is None or not self._has_fixed_root(limb[0]):
            return np.asarray(straight_positions)
        root, middle = (self.world.positions[is_fading, j] for j in limb)
        upper_length, lower_length, start_distance, end_distance = (
            np.linalg.norm(vectors, axis=1)
            for vectors in (middle - root, start - middle, start - root, end - root)
        )
        bend_angles = (
            bend_angle(upper_length, lower_length, start_distance),
            bend_angle(upper_length, lower_length, end_distance),
        )
        angle = bend_angles[0] + fraction * (bend_angles[1] - bend_angles[0])
        squared_distance = (
            upper_length**2
            + lower_length**2
            + 2 * upper_length * lower_length * np.cos(angle)
        )
        limb_distance = np.sqrt(np.maximum(squared_distance, 0.0))
        limb_distance += fraction * np.maximum(
            end_distance - (upper_length + lower_length), 0.0
        )
        has_direction = (end_distance > MIN_DIRECTION * (upper_length + lower_length))[
            :, None
        ]
        end_direction = np.where(has_direction, end - root, start - root)
        swung_vectors = swing_towards(start - root, end_direction, fraction)
        swung_length = np.maximum(np.linalg.norm(swung_vectors, axis=1), 1e-300)
        bent_angle = bend_angles[0] - STRAIGHT_ANGLE
        bend_weight = smoothstep(bent_angle / (BENT_ANGLE - STRAIGHT_ANGLE))[:, None]
        swung_positions = root + swung_vectors * (limb_distance / swung_length)[:, None]
        correction = bend_weight * (straight_positions - swung_positions)
        return np.asarray(swung_positions + correction)

    def limb(self) -> tuple[int, int] | None:
        """Return the root and middle joint of the limb."""
        joints = enumerate(self.rig.joints)
        moving_joints = {j for j, joint in joints if joint.type is not JointType.FIXED}
        origins, point = self.world.positions[0], self.position()[0]
        return limb_joints(self.rig, self.goal, moving_joints, origins, point)

    def _has_fixed_root(self, root: int) -> bool:
        """Return whether the goal moves no joint above the limb's root."""
        if self.goal.root is not None:
            return True
        parent = self.rig.joints[root].parent
        while parent >= 0 and self.rig.joints[parent].type is JointType.FIXED:
            parent = self.rig.joints[parent].parent
        return parent < 0

    def _bend_directions(self, poles: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the limb's root and the direction of its bend, each ``(F, 3)``.

        A straight limb is assumed to bend towards its poles.
        """
        point = self.position()
        limb = self.limb()
        if limb is None:
            return point, poles - point
        root, middle = (self.world.positions[:, j] for j in limb)
        limb_vectors, bone = point - root, middle - root
        squared_length = np.maximum(
            (limb_vectors**2).sum(axis=1, keepdims=True), 1e-300
        )
        product = (bone * limb_vectors).sum(axis=1, keepdims=True)
        perpendicular = bone - product / squared_length * limb_vectors
        min_length = MIN_DIRECTION * np.linalg.norm(bone, axis=1)
        is_bent = np.linalg.norm(perpendicular, axis=1) > min_length
        return root, np.where(is_bent[:, None], perpendicular, poles - root)


def swing_towards(
    start: FloatArray, end: FloatArray, fraction: FloatArray
) -> FloatArray:
    """Return vectors ``(F, 3)`` of the end's length, rotated from start towards end.

    ``start`` ``(F, 3)``, not 0, ``end`` ``(F, 3)``, ``fraction`` of the angle ``(F,)``.

    >>> start, end = np.eye(3)[:1], 2 * np.eye(3)[1:2]
    >>> swing_towards(start, end, np.array([0.5])).round(6).tolist()
    [[1.414214, 1.414214, 0.0]]
    """
    length = np.linalg.norm(end, axis=1, keepdims=True)
    start_length = np.linalg.norm(start, axis=1, keepdims=True)
    unit_start = start / np.maximum(start_length, 1e-300)
    axis = np.cross(unit_start, end)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(sine[:, 0], (unit_start * end).sum(axis=1))
    # Opposite directions rotate about any perpendicular axis.
    smallest_components = np.abs(unit_start).argmin(axis=1)
    perpendicular_axis = np.cross(unit_start, np.eye(3)[smallest_components])
    axis = np.where(sine > MIN_DIRECTION * length, axis, perpendicular_axis)
    axis = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    rotation = so3.from_axis_angle(axis, fraction * angle)
    return np.asarray(length * so3.rotate(rotation, unit_start))


@dataclass(frozen=True)
class GoalTrack:
    """A goal and its targets over frames."""

    name: str  # name of the effector as the file spells it
    goal: Goal  # with all parts that are active at some time
    chain: IkChain | None  # the rig's chain whose tip it is; None for a plain joint
    # By part; None for unused parts, and for parts that are only held.
    values: Mapping[str, SampledValue | None]
    weights: Mapping[str, SampledValue]  # weights by part; missing parts have weight 1
    spans: tuple[Span, ...]  # held frames, ascending
    ease: float  # length of the ease before and after each span [frame]
    hold_parts: frozenset[str]  # the parts that the spans apply to
    # Line and column in the file; its first line if unknown.
    location: tuple[int, int] = (1, 1)
    # Spans in which the goal is active, ascending; empty for all frames.
    during: tuple[Span, ...] = ()

    @property
    def parts(self) -> list[str]:
        """Names of the parts with a value."""
        return [part for part, value in self.values.items() if value is not None]


@dataclass(frozen=True)
class TargetTracks:
    """The goals of a targets file.

    Attributes:
        path: The file.
        fps: Frames per second; None if unspecified.
        first: First frame; None if unspecified.
        last: Last frame; None if unspecified.
        goals: E goals.
        notices: Warnings about the file.
        rate_location: Line and column of its frame rate.
    """

    path: Path
    fps: Fraction | None
    first: Fraction | None
    last: Fraction | None
    goals: tuple[GoalTrack, ...]
    notices: tuple[Fault, ...] = ()
    rate_location: tuple[int, int] = (1, 1)

    @property
    def clock(self) -> Clock:
        """The frames of the file: its range, else from the first to the last mentioned.

        Raises:
            OptionError: There are more than 10 million (CLIP006).
        """
        first, last = self.first, self.last
        if first is None or last is None:
            mentioned_frames = [
                end for goal in self.goals for end in _mentioned_range(goal)
            ] or [1.0]
            first = Fraction(min(mentioned_frames))
            last = Fraction(max(mentioned_frames))
        frame_count = int((last - first) // 1) + 1
        if frame_count > MAX_FRAME_COUNT:
            message = (
                f"the range has {frame_count} frames; the limit is {MAX_FRAME_COUNT}"
            )
            raise OptionError(Fault("CLIP006", message, str(self.path)))
        return Clock(self.fps or DEFAULT_RATE, first, Fraction(1), frame_count)

    def at_clock(self, clock: Clock) -> TargetTracks:
        """Return the tracks with arrays that have no range aligned to a clock's start.

        Raises:
            OptionError: The clock has another rate (TGT014), or an array has another
                number of rows (TGT015).
        """
        faults = []
        if self.fps is not None and self.fps != clock.fps:
            message = f"the targets are at {rate_label(self.fps)}, the take at "
            hint = f"remove fps, or write fps: {clock.fps} and frames at that rate"
            message += rate_label(clock.fps)
            line, column = self.rate_location
            path_and_lines = str(self.path), (line,)
            faults.append(
                Fault("TGT014", message, *path_and_lines, hint, column=column)
            )
        frame_count = int((clock.count - 1) * clock.step // 1) + 1
        for track in self.goals:
            for value in track.values.values():
                if not isinstance(value, ArrayRows) or value.first is not None:
                    continue
                row_count = len(value.values)
                if row_count != frame_count:
                    row_text = counted(row_count, "row")
                    message = f"{value.name!r} has {row_text}, but the "
                    message += f"take has  {counted(frame_count, 'frame')}"
                    hint = "write range to tell which frames the rows are for"
                    faults.append(value.rows_fault(message, hint, str(self.path)))
        if faults:
            raise OptionError(faults)
        goals = []
        for track in self.goals:
            value_by_part = dict(track.values)
            for part, value in track.values.items():
                if isinstance(value, ArrayRows) and value.first is None:
                    value_by_part[part] = replace(value, first=clock.start)
            goals.append(replace(track, values=value_by_part))
        return replace(self, goals=tuple(goals))

    def sample(
        self,
        rig: Rig,
        clock: Clock,
        world: WorldTransforms,
        free: Sequence[WorldTransforms] = (),
    ) -> Targets:
        """Return the targets of every frame.

        Args:
            rig: Rig with the joints of the effectors.
            clock: F frames at the rate of the file.
            world: World transforms without the goals, at which parts without a value
                are held.
            free: World transforms without each goal: goals with ``during``
                spans fade from and to these. Empty uses ``world`` for all.

        Raises:
            OptionError: A frame has no row in an array (TGT015).
            FormatError: A prim's transform is not finite.
        """
        times = clock.times
        frames = SampleFrames(times, clock.fps)
        shape = (len(times), len(self.goals))
        values_by_field = {
            kind.targets_field: np.zeros((*shape, kind.value_type.value))
            for kind in GOAL_KINDS
        }
        for kind in GOAL_KINDS:
            if kind.is_rotation:
                values_by_field[kind.targets_field][..., 3] = 1.0
        weights = np.ones((*shape, len(GOAL_KINDS)))
        for goal_index, track in enumerate(self.goals):
            effector = FreeEffector(rig, track.goal, world)
            fading_effector = effector
            if free:
                fading_effector = FreeEffector(rig, track.goal, free[goal_index])
            active_weights = np.ones(len(times))
            if track.during:
                span_weights = hold_weights(times, track.during, track.ease)
                active_weights = span_weights.max(axis=0)
            for i, kind in enumerate(GOAL_KINDS):
                if not track.goal.weights[i]:
                    continue
                value, weight = _sample_part(track, kind, frames, effector)
                value = fading_effector.blend_from_free_motion(
                    kind, value, active_weights
                )
                values_by_field[kind.targets_field][:, goal_index] = value
                weights[:, goal_index, i] = weight * (active_weights > 0)
        return Targets(**values_by_field, weights=weights)


rename_attributes(TargetTracks, rate_place="rate_location")


def _sample_part(
    track: GoalTrack, kind: GoalKind, frames: SampleFrames, effector: FreeEffector
) -> tuple[FloatArray, FloatArray]:
    """Return targets ``(F, W)`` and weights ``(F,)`` of a part of a goal."""
    part = kind.name
    weight = np.ones(len(frames.times))
    if part in track.weights:
        # A curve of keys above 0 may dip below 0 between them.
        weight = np.maximum(track.weights[part].sample(frames)[:, 0], 0.0)
    value = track.values[part]
    if value is not None:
        curve_values = value.sample(frames)
    else:
        curve_values = (
            effector.orientation() if kind.is_rotation else effector.position()
        )
    if not track.spans or part not in track.hold_parts:
        return curve_values, weight
    span_weights = hold_weights(frames.times, track.spans, track.ease)
    hold_starts = np.array([first for first, _ in track.spans])
    if value is None:
        rows = np.interp(hold_starts, frames.times, np.arange(len(frames.times)))
        hold_values = interpolate_rows(curve_values, rows)
        weight = weight * span_weights.max(axis=0)
    else:
        hold_values = value.sample(replace(frames, times=hold_starts))
    return blend_holds(curve_values, span_weights, hold_values), weight


def _mentioned_range(track: GoalTrack) -> list[float]:
    """Return the ends of all spans, key ranges and arrays of a goal [frame]."""
    mentioned_frames = [end for span in (*track.spans, *track.during) for end in span]
    for value in (*track.values.values(), *track.weights.values()):
        if isinstance(value, KeyedValue):
            mentioned_frames += [value.channel.times[0], value.channel.times[-1]]
        elif isinstance(value, ArrayRows):
            first = 1.0 if value.first is None else float(value.first)
            mentioned_frames += [first, first + len(value.values) - 1]
    return mentioned_frames
