"""The pass `ragdoll`: lets a rig fall, starting at a given frame."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError, Severity, counted, warning
from animtool.core.options import range_faults, ranges_of
from animtool.core.quantities import angle_text, length_text, plain_number
from animtool.core.units import UpAxis
from animtool.maths import so3
from animtool.motion.frames import TransformsFrame
from animtool.motion.motion import Channel, Motion
from animtool.motion.passes import FrameScope, OptionChecks, Pass, PassContext, TakePart
from animtool.motion.take import Take
from animtool.rig.joints import (
    LocalTransforms,
    coordinate_slices,
    project_to_coordinates,
)
from animtool.rig.kinematics import WorldTransforms, forward_kinematics
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import JointType, Rig
from animtool.sim.colliders import Capsule, Collider, Colliders
from animtool.systems.framework.run import ReachedState, SimulationRun
from animtool.systems.rigid.ragdoll import (
    Ragdoll,
    RagdollOptions,
    build_ragdoll,
    build_ragdoll_joints,
)
from animtool.systems.rigid.ragdoll_motion import (
    DriveTargets,
    ragdoll_simulation,
    ragdoll_transforms,
    ragdoll_velocities,
)

# Tolerated overshoot of joint limits [rad].
ANGLE_TOLERANCE = math.radians(1.0)
SLIDE_TOLERANCE = 0.001  # the same for prismatic joints [m]
# Denser than the densest metal, 22 600 [kg/m³].
MAX_DENSITY = 30000.0
# Bodies that fall farther below the take's motion have left the picture [m].
MIN_FALL = 2.0
# Bodies that are completely inside a collider, and deeper, are there by mistake [m].
MIN_DEPTH = 0.02


def apply_ragdoll(take: Take, options: RagdollOptions, context: PassContext) -> Take:
    """Return a take whose rig falls as a ragdoll, starting at a given frame.

    Args:
        take: A take with a rig that has colliders.
        options: Frames of the fall, and parameters of the ragdoll.
        context: Receives the progress and the notices.
    """
    _check_ranges(options)
    clock, rig = take.clock, take.rig
    frames = np.array([float(clock.start + clock.step * k) for k in range(clock.count)])
    times = (frames - frames[0]) / float(clock.fps)
    first_index = _frame_index(options.start, frames, "start", 0)
    last_index = _frame_index(options.end, frames, "end", clock.count - 1)
    if first_index == clock.count - 1 and options.end is None:
        if options.start is None:
            return take
        message = f"start is {frames[-1]:g}, the last frame, so nothing falls"
        hint = _start_hint(frames)
        raise OptionError(Fault("SIM062", message, hint=hint, where="start"))
    if last_index <= first_index:
        message = f"end is {frames[last_index]:g}, which is not after start, "
        message += f"{frames[first_index]:g}"
        raise OptionError(Fault("SIM062", message, where="end"))
    translations, rotations, scales = take.motion.dense()
    world = forward_kinematics(rig, translations, rotations, scales)
    frame_slice = slice(first_index, first_index + 1)
    pose = WorldTransforms(world.positions[frame_slice], world.linear[frame_slice])
    ragdoll = build_ragdoll(rig, pose, options)
    coordinates = project_to_coordinates(rig, LocalTransforms(translations, rotations))
    drive_times, slices = times - times[first_index], coordinate_slices(rig)
    targets = DriveTargets(ragdoll, drive_times, coordinates, slices)
    velocities = ragdoll_velocities(ragdoll, world, times, first_index)
    start_time = float(times[first_index])
    colliders = Colliders(
        [_shift_times(collider, start_time) for collider in options.colliders]
    )
    run = _start_run(ragdoll, options, targets, velocities, colliders)
    origins, frame_rotations = [], []
    for k in range(first_index, clock.count):
        bodies = run.at(float(times[k] - times[first_index]))
        assert isinstance(bodies, TransformsFrame)
        origins.append(bodies.points)
        frame_rotations.append(bodies.rotations)
        if context.progress is not None:
            context.progress((k + 1 - first_index) / (clock.count - first_index))
    fall_transforms = ragdoll_transforms(
        ragdoll,
        np.array(origins),
        np.array(frame_rotations),
        translations[first_index:],
        rotations[first_index:],
    )
    weights = _blend_weights(frames, first_index, last_index, options)[first_index:]
    blended_channels = [translations.copy(), rotations.copy()]
    changes = fall_transforms[0] - translations[first_index:]
    blended_channels[0][first_index:] += weights[:, None, None] * changes
    blended_channels[1][first_index:] = so3.slerp(
        rotations[first_index:],
        so3.align_signs(fall_transforms[1], rotations[first_index]),
        np.broadcast_to(weights[:, None], fall_transforms[1].shape[:2]),
    )
    motion = replace(
        take.motion,
        translations=Channel.from_dense(blended_channels[0]),
        rotations=Channel.from_dense(so3.align_signs(blended_channels[1])),
    )
    context.notices.extend(_start_notices(ragdoll, colliders, options.mass))
    if options.end is None and not len(colliders):
        context.notices.extend(_free_fall_notices(rig, world, motion, frames))
    first_frame = float(frames[first_index])
    context.notices.extend(_run_notices(ragdoll, run, fall_transforms, first_frame))
    return replace(take, motion=motion)


def _shift_times(collider: Collider, t: float) -> Collider:
    """Return a collider with its sample times shifted so that ``t`` [s] becomes 0."""
    poses = collider.poses
    if poses.is_fixed:
        return collider
    return replace(collider, poses=replace(poses, times=poses.sample_times - t))


def _start_run(
    ragdoll: Ragdoll,
    options: RagdollOptions,
    targets: DriveTargets,
    velocities: FloatArray,
    colliders: Colliders,
) -> SimulationRun:
    """Return the simulation run of a ragdoll, with initial velocities ``(N, 6)``."""
    gravity = [0.0, -options.gravity, 0.0]
    if ragdoll.rig.up is UpAxis.Z:
        gravity = [0.0, 0.0, -options.gravity]
    simulation = ragdoll_simulation(
        ragdoll,
        build_ragdoll_joints(ragdoll, options, targets),
        colliders,
        gravity,
        "ragdoll",
        step=options.step,
        substeps=options.substeps,
        iterations=32,
    )
    initial_state = simulation.initial_state()
    motion = initial_state.motion.copy()
    motion[:, 7:13] = velocities
    state = ReachedState(0, replace(initial_state, motion=motion))
    return SimulationRun("ragdoll", simulation, 0.0, options.step, state)


def _blend_weights(
    frames: FloatArray, first_index: int, last_index: int, options: RagdollOptions
) -> FloatArray:
    """Return blend weights of the fall by frame ``(F,)``, smooth at both ends."""

    def smooth_ramp(frames: FloatArray) -> FloatArray:
        ramp = np.clip(frames / options.blend, 0, 1) if options.blend else frames >= 0
        fraction = np.asarray(ramp, np.float64)
        return fraction * fraction * (3 - 2 * fraction)

    rise_weights = smooth_ramp(frames - frames[first_index])
    if options.end is None:
        return rise_weights
    return np.asarray(rise_weights * (1 - smooth_ramp(frames - frames[last_index])))


def _frame_index(
    frame: float | None, frames: FloatArray, option: str, default: int
) -> int:
    """Return the index of a frame of an option; raise SIM062 if it is missing."""
    if frame is None:
        return default
    matching_indices = np.flatnonzero(np.abs(frames - frame) < 1e-6)
    if not len(matching_indices):
        message = f"{option} is {frame:g}, but the take has frames {frames[0]:g} to "
        message += f"{frames[-1]:g}"
        hint = _start_hint(frames) if option == "start" else None
        raise OptionError(Fault("SIM062", message, hint=hint, where=option))
    return int(matching_indices[0])


def _start_hint(frames: FloatArray) -> str | None:
    """Return a hint with the frames at which a fall may start."""
    if len(frames) < 2:
        return None
    return f"write a frame from {frames[0]:g} to {frames[-2]:g}"


def _start_notices(
    ragdoll: Ragdoll, colliders: Colliders, mass: float | None
) -> list[Fault]:
    """Return warnings about a mass in grams, and about bodies inside colliders.

    ``mass`` [kg] is the requested one (SIM126, SIM200).
    """
    notices = []
    volume = sum(
        math.pi * shape.radius**2 * (4 / 3 * shape.radius + shape.length)
        for kind in ragdoll.bodies.kinds
        for shape, _, _ in kind.shapes
        if isinstance(shape, Capsule)
    )
    if mass is not None and mass > MAX_DENSITY * volume:
        message = f"mass {mass:g} is {mass:g} kg: the colliders of the rig would have "
        message += f"{plain_number(mass / volume)} kg/m³"
        hint = f"for {mass:g} g write {mass / 1000:g}"
        notices.append(warning("SIM200", message, hint, "mass"))
    depths = np.zeros((len(ragdoll.joints), len(colliders)))
    body_poses = zip(ragdoll.bodies.kinds, ragdoll.bodies.poses, strict=True)
    for i, (kind, poses) in enumerate(body_poses if len(colliders) else ()):
        pose = poses.at(0.0)
        cores = [core.transformed(pose[:3], pose[3:]) for core in kind.cores]
        gaps = [
            colliders.sample(core.points, 0.0).distances + core.radius for core in cores
        ]
        # Only a body without any point outside is inside.
        depths[i] = -np.concatenate(gaps, axis=1).max(axis=1)
    (inside_indices,) = np.nonzero((depths > MIN_DEPTH).any(axis=1))
    if not len(inside_indices):
        return notices
    collider_index = int(depths.max(axis=0).argmax())
    count_text = (
        f"{len(inside_indices)} of {counted(len(ragdoll.joints), 'body', 'bodies')}"
    )
    message = (
        f"{count_text} start wholly inside {colliders.label(collider_index)}, up to "
    )
    message += f"{length_text(float(depths.max()))} deep, and are pushed out"
    hint = "move it away from the rig; the ground is usually at 0"
    return [*notices, warning("SIM126", message, hint, f"colliders[{collider_index}]")]


def _free_fall_notices(
    rig: Rig, world: WorldTransforms, motion: Motion, frames: FloatArray
) -> list[Fault]:
    """Return a warning about a body that falls far below its motion (SIM201).

    ``world`` is the take without the fall, ``motion`` with it; ``frames`` are frame
    numbers ``(F,)``.
    """
    up = np.array(rig.up.vector, np.float64)
    last_frame = motion.select(slice(motion.frames - 1, motion.frames))
    translations, rotations, scales = last_frame.dense()
    end_height = (
        forward_kinematics(rig, translations, rotations, scales).positions[0] @ up
    )
    min_height = float((world.positions @ up).min())
    if min_height - end_height.max() < MIN_FALL:
        return []
    message = "there are no colliders: the body falls freely, to "
    message += f"{rig.up.lower()} = {end_height.max():.3g} m at frame {frames[-1]:g}"
    plane = "" if rig.up is UpAxis.Y else "normal: [0, 0, 1]"
    hint = f"add a floor: colliders: [{{shape: {{plane: {{{plane}}}}}}}]"
    return [warning("SIM201", message, hint)]


def _run_notices(
    ragdoll: Ragdoll,
    run: SimulationRun,
    fall_transforms: tuple[FloatArray, FloatArray],
    first_frame: float,
) -> list[Fault]:
    """Return the notices of a run, with the joint that exceeds its limits most.

    ``fall_transforms`` are local translations ``(F, J, 3)`` and rotations ``(F, J, 4)``
    of all joints in the fall, which begins at ``first_frame``.
    """
    rig = ragdoll.rig
    mass = float(ragdoll.bodies.masses.sum())
    message = f"{counted(len(ragdoll.joints), 'body', 'bodies')} of "
    message += f"{plain_number(mass)} kg fell from frame {first_frame:g} on"
    worst_excess, worst_joint, worst_text = 0.0, "", ""
    coordinates = project_to_coordinates(rig, LocalTransforms(*fall_transforms))
    joints_with_parent = ragdoll.joints[ragdoll.parent_bodies >= 0].tolist()
    for j, coordinate_slice in enumerate(coordinate_slices(rig)):
        limits, values = rig.joints[j].limits, coordinates[:, coordinate_slice]
        if j not in joints_with_parent or limits is None:
            continue
        if isinstance(limits, RangeLimit):
            values = values[:, 0]
        overshoot = float(np.abs(limits.excess(values)).max(initial=0.0))
        is_prismatic = rig.joints[j].type is JointType.PRISMATIC
        excess = overshoot / (SLIDE_TOLERANCE if is_prismatic else ANGLE_TOLERANCE)
        if excess > worst_excess:
            worst_excess, worst_joint = excess, rig.joints[j].name
            if is_prismatic:
                overshoot_text = length_text(overshoot, 2)
            else:
                overshoot_text = angle_text(math.degrees(overshoot), 2)
            worst_text = f"joint {worst_joint!r} exceeds its limits by {overshoot_text}"
    if worst_text:
        message += f"; {worst_text}, the most of all"
    notices = [Fault("SIM128", message, severity=Severity.NOTE)]
    if worst_excess > 1:
        hint = "use shorter steps, or a pose within the limits at `start`"
        notices.append(warning("SIM129", worst_text, hint))
    return notices + [notice for notice in run.notices if notice.code != "SIM126"]


def _check_ranges(options: RagdollOptions, option: str = "") -> None:
    """Raise all faults in the options, or only those of the named option."""
    faults = [fault for fault in range_faults(options) if option in ("", fault.where)]
    has_density = options.density != RagdollOptions().density
    if option in ("", "density") and options.mass is not None and has_density:
        message = "a ragdoll has both a mass and a density"
        faults.append(Fault("SIM062", message, hint="keep one", where="density"))
    if faults:
        raise OptionError(faults)


def _range_checks(options: RagdollOptions) -> OptionChecks:
    """Return the checks of the options, by option."""
    return {
        name: partial(_check_ranges, options, name)
        for name in ranges_of(RagdollOptions)
    }


PASS = Pass(
    "ragdoll",
    "Let the rig fall from a frame on, as rigid bodies of its colliders",
    RagdollOptions,
    FrameScope.CLIP,
    apply_ragdoll,
    _range_checks,
    reads=frozenset({TakePart.RIG, TakePart.JOINTS, TakePart.CLOCK}),
    changes=frozenset({TakePart.JOINTS}),
    reports_progress=True,
)
