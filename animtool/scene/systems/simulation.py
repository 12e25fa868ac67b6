"""Builds the simulations of a scene's systems, in the order of their links."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import field, replace
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Any, cast

from animtool.core.arguments import argument
from animtool.core.errors import (
    AnimtoolError,
    Fault,
    FormatError,
    OptionError,
    ToleranceError,
    excerpt,
)
from animtool.core.plugins import load_object
from animtool.core.record import dataclass
from animtool.documents.document import Document
from animtool.rig.skeleton import Rig
from animtool.scene.bake.progress import Progress, ProgressPhases, TimeProgress
from animtool.scene.file.entries import SceneSystem
from animtool.scene.systems.character_motion import CharacterMotion, CharacterMotions
from animtool.scene.systems.links import (
    joined_groups,
    simulation_order,
    to_joined_entry,
)
from animtool.scene.systems.proportions import placement_warnings
from animtool.scene.systems.surroundings import Surroundings
from animtool.sim.colliders import Poses
from animtool.systems.framework.body_carriers import BodyCarrier
from animtool.systems.framework.kinds import SYSTEM_KINDS
from animtool.systems.framework.run import STEP_TOLERANCE, EntryRun, SimulationRun
from animtool.systems.framework.saved import StateClock, open_states
from animtool.systems.framework.simulation import (
    ChecksResumedState,
    HasEntryViews,
    SimContext,
    Simulation,
)
from animtool.systems.framework.spec import SystemSpec


@dataclass(frozen=True, slots=True)
class SystemProgress:
    """Progress callbacks of systems."""

    phases: ProgressPhases  # progress of work before the first frame
    times: TimeProgress  # of the simulation itself


@dataclass
class BuildContext:
    """State that the systems of a scene share while they are built."""

    last_time: float  # latest time that will be requested [s]
    # Characters in motion, each read once.
    characters: CharacterMotions = field(default_factory=CharacterMotions)
    # Built systems by name.
    runs_by_name: dict[str, EntryRun] = field(default_factory=dict)
    # Progress of the systems; None if it is not shown.
    progress: SystemProgress | None = None

    def phase(self) -> Progress:
        """Return the progress callback of work before the first frame."""
        return None if self.progress is None else self.progress.phases.phase()

    def clock(self, begin: float) -> Progress:
        """Return the callback by which a system reports its time."""
        return None if self.progress is None else self.progress.times.clock(begin)


@contextmanager
def located_systems(members: Sequence[SceneSystem]) -> Iterator[None]:
    """Locate faults of the block that name no file at one of the joined systems.

    The location is that of the first system with the key that a fault names, else of
    the first.
    """

    def attach_location(fault: Fault) -> Fault:
        locations = [member.location for member in members]
        keyed_locations = (
            location for location in locations if location.nearest_key(fault)
        )
        return next(keyed_locations, locations[0]).locate(fault)

    try:
        yield
    except OptionError as error:
        raise FormatError(list(map(attach_location, error.faults))) from error
    except ToleranceError as error:
        raise ToleranceError(list(map(attach_location, error.faults))) from error


def build_entries(
    members: Sequence[SceneSystem], context: BuildContext
) -> list[EntryRun]:
    """Return the runs of jointly simulated systems, at their start."""
    run = run_entries(members, context)
    for member in members:
        if member.setup.resume is not None:
            _resume(run, member)
            break
    if not isinstance(run.simulation, HasEntryViews):
        return [run]
    views = run.simulation.views
    return [
        EntryRun(member.name, run, view, reports_steps=not k)
        for k, (member, view) in enumerate(zip(members, views, strict=True))
    ]


def _resume(run: SimulationRun, member: SceneSystem) -> None:
    """Restore the state that a system resumes into a run (SIM035)."""
    path = member.setup.resume
    assert path is not None
    with _located_at_resume(member, path):
        _restore_state(run, member, path)


@contextmanager
def _located_at_resume(member: SceneSystem, path: Path) -> Iterator[None]:
    """Locate the faults of a state file at the system's key that names the file."""
    try:
        yield
    except (FormatError, OptionError) as error:
        faults = [
            _at_resume(fault, path.name) if fault.path == str(path) else fault
            for fault in error.faults
        ]
        raise FormatError(list(map(member.location.locate, faults))) from error


def check_resumed_states(
    systems: Sequence[SceneSystem],
    first: Fraction,
    last: Fraction | None,
    start: Fraction,
    fps: Fraction,
) -> None:
    """Refuse states of other kinds, and frames before a state (SIM035).

    The files are opened, but their states are not read.

    Args:
        systems: The systems of a scene.
        first: First requested time code.
        last: Last requested time code; None if unknown.
        start: Time code at 0 s.
        fps: Time codes in a second.
    """
    faults: list[Fault] = []
    for system in systems:
        path = system.setup.resume
        if path is None:
            continue
        try:
            with _located_at_resume(system, path):
                with open_states(path) as saved_states:
                    clock, step_count = saved_states.clock("", system.kind)
                seconds = clock.begin + clock.step * (step_count - STEP_TOLERANCE)
                # The last step may end a fraction of a frame before a saved frame.
                saved_frame = math.ceil(start + Fraction(seconds) * fps)
                if step_count and first < saved_frame:
                    fault = _early_frame_fault(saved_frame, first, last)
                    raise OptionError(fault.in_file(path))
        except FormatError as error:
            faults += error.faults
    if faults:
        raise FormatError(faults)


def _early_frame_fault(
    saved_frame: int, first: Fraction, last: Fraction | None
) -> Fault:
    """Return a fault of frames before a saved state."""
    message = f"its state starts at frame {saved_frame}, but frame {float(first):g} "
    message += "is requested"
    request = f"frames from {saved_frame} on"
    if last is not None and saved_frame <= last:
        request = argument("frame_range", f"{saved_frame}-{float(last):g}")
    hint = f"request {request}, or remove resume to simulate from frame "
    hint += f"{float(first):g}"
    return Fault("SIM035", message, hint=hint)


def _restore_state(run: SimulationRun, member: SceneSystem, path: Path) -> None:
    """Restore the state in a file into a run; raise SIM035 if they do not match."""
    with open_states(path) as saved_states:
        run.state = saved_states.read("", state_clock(member, run), run.state)
    if isinstance(run.simulation, ChecksResumedState):
        t = run.step_time(run.state.step_count)
        reason = run.simulation.incompatibility(run.state.state, t)
        if reason:
            message = f"its state does not match: {reason}"
            raise OptionError(Fault("SIM035", message, str(path)))


def _at_resume(fault: Fault, name: str) -> Fault:
    """Return a fault of a state file, moved to the key that names the file."""
    separator = " " if fault.message.startswith("is ") else ": "
    message = f"{excerpt(name)}{separator}{fault.message}"
    return replace(fault, path=None, message=message, where="resume")


def state_clock(member: SceneSystem, run: SimulationRun) -> StateClock:
    """Return the clock of a system's states: its kind, begin and step."""
    return StateClock(member.kind, run.begin, run.step_length)


def run_entries(
    members: Sequence[SceneSystem],
    context: BuildContext,
    spec_changes: Mapping[str, Any] | None = None,
    max_evaluations: int | None = None,
) -> SimulationRun:
    """Return the run of joined systems at their start; reads their characters.

    ``spec_changes`` replace values of their spec, by key.
    """
    setups = [member.setup for member in members]
    shared_values: dict[str, Any] = {}
    for setup in setups:
        shared_values |= setup.spec.shared()
    spec = setups[0].spec.model_copy(update={**shared_values, **(spec_changes or {})})
    start_time = -spec.preroll
    surroundings = Surroundings.of([setup.surroundings for setup in setups])
    colliders = surroundings.build(context.characters, context.runs_by_name)
    carrier_names = surroundings.carriers
    carriers = {
        name: context.runs_by_name[name].body_carriers() for name in carrier_names
    }

    def poses(carrier: Any) -> Poses:
        if isinstance(carrier, BodyCarrier):
            return carriers[carrier.system].start(carrier)
        poses_over_time: Poses = carrier.poses(context.characters)
        return poses_over_time

    build = cast(
        Callable[[SystemSpec, SimContext], Simulation[Any]],
        load_object(SYSTEM_KINDS[members[0].kind].build),
    )
    sim_context = SimContext(
        start_time,
        context.last_time,
        colliders,
        setups[0].entries,
        poses,
        max_evaluations,
        [to_joined_entry(member) for member in members],
        lambda: context.clock(start_time),
        context.phase,
        carriers,
    )
    simulation = build(spec, sim_context)
    name = " + ".join(member.name for member in members)
    step = getattr(simulation, "step_length", spec.step)
    run = SimulationRun(name, simulation, start_time, step)
    run.collide_with([*colliders.bodies, *carriers.values()])
    return run


def open_systems(
    systems: Sequence[SceneSystem],
    last_time: float = 0.0,
    character: CharacterMotion | None = None,
    progress: SystemProgress | None = None,
    warnings: list[Fault] | None = None,
    main_rig: Rig | None = None,
) -> list[EntryRun]:
    """Return the systems in their initial state, in order; the first frame is at 0 s.

    ``last_time`` is in seconds. Warnings about their initial state, and about their
    size and distance from a rig, are added to ``warnings``.
    """
    context = BuildContext(last_time, character_cache(character), progress=progress)
    built_systems = build_systems(systems, context)
    has_characters = main_rig is not None or context.characters.by_path
    if warnings is not None and has_characters:
        warnings += placement_warnings(systems, context.characters, main_rig)
    return built_systems


def build_systems(
    systems: Sequence[SceneSystem], context: BuildContext
) -> list[EntryRun]:
    """Build systems in their initial state, and record them in the context by name."""
    runs_by_index: dict[int, EntryRun] = {}
    faults: list[Fault] = []
    for group in simulation_order(systems):
        members = [systems[i] for i in group]
        needed_systems = [
            needed_system
            for member in members
            for needed_system in member.setup.surroundings.needed_systems
        ]
        if any(name not in context.runs_by_name for name, _ in needed_systems):
            continue
        try:
            with located_systems(members):
                runs = build_entries(members, context)
        except FormatError as error:
            faults += error.faults
            continue
        runs_by_index |= dict(zip(group, runs, strict=True))
        names = [member.name for member in members]
        context.runs_by_name |= dict(zip(names, runs, strict=True))
    if faults:
        raise FormatError(list(dict.fromkeys(faults)))
    return [runs_by_index[i] for i in sorted(runs_by_index)]


def build_faults(document: Document, systems: Sequence[SceneSystem]) -> list[Fault]:
    """Return the faults that occur when a scene's systems are built.

    Systems with known faults are skipped, with those that depend on them or are joined
    to them, and those that need the scene's own character.
    """
    faulty_keys = [fault.where or "" for fault in document.faults]
    if any(key_path.startswith("units") for key_path in faulty_keys):
        return []
    is_valid = [
        not any(key_path.startswith(system.location.where) for key_path in faulty_keys)
        and document.path not in system.setup.files
        for system in systems
    ]
    # Systems that are simulated together are left out together.
    groups = joined_groups(systems)
    valid_groups = [group for group in groups if all(is_valid[i] for i in group)]
    indices = sorted(chain.from_iterable(valid_groups))
    try:
        build_systems([systems[i] for i in indices], BuildContext(0.0))
    except FormatError as error:
        return [fault for fault in error.faults if fault.path == str(document.path)]
    except AnimtoolError:
        # Faults of other files are reported if the scene itself has none.
        return []
    return []


def character_cache(character: CharacterMotion | None) -> CharacterMotions:
    """Return the cache of characters, which contains the scene's own character."""
    characters = CharacterMotions()
    if character is not None:
        characters.by_path[character.path] = character
    return characters
