"""The pass ``simulate``, its report and its notices."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from animtool.core.errors import (
    Fault,
    OptionError,
    RefusalCollector,
    Severity,
    counted,
    listed,
    percent_text,
    warning,
)
from animtool.core.quantities import length_text, plain_number
from animtool.motion.motion import Motion
from animtool.motion.passes import FrameScope, Pass, PassContext, TakePart
from animtool.motion.take import TakeStream
from animtool.rig.kinematics import rest_size
from animtool.rig.mesh_sizes import MIN_SKELETON_JOINTS, mesh_size_texts
from animtool.rig.parts import AttachKind
from animtool.rig.skeleton import Rig
from animtool.sim.colliders import Colliders
from animtool.systems.attach.actor import AttachmentActor
from animtool.systems.attach.bodies import (
    AttachedBody,
    ChainBody,
    SurfaceBody,
    build_bodies,
    surface_defects,
)
from animtool.systems.attach.poses import CycleGap
from animtool.systems.attach.settings import SimulateOptions, option_checks
from animtool.systems.attach.simulation import (
    AttachSimulation,
    AttachState,
    LoopClosure,
    SavedFrame,
    state_name_and_clock,
)
from animtool.systems.framework.meter import VISIBLE_DEPTH
from animtool.systems.framework.run import ReachedState
from animtool.systems.framework.saved import open_states, write_states
from animtool.systems.springs.motion import piercing_notices

# Largest unreported ratio of strain to its limit [1].
STRAIN_TOLERANCE = 1.5
# Smallest reported rotation of a last joint that nothing follows [rad].
MIN_REPORTED_ANGLE = math.radians(0.1)
# Largest index of particles and triangles in a file.
MAX_INDEX = 1 << 31


def named_frame_notices(simulation: AttachSimulation) -> list[Fault]:
    """Return notices about frames that options name, after the take has ended.

    Frames missing in the take have no effect (SIM185). Frames before a resumed one are
    those of the take (SIM186).
    """
    options, resumed = simulation.options, simulation.resumed
    codes = simulation.visited_codes
    if not codes:
        return []
    frames_by_option = {"save_at": options.save_at, "teleports": options.teleports}
    if resumed is not None:
        frames_by_option["resume"] = (resumed.frame,)
    visited_codes, notices = set(codes), []
    for option, frames in frames_by_option.items():
        missing_frames = [
            f"{frame:g}" for frame in frames if frame not in visited_codes
        ]
        if missing_frames:
            noun = "frame" if len(missing_frames) == 1 else "frames"
            message = (
                f"{option} names {noun} {listed(missing_frames)}, but the take has "
            )
            message += f"{codes[0]:g} to {codes[-1]:g}"
            hint = "frames are time codes of the take"
            notices.append(warning("SIM185", message, hint))
    if resumed is not None and codes[0] < resumed.frame <= codes[-1]:
        frame = f"{resumed.frame:g}"
        message = f"it resumes from frame {frame}; earlier frames are as in the take"
        notices.append(Fault("SIM186", message, severity=Severity.NOTE))
    return notices


def attachment_report(actor: AttachmentActor) -> dict[str, object]:
    """Return the result of an attachment up to the current frame, by report key."""
    grid, target_strain = actor.grid, actor.settings.stretch
    status = "ok"
    if grid.max_strain > STRAIN_TOLERANCE * target_strain:
        status = "stretched"
    if grid.unresolved_count or grid.piercing.passed or grid.piercing.cut:
        # Particles stay inside a collider or passed through the cloth.
        status = "unresolved"
    return {
        "name": actor.body.name,
        "kind": actor.body.kind,
        "status": status,
        "particles": actor.body.network.count,
        "steps": actor.steps_per_frame,  # per frame
        "stretch": grid.max_strain,  # largest strain of a spring [1]
        "aimed": target_strain,  # [1]
        # Maximum numbers of particles at one time: in contact, left inside colliders,
        # passing through the cloth; and of edge pairs that pass through each other.
        "contacts": grid.max_contact_count,
        "unresolved": grid.unresolved_count,
        "passed": grid.piercing.passed,
        "cut": grid.piercing.cut,
        **actor.meter.values,
        "jumps": actor.teleport_count,
        "seconds": actor.seconds,
    }


def simulation_notices(simulation: AttachSimulation) -> list[Fault]:
    """Return all notices of a finished simulation."""
    notices = [_summary_notice(actor) for actor in simulation.actors]
    oversized_body, _ = _oversized_body(simulation.rig, simulation.bodies)
    if simulation.cycle_gap is not None:
        # Contacts and strains result from the jump of the character.
        notices.append(_no_cycle_warning(simulation.cycle_gap))
        return notices + named_frame_notices(simulation)
    for actor in simulation.actors:
        name = actor.body.name
        if actor.body is oversized_body:
            continue  # strain and contacts result from its size
        notices += _start_notices(actor) + _contact_warnings(actor)
        if isinstance(actor.body, ChainBody) and actor.body.has_free_tip:
            notices += _last_joint_notices(simulation, actor.body)
        is_surface = isinstance(actor.body, SurfaceBody)
        is_intact = is_surface and not actor.meter.pierced.value
        notices += piercing_notices(
            actor.grid.piercing, f"the cloth {name!r}", is_intact=is_intact
        )
        if is_surface:
            notices += actor.meter.notices(name)
    if simulation.loop_closure is not None:
        names = listed([actor.body.name for actor in simulation.actors])
        notices.append(_cycle_notice(names, simulation.loop_closure))
    return notices + named_frame_notices(simulation)


def _summary_notice(actor: AttachmentActor) -> Fault:
    """Return a note about steps, strain and contact of an attachment (SIM130)."""
    phrases = [
        f"{actor.body.name} takes {counted(actor.steps_per_frame, 'step')} per frame",
        f"springs stretch by up to {percent_text(actor.grid.max_strain)}",
    ]
    if actor.grid.max_contact_count:
        particles = counted(actor.grid.max_contact_count, "particle")
        phrases.append(f"up to {particles} in contact")
    if actor.meter.text:
        phrases.append(actor.meter.text)
    if actor.teleport_count:
        teleports = counted(actor.teleport_count, "teleport")
        phrases.append(f"it was moved with the character over {teleports}")
    return Fault("SIM130", "; ".join(phrases), severity=Severity.NOTE)


def _start_notices(actor: AttachmentActor) -> list[Fault]:
    """Return notices about the surface and the start pose of an attachment."""
    notices, name = [], actor.body.name
    defects = surface_defects(actor.body.network)
    if defects:
        message = f"{name}: {listed(defects)}; it is simulated as it is"
        notices.append(Fault("SIM106", message, severity=Severity.NOTE))
    return notices + actor.start_warnings


def _last_joint_notices(simulation: AttachSimulation, chain: ChainBody) -> list[Fault]:
    """Return a warning if nothing follows the rotation of a chain's last joint."""
    angle = simulation.last_joint_angles.get(chain.name, 0.0)
    if angle < MIN_REPORTED_ANGLE:
        return []
    joint = simulation.rig.joints[chain.joints[-1]].name
    message = (
        f"{chain.name}: joint {joint!r} rotates by up to {math.degrees(angle):.3g}°, "
        "but nothing follows: it has no tip, and no joint, skin or collider below it"
    )
    hint = "give the joint `tips` at the end of its bone, or add a joint below it"
    return [warning("SIM191", message, hint)]


def _contact_warnings(actor: AttachmentActor) -> list[Fault]:
    """Return warnings about strain and particles inside colliders (SIM131, SIM132)."""
    warnings, name, grid = [], actor.body.name, actor.grid
    target_strain = actor.settings.stretch
    if grid.max_strain > STRAIN_TOLERANCE * target_strain:
        strain = percent_text(grid.max_strain)
        message = f"{name}: springs stretch by up to {strain}, but "
        message += f"{100 * target_strain:g}% was the target"
        hint = "use a higher rate, or let it settle from a pose that it can hold"
        warnings.append(warning("SIM131", message, hint))
    if grid.unresolved_count:
        points = counted(grid.unresolved_count, "particle")
        message = f"{name}: {points} remain inside colliders"
        hint = "closing colliders leave them no way out"
        warnings.append(warning("SIM132", message, hint))
    return warnings


def _oversized_body(
    rig: Rig, bodies: Sequence[AttachedBody]
) -> tuple[AttachedBody | None, list[Fault]]:
    """Return the cloth that is in another unit than the rig, and a warning (RIG218)."""
    cloth = [body for body in bodies if body.kind == AttachKind.CLOTH]
    sizes = {
        body.name: float(np.linalg.norm(np.ptp(body.network.points, axis=0)))
        for body in cloth
    }
    rig_size = rest_size(rig)
    texts = mesh_size_texts(sizes, rig_size)
    # A ribbon may be small.
    is_small = max(sizes.values(), default=0.0) < rig_size
    if texts is None or is_small or len(rig.joints) < MIN_SKELETON_JOINTS:
        return None, []
    (body,) = [body for body in cloth if body.name == texts[0]]
    return body, [warning("RIG218", *texts[1:])]


def _no_cycle_warning(gap: CycleGap) -> Fault:
    """Return a warning about a character that jumps at the seam (SIM133)."""
    steps = [length_text(gap.step), length_text(gap.typical_step)]
    if gap.is_rotation:
        steps = [f"{gap.step:.3g}°", f"{gap.typical_step:.3g}°"]
    message = (
        f"the take is no cycle: its last frame is {length_text(gap.distance)} and "
    )
    message += f"{gap.angle:.3g}° from its first, and joint {gap.joint!r} jumps by "
    message += f"{steps[0]} at the seam, apart from the travel of the cycle, and by "
    message += f"{steps[1]} at most elsewhere"
    hint = "make it a cycle with the pass `loop` before this one, or set loop: false"
    return warning("SIM133", message, hint, "loop")


def _cycle_notice(names: str, loop_closure: LoopClosure) -> Fault:
    """Return a note or warning with the remaining gap of a cycle (SIM130, SIM133)."""
    times = counted(loop_closure.repeat_count, "time")
    message = f"{names}: the cycle was simulated {times}; "
    if loop_closure.is_steered:
        message += "it did not close by itself and was steered to the cycle before; "
    message += f"its ends differ by {plain_number(1000 * loop_closure.residual)} mm"
    visible_residual = VISIBLE_DEPTH if loop_closure.is_steered else 0.0
    if loop_closure.residual <= max(loop_closure.tolerance, visible_residual):
        return Fault("SIM130", message, severity=Severity.NOTE)
    message += f", but {1000 * loop_closure.tolerance:g} mm was requested"
    hint = "raise loop_repeats, or the ratio or drag of what oscillates irregularly"
    return warning("SIM133", message, hint)


def simulate(
    stream: TakeStream, options: SimulateOptions, context: PassContext
) -> TakeStream:
    """Simulate attachments of a rig through a take, block by block.

    Chains rotate their joints. Cloth and strands get points, which are written as point
    caches. Cloth and strands also collide with earlier named cloth that has
    self-contact, without affecting that cloth.

    Without a scene, characters, systems and meshes of the options are left out.
    """
    refusals = RefusalCollector()
    for name, check in option_checks(options).items():
        if name == "what" and not options.what:
            continue
        with refusals.collect():
            check()
    refusals.check()
    if not has_effect(options):
        return stream
    bodies = build_bodies(stream.rig, options.what)
    frame_duration = float(stream.step / stream.fps)
    world = Colliders(options.colliders)
    names_colliders = options.characters or options.systems or options.meshes
    if context.build_colliders is not None and names_colliders:
        lead = context.prepended_frames * frame_duration
        stream, world = context.build_colliders(stream, options, lead)
    simulation = AttachSimulation(
        stream,
        bodies,
        options,
        _load_states(bodies, options, context.folder),
        context.prepended_frames,
        context.progress,
        world,
    )
    stream.notices.extend(_oversized_body(stream.rig, bodies)[1])
    point_names = [body.mesh.name for body in bodies if isinstance(body, SurfaceBody)]
    return replace(
        stream,
        blocks=_blocks(simulation, stream, context),
        points=stream.points | set(point_names),
    )


def _blocks(
    simulation: AttachSimulation, stream: TakeStream, context: PassContext
) -> Iterator[Motion]:
    """Yield simulated blocks, then write states and collect notices."""
    yield from simulation.blocks(stream.blocks)
    if simulation.options.save and context.writes_files:
        write_states(context.folder / simulation.options.save, simulation.saved_states)
    stream.notices.extend(simulation_notices(simulation))
    stream.simulated.extend(map(attachment_report, simulation.actors))


def _load_states(
    bodies: Sequence[AttachedBody], options: SimulateOptions, folder: Path
) -> SavedFrame | None:
    """Return the latest saved states of a file; None without a file."""
    if options.resume is None:
        return None
    path = folder / options.resume
    states: dict[str, AttachState] = {}
    refusals = RefusalCollector()
    with open_states(path) as saved:
        # The single state of a system has no name.
        frames = [float(name.partition("/")[0]) for name in saved.names if name]
        if not frames:
            message = "it has no state of any frame"
            raise OptionError(Fault("SIM035", message, str(path)))
        frame = max(frames)
        for body in bodies:
            with refusals.collect():
                count = body.network.count
                start = AttachState(np.zeros((count, 3)), np.zeros((count, 3)))
                name_and_clock = state_name_and_clock(body, frame)
                state = saved.read(*name_and_clock, ReachedState(0, start)).state
                passages = state.passages
                if (abs(passages) > MAX_INDEX).any() or (passages[:, 0] >= count).any():
                    message = (
                        f"{body.name} has passages with an index that no cloth has"
                    )
                    raise OptionError(Fault("SIM035", message, str(path)))
                states[body.name] = state
    refusals.check()
    return SavedFrame(frame, states)


def has_effect(options: SimulateOptions) -> bool:
    """Return whether anything is simulated with a weight above 0."""
    weight = options.weight
    keys = [(0.0, weight)] if isinstance(weight, (int, float)) else weight
    # Between keys of weight 0 the weight is 0 too.
    return bool(options.what) and any(value for _, value in keys)


PASS = Pass(
    "simulate",
    "Simulate chains, cloth and strands of the rig",
    SimulateOptions,
    FrameScope.WINDOW,
    simulate,
    option_checks,
    reads=frozenset({TakePart.RIG, TakePart.JOINTS, TakePart.SHAPES, TakePart.CLOCK}),
    changes=frozenset({TakePart.JOINTS, TakePart.POINTS}),
    needs_preroll=True,
    reports_progress=True,
)
