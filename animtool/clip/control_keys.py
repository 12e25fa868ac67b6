"""Solves the keys of controls from a take's joints and shapes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import replace

import numpy as np

from animtool.clip.coordinates import JointMotion, Tolerances, required_control_values
from animtool.clip.reduction.keys import ChannelKind, ReducedChannel
from animtool.clip.reduction.points import SHELL_DISTANCE, attached_points, point_errors
from animtool.clip.sample import sample_values
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths.fit import FittedKeys, evaluate_keys, fit_keys
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.rig.control_inverse import (
    SolvedControls,
    keys_of_controls,
    solve_controls,
)
from animtool.rig.controls import Control, evaluate_controls
from animtool.rig.driver_plan import plan_of
from animtool.rig.shapes import subtract_combinations
from animtool.rig.skeleton import Rig

# Fraction of the tolerance for control keys [1].
CONTROL_FRACTION = 0.5
# Number of frames at which a control's effect is probed.
PROBED_FRAMES = 8
# Number of refinements before a control gets a key at every frame.
MAX_REFINEMENTS = 12
# Relative difference of control values that counts as rounding.
RELATIVE_ROUNDING = 1e-11


def uncombined_weights_of(take: Take, rig: Rig) -> dict[str, FloatArray]:
    """Return shape weights ``(F or 1,)`` before combination shapes are added.

    The products that combination shapes get from their drivers are subtracted.
    """
    shape_names = [shape.name for shape in rig.shapes]
    weights = take.motion.weights
    weight_values = (
        np.zeros((1, len(shape_names))) if weights is None else weights.dense()[..., 0]
    )
    return subtract_combinations(
        rig.shapes, dict(zip(shape_names, weight_values.T, strict=True))
    )


def solve_take_controls(
    take: Take, rig: Rig, joints: Sequence[JointMotion], tolerances: Tolerances
) -> SolvedControls:
    """Return control values that reproduce a take.

    The search starts at the take's control values, or at the defaults if there are
    none.
    """
    frame_count, controls = take.motion.frames, keyable_controls(rig)
    take_controls = take.motion.controls
    start_by_control = {c.name: np.full(frame_count, c.default) for c in controls}
    defaults_by_control = dict(start_by_control)
    if take_controls is not None:
        start_by_control |= keys_of_control_channel(controls, take_controls)
    if rig.is_driven:
        start_by_control |= {
            name: defaults_by_control[name] for name in plan_of(rig).controls
        }
    start_targets = evaluate_controls(controls, start_by_control).targets
    goal_by_target, unreachable_targets = required_control_values(
        rig, joints, set(start_targets), start_targets, tolerances
    )
    weights_by_shape = uncombined_weights_of(take, rig)
    for shape, value in weights_by_shape.items():
        if f"shape/{shape}" in start_targets:
            goal_by_target[f"shape/{shape}"] = value
    goal_by_target = {
        t: np.broadcast_to(value, (frame_count,)) for t, value in goal_by_target.items()
    }
    tolerance_by_target = {
        target: tolerances.tolerance_of(target) for target in goal_by_target
    }
    solution = solve_controls(
        controls,
        goal_by_target,
        tolerance_by_target,
        start_by_control,
        keyed_targets=unreachable_targets,
    )
    values_by_control = {
        c.name: _snap_to_constant(solution.values[c.name], c.default) for c in controls
    }
    reset_names = () if take_controls is not None else solution.reset_names
    return SolvedControls(values_by_control, solution.solved_names, reset_names)


def keys_of_control_channel(
    controls: Sequence[Control], channel: Channel
) -> dict[str, FloatArray]:
    """Return the values of keys ``(F,)`` that produce a motion's control values."""
    value_columns = channel.dense()[..., 0].T
    values_by_control = {
        c.name: column for c, column in zip(controls, value_columns, strict=True)
    }
    return keys_of_controls(controls, values_by_control)


def keyable_controls(rig: Rig) -> Sequence[Control]:
    """Return a rig's controls without their drives of targets that cannot be keyed.

    Targets driven by joint coordinates, directly or indirectly, cannot be keyed.
    """
    if not rig.is_driven:
        return rig.controls
    plan = plan_of(rig)
    unkeyable_names = {
        *(f"shape/{n}" for n in plan.shapes),
        *(f"control/{n}" for n in plan.controls),
    }
    return [
        replace(
            control,
            drives=()
            if control.name in plan.controls
            else tuple(d for d in control.drives if d.target not in unkeyable_names),
        )
        for control in rig.controls
    ]


def _snap_to_constant(values: FloatArray, default: float) -> FloatArray:
    """Return values ``(F,)`` without rounding noise about the default or a constant."""
    tolerance = RELATIVE_ROUNDING * max(1.0, float(np.abs(values).max(initial=0.0)))
    values = np.where(np.abs(values - default) <= tolerance, default, values)
    is_constant = np.ptp(values) <= tolerance
    return np.full_like(values, values[0]) if is_constant else values


@dataclass(frozen=True, slots=True)
class FittedControls:
    """Sparse keys of the controls that differ from their defaults."""

    channels: list[ReducedChannel]  # one channel each, in the rig's order
    # Values of every control from its keys, by target ``(F or 1, 1)``.
    values: dict[str, FloatArray]
    sample_count: int  # number of samples of the moving channels

    @property
    def values_by_name(self) -> dict[str, FloatArray]:
        """Values of the keyed controls ``(F or 1,)`` by name."""
        return {n.removeprefix("control/"): v[:, 0] for n, v in self.values.items()}


def fit_controls(
    take: Take,
    rig: Rig,
    solved_by_control: Mapping[str, FloatArray],
    keyed_tracks: frozenset[tuple[ChannelKind, int]],
    bounds: FloatArray,
    weight_tolerance: float,
) -> FittedControls:
    """Return sparse keys of controls that move joints and shapes within tolerances.

    ``solved_by_control`` has the exact values of each control ``(F,)``; ``bounds``
    ``(J,)`` [m] and ``weight_tolerance`` [1] are the largest errors allowed.
    """
    default_by_name = {control.name: control.default for control in rig.controls}
    changed_by_control = {
        n: solved_by_control[n]
        for n in default_by_name
        if (solved_by_control[n] != default_by_name[n]).any()
    }
    moving_names = [
        n for n, values in changed_by_control.items() if (values != values[0]).any()
    ]
    control_errors = _ControlErrors(
        take, rig, solved_by_control, keyed_tracks, bounds, weight_tolerance
    )
    tolerance_by_name = {
        name: control_errors.initial_tolerance(name) for name in moving_names
    }
    keys_by_name: dict[str, FittedKeys] = {}
    values_by_target: dict[str, FloatArray] = {}
    for attempt in range(MAX_REFINEMENTS):
        keys_by_name = {
            name: fit_keys(column[:, None], tolerance_by_name[name])
            if name in tolerance_by_name
            else fit_keys(column[:1, None], 1.0)
            for name, column in changed_by_control.items()
        }
        frames = np.arange(take.motion.frames)
        values_by_target = {
            f"control/{n}": evaluate_keys(f, frames) for n, f in keys_by_name.items()
        }
        ratio = control_errors.error_ratio(values_by_target) if moving_names else 0.0
        if ratio <= CONTROL_FRACTION:
            break
        is_last = attempt >= MAX_REFINEMENTS - 2
        factor = 1e-9 if is_last else 0.8 * CONTROL_FRACTION / ratio
        tolerance_by_name = {
            n: max(t * factor, 1e-13) for n, t in tolerance_by_name.items()
        }
    channels = [
        ReducedChannel(f"control/{name}", None, keys_by_name[name])
        for name in changed_by_control
    ]
    return FittedControls(
        channels, values_by_target, take.motion.frames * len(moving_names)
    )


class _ControlErrors:
    """Measures the errors of a take that result from changed control values."""

    def __init__(
        self,
        take: Take,
        rig: Rig,
        solved_by_control: Mapping[str, FloatArray],
        keyed_tracks: frozenset[tuple[ChannelKind, int]],
        bounds: FloatArray,
        weight_tolerance: float,
    ) -> None:
        self.take, self.rig, self.keyed_tracks = take, rig, keyed_tracks
        self.exact_values = {
            f"control/{n}": v[:, None] for n, v in solved_by_control.items()
        }
        self.bounds, self.weight_tolerance = bounds, weight_tolerance
        self.points = attached_points(rig, SHELL_DISTANCE)

    def error_ratio(
        self, values_by_target: Mapping[str, FloatArray], frames: IntArray | None = None
    ) -> float:
        """Return the largest error that control values cause, over the tolerance."""
        take, rig = self.take, self.rig
        frame_indices = np.arange(take.motion.frames) if frames is None else frames
        times = take.clock.times[frame_indices]

        def motion_of(values_by_target: Mapping[str, FloatArray]) -> Motion:
            """Return the motion that control values cause in the frames."""
            selected_values = {
                name: value[frame_indices] if len(value) > 1 else value
                for name, value in values_by_target.items()
            }
            return sample_values(selected_values, rig, times).motion

        exact_motion = motion_of(self.exact_values)
        trial_motion = motion_of({**self.exact_values, **values_by_target})
        exact_pose = take.motion.select(frame_indices)
        driven_motion = driven_pose(
            exact_pose, trial_motion, exact_motion, self.keyed_tracks
        )
        worlds = [motion.world(take.rig) for motion in (exact_pose, driven_motion)]
        errors = point_errors(self.points, *worlds)
        ratio = float((errors / self.bounds).max(initial=0.0))
        weight_error = largest_weight_error(exact_motion, trial_motion)
        return max(ratio, weight_error / self.weight_tolerance)

    def initial_tolerance(self, name: str) -> float:
        """Return the initial tolerance of a control's keys."""
        values = self.exact_values[f"control/{name}"]
        increment = 1e-3 * float(np.ptp(values))
        frames = np.unique(
            np.linspace(0, len(values) - 1, PROBED_FRAMES).astype(np.int64)
        )
        ratio = self.error_ratio({f"control/{name}": values + increment}, frames)
        return CONTROL_FRACTION * increment / ratio if ratio > 0 else 1e-3 * increment


def largest_weight_error(motion: Motion, other_motion: Motion) -> float:
    """Return the largest difference of the shape weights of two motions [1]."""
    weights = [
        np.zeros((1, 1, 1)) if m.weights is None else m.weights.dense()
        for m in (motion, other_motion)
    ]
    return float(np.abs(weights[0] - weights[1]).max(initial=0.0))


def driven_pose(
    motion: Motion,
    fitted_motion: Motion,
    exact_motion: Motion,
    keyed_tracks: frozenset[tuple[ChannelKind, int]],
) -> Motion:
    """Return a motion whose control-driven joints follow the fitted controls."""
    motions = motion, fitted_motion, exact_motion
    keyed_translations, keyed_rotations = (
        {j for keyed_kind, j in keyed_tracks if keyed_kind is kind}
        for kind in (ChannelKind.TRANSLATION, ChannelKind.ROTATION)
    )
    return Motion(
        _with_moved_joints([m.translations for m in motions], keyed_translations),
        _with_moved_joints([m.rotations for m in motions], keyed_rotations),
        motion.scales,
        motion.weights,
    )


def _with_moved_joints(channels: Sequence[Channel], keyed_joints: Set[int]) -> Channel:
    """Return a take's channel with control-driven joints replaced.

    The channels are those of the take, of fitted and of exact controls.
    """
    take_channel, fitted_channel, exact_channel = channels
    moved_joints = {*fitted_channel.animated.tolist(), *exact_channel.animated.tolist()}
    replaced_joints = np.array(sorted(moved_joints - keyed_joints), np.int64)
    if not len(replaced_joints):
        return take_channel
    is_different = fitted_channel.gather(replaced_joints) != exact_channel.gather(
        replaced_joints
    )
    replaced_joints = replaced_joints[is_different.any(axis=(0, 2))]
    if not len(replaced_joints):
        return take_channel
    return take_channel.put(replaced_joints, fitted_channel.gather(replaced_joints))
