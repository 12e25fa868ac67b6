"""The last segment of a rope or strand over the frames of a take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, OptionError, listed
from animtool.core.names import name_hint
from animtool.core.units import UpAxis, up_from_up
from animtool.maths import so3
from animtool.motion.take import Take
from animtool.scene.bake.progress import Progress
from animtool.scene.file.entries import SceneSystem
from animtool.scene.systems.character_motion import motion_from_take
from animtool.scene.systems.links import with_dependencies
from animtool.scene.systems.simulation import located_systems, open_systems
from animtool.systems.framework.run import EntryRun
from animtool.systems.springs.drawing import CurveShape
from animtool.systems.springs.pins import particle_indices
from animtool.systems.springs.view import SpringView


def segments_of(
    systems: Sequence[SceneSystem],
    path: Path,
    take: Take,
    name: str,
    particle: str,
    progress: Progress = None,
    lead_seconds: float = 0.0,
) -> FloatArray:
    """Return positions of a particle of a rope and of its predecessor.

    The predecessor is first: ``(F, 2, 3)`` [m]. The system and its dependencies are
    simulated over the frames of the take, which is the scene's own character. The first
    frame is held for ``lead`` [s].
    """
    index = _system_index(systems, name)
    system_indices = with_dependencies(systems, [index])
    character = motion_from_take(path, take)
    times = character.times + lead_seconds
    character = replace(character, times=times)
    simulated_systems = [systems[i] for i in system_indices]
    running_systems = open_systems(simulated_systems, float(times[-1]), character)
    system_run = running_systems[system_indices.index(index)]
    particles = _segment_particles(_spring_view(system_run, name), name, particle)
    segment_positions = []
    for k, t in enumerate(times.tolist()):
        with located_systems([systems[index]]):
            state, _ = system_run.run.sample(t)
        segment_positions.append(state.motion[0, particles])
        if progress is not None:
            progress((k + 1) / len(times))
    segments = np.array(segment_positions)
    rotation = up_from_up(take.rig.up, UpAxis.Y)
    return segments if rotation is None else so3.rotate(np.array(rotation), segments)


def _system_index(systems: Sequence[SceneSystem], name: str) -> int:
    names = [system.name for system in systems]
    if names.count(name) == 1:
        return names.index(name)
    message = f"unknown system {name!r}"
    hint = name_hint(name, names) or f"the scene has {listed(names)}"
    if name in names:
        message, hint = f"several systems are named {name!r}", "rename one of them"
    if not names:
        hint = "add a rope under `systems`"
    raise OptionError(Fault("SIM192", message, where="system", hint=hint))


def _spring_view(entry_run: EntryRun, name: str) -> SpringView:
    """Return the spring simulation of a rope or strands, shared if they are joined."""
    view = entry_run.simulation
    if isinstance(view, SpringView) and isinstance(view.body.shape, CurveShape):
        return view
    message = f"{name!r} has no segments to attach to"
    hint = "use a rope or strands"
    raise OptionError(Fault("SIM192", message, where="system", hint=hint))


def _segment_particles(view: SpringView, name: str, particle: str) -> IntArray:
    """Return the indices of a particle's predecessor and of the particle ``(2,)``."""
    body = view.body
    is_number = particle.strip().removeprefix("-").isdecimal()
    names = [int(particle) if is_number else particle]
    particles, faults = particle_indices(names, body)
    if faults or len(particles) != 1:
        message = f"{name!r} has {len(particles)} particles {particle!r}, not one"
        if faults:
            message = f"{name!r} has no particle {particle!r}"
        hint = f"write one of {', '.join(body.regions)}, or a number"
        raise OptionError(Fault("SIM192", message, where="particle", hint=hint))
    shape = cast(CurveShape, body.shape)
    starts = np.cumsum([0, *shape.counts.tolist()])
    previous_particle = particles[0] + 1 if particles[0] in starts else particles[0] - 1
    return np.asarray(view.rows[[previous_particle, particles[0]]], np.int64)
