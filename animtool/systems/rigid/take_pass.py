"""The pass `ragdoll`: lets a rig fall as a ragdoll, starting at a given frame."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError, Severity, counted, warning
from animtool.core.options import range_faults, ranges_of
from animtool.core.units import UpAxis
from animtool.maths import so3
from animtool.motion.frames import TransformsFrame
from animtool.motion.motion import Channel
from animtool.motion.passes import OptionChecks, Pass, PassContext, Scope, TakePart
from animtool.motion.take import Take
from animtool.rig.joints import (
    LocalTransforms,
    coordinate_slices,
    coordinates_from_local,
)
from animtool.rig.kinematics import WorldTransforms, forward_kinematics
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import JointType
from animtool.sim.colliders import Collider, Colliders
from animtool.systems.framework.run import ReachedState, SimulationRun
from animtool.systems.rigid.ragdoll import (
    Ragdoll,
    RagdollOptions,
    bodies_of_rig,
    joints_of_rig,
)
from animtool.systems.rigid.ragdoll_motion import (
    DriveTargets,
    ragdoll_simulation,
    ragdoll_speeds,
    ragdoll_transforms,
)
from animtool.systems.rigid.shared import RigidState

# Overshoot of joint limits that is tolerated [rad].
ANGLE_TOLERANCE = math.radians(1.0)
SLIDE_TOLERANCE = 0.001  # the same for prismatic joints [m]


def ragdoll(take: Take, options: RagdollOptions, context: PassContext) -> Take:
    """Return a take whose rig falls as a ragdoll, starting at a given frame.

    Args:
        take: A take with a rig that has colliders.
        options: Frames of the fall, and parameters of the ragdoll.
        context: Receives the progress and the notices.
    """
    _check(options)
    clock, rig = take.clock, take.rig
    codes = np.array([float(clock.start + clock.step * k) for k in range(clock.count)])
    times = (codes - codes[0]) / float(clock.fps)
    first_index = _index(options.start, codes, "start", 0)
    last_index = _index(options.end, codes, "end", clock.count - 1)
    if first_index == clock.count - 1 and options.end is None:
        return take
    if last_index <= first_index:
        message = f"end is frame {codes[last_index]:g}, which is not after start, "
        message += f"{codes[first_index]:g}"
        raise OptionError(Fault("SIM062", message, where="end"))
    translations, rotations, scales = take.motion.dense()
    world = forward_kinematics(rig, translations, rotations, scales)
    pose = WorldTransforms(
        world.positions[first_index : first_index + 1],
        world.linear[first_index : first_index + 1],
    )
    bodies = bodies_of_rig(rig, pose, options)
    coordinates = coordinates_from_local(rig, LocalTransforms(translations, rotations))
    targets = DriveTargets(
        bodies, times - times[first_index], coordinates, coordinate_slices(rig)
    )
    shifted_colliders = [
        _shifted_in_time(collider, float(times[first_index]))
        for collider in options.colliders
    ]
    speeds = ragdoll_speeds(bodies, world, times, first_index)
    run = _run(bodies, options, targets, speeds, Colliders(shifted_colliders))
    origins, frame_rotations = [], []
    for k in range(first_index, clock.count):
        frame = run.at(float(times[k] - times[first_index]))
        assert isinstance(frame, TransformsFrame)
        origins.append(frame.points)
        frame_rotations.append(frame.rotations)
        if context.progress is not None:
            context.progress((k + 1 - first_index) / (clock.count - first_index))
    fallen = ragdoll_transforms(
        bodies,
        np.array(origins),
        np.array(frame_rotations),
        translations[first_index:],
        rotations[first_index:],
    )
    weights = _weights(codes, first_index, last_index, options)[first_index:]
    blended = [translations.copy(), rotations.copy()]
    blended[0][first_index:] += weights[:, None, None] * (
        fallen[0] - translations[first_index:]
    )
    blended[1][first_index:] = so3.slerp(
        rotations[first_index:],
        so3.align_signs(fallen[1], rotations[first_index]),
        np.broadcast_to(weights[:, None], fallen[1].shape[:2]),
    )
    motion = replace(
        take.motion,
        translations=Channel.from_dense(blended[0]),
        rotations=Channel.from_dense(so3.align_signs(blended[1])),
    )
    context.notices.extend(_notices(bodies, run, fallen, float(codes[first_index])))
    return replace(take, motion=motion)


def _shifted_in_time(collider: Collider, t: float) -> Collider:
    """Return a collider with its sample times shifted so that ``t`` [s] becomes 0."""
    poses = collider.poses
    if len(poses.sample_times) == 1:
        return collider
    return replace(collider, poses=replace(poses, times=poses.sample_times - t))


def _run(
    bodies: Ragdoll,
    options: RagdollOptions,
    targets: DriveTargets,
    start: FloatArray,
    colliders: Colliders,
) -> SimulationRun:
    down = [0.0, -options.gravity, 0.0]
    if bodies.rig.up is UpAxis.Z:
        down = [0.0, 0.0, -options.gravity]
    simulation = ragdoll_simulation(
        bodies,
        joints_of_rig(bodies, options, targets),
        colliders,
        down,
        "ragdoll",
        step=options.step,
        substeps=options.substeps,
        iterations=32,
    )
    initial_state = simulation.initial()
    motion = initial_state.motion.copy()
    motion[:, 7:13] = start
    state: ReachedState[RigidState] = ReachedState(
        0, replace(initial_state, motion=motion)
    )
    return SimulationRun("ragdoll", simulation, 0.0, options.step, state)


def _weights(
    codes: FloatArray, first: int, last: int, options: RagdollOptions
) -> FloatArray:
    """Return blend weights of the fall by frame ``(F,)``, eased at both ends."""

    def ramp(frames: FloatArray) -> FloatArray:
        linear = np.clip(frames / options.blend, 0, 1) if options.blend else frames >= 0
        fraction = np.asarray(linear, np.float64)
        return fraction * fraction * (3 - 2 * fraction)

    rise_weights = ramp(codes - codes[first])
    if options.end is None:
        return rise_weights
    return np.asarray(rise_weights * (1 - ramp(codes - codes[last])))


def _index(frame: float | None, codes: FloatArray, option: str, default: int) -> int:
    if frame is None:
        return default
    matches = np.flatnonzero(np.abs(codes - frame) < 1e-6)
    if not len(matches):
        message = f"{option} is frame {frame:g}, but the take has {codes[0]:g} to "
        raise OptionError(Fault("SIM062", f"{message}{codes[-1]:g}", where=option))
    return int(matches[0])


def _notices(
    bodies: Ragdoll,
    run: SimulationRun,
    fallen: tuple[FloatArray, FloatArray],
    begin: float,
) -> list[Fault]:
    """Return the notices of a run, with the joint limit that was exceeded most.

    Args:
        bodies: The ragdoll.
        run: Its simulation.
        fallen: Local translations ``(F, J, 3)`` and rotations ``(F, J, 4)`` of all
            joints in the fall.
        begin: First frame of the fall.
    """
    rig = bodies.rig
    mass = float(bodies.bodies.masses.sum())
    message = f"{counted(len(bodies.joints), 'body', 'bodies')} of {mass:.3g} kg "
    message += f"fell from frame {begin:g} on"
    worst_excess, name, text = 0.0, "", ""
    coordinates = coordinates_from_local(rig, LocalTransforms(*fallen))
    joints_with_parent = bodies.joints[bodies.above >= 0].tolist()
    for j, coordinate in enumerate(coordinate_slices(rig)):
        limits, values = rig.joints[j].limits, coordinates[:, coordinate]
        if j not in joints_with_parent or limits is None:
            continue
        if isinstance(limits, RangeLimit):
            values = values[:, 0]
        overshoot = float(np.abs(limits.excess(values)).max(initial=0.0))
        slides = rig.joints[j].type is JointType.PRISMATIC
        excess = overshoot / (SLIDE_TOLERANCE if slides else ANGLE_TOLERANCE)
        if excess > worst_excess:
            worst_excess, name = excess, rig.joints[j].name
            overshoot_text = (
                f"{1000 * overshoot:.2g} mm"
                if slides
                else f"{math.degrees(overshoot):.2g}°"
            )
            text = f"joint {name!r} exceeds its limits by {overshoot_text}"
    if text:
        message += f"; {text}, the most of all"
    notices = [Fault("SIM128", message, severity=Severity.NOTE)]
    if worst_excess > 1:
        hint = "use shorter steps, or a pose within the limits at `start`"
        notices.append(warning("SIM129", text, hint))
    return notices + [notice for notice in run.notices if notice.code != "SIM126"]


def _check(options: RagdollOptions, name: str = "") -> None:
    faults = [fault for fault in range_faults(options) if name in ("", fault.where)]
    if faults:
        raise OptionError(faults)


def _checks(options: RagdollOptions) -> OptionChecks:
    return {name: partial(_check, options, name) for name in ranges_of(RagdollOptions)}


PASS = Pass(
    "ragdoll",
    "Let the rig fall from a frame on, as rigid bodies of its colliders",
    RagdollOptions,
    Scope.CLIP,
    ragdoll,
    _checks,
    reads=frozenset({TakePart.RIG, TakePart.JOINTS, TakePart.CLOCK}),
    changes=frozenset({TakePart.JOINTS}),
    tells=True,
)
