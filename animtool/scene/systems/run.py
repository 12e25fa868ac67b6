"""Simulates systems over the frames of an output, after a tear pre-pass."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from animtool.core.errors import (
    Fault,
    FormatError,
    Severity,
    ToleranceError,
    excerpt,
    warning,
)
from animtool.core.quantities import plain_number
from animtool.core.units import UpAxis, up_from_up
from animtool.rig.skeleton import Rig
from animtool.scene.bake.prims import MeshReport
from animtool.scene.bake.progress import Progress, ProgressPhases, TimeProgress
from animtool.scene.file.entries import SceneSystem
from animtool.scene.systems.character_motion import CharacterMotion
from animtool.scene.systems.links import with_dependencies
from animtool.scene.systems.simulation import (
    SystemProgress,
    located_systems,
    open_systems,
    state_clock,
)
from animtool.systems.framework.run import EntryRun, ReachedState
from animtool.systems.framework.saved import write_states
from animtool.systems.framework.simulation import NeedsFinalState, StartsLater
from animtool.usd.caches.writer import CachedMesh
from animtool.usd.layers.names import distinct_names, legal_name
from animtool.usd.layers.sdf import StageMetadata
from animtool.usd.props.simulated import SimulatedJob


def last_states(
    systems: Sequence[SceneSystem],
    requested_indices: Sequence[int],
    times: Sequence[float],
    character: CharacterMotion | None = None,
    progress: Progress = None,
) -> Mapping[int, Any]:
    """Return the states of requested systems at the last of ``times`` [s], by index.

    The topology of a tearing mesh is constant: it has all its points from the first
    frame on. Therefore the final tears must be known before anything is written. Only
    the requested systems and their dependencies are simulated.
    """
    system_indices = with_dependencies(systems, requested_indices)
    simulated_systems = [systems[i] for i in system_indices]
    running_systems = open_systems(simulated_systems, times[-1], character)
    entry_runs = zip(system_indices, running_systems, strict=True)
    runs = {i: entry_run.run for i, entry_run in entry_runs if i in requested_indices}
    for k, t in enumerate(times):
        for i, run in runs.items():
            with located_systems([systems[i]]):
                run.sample(t)
        if progress is not None:
            progress((k + 1) / len(times))
    return {i: run.state.state for i, run in runs.items()}


# Maximum number of steps of a system, from its pre-roll to the last frame; more would
# take hours.
MAX_STEP_COUNT = 10_000_000
# Maximum step of a solver that chooses its steps [s].
MAX_ADAPTIVE_STEP = 1 / 240

# Scenes have numbers within this power of ten, in SI units.
MAX_PLAUSIBLE_EXPONENT = 9.0


class SystemRun:
    """Simulates systems frame by frame and yields their frames.

    Attributes:
        systems: Simulated systems.
        seconds: Time spent on each system [s].
        written_indices: Indices of the systems to write.
        stop_error: Error that stopped the run before the last frame; None if complete.
        frames_done: Number of simulated frames.
    """

    def __init__(
        self,
        systems: Sequence[SceneSystem],
        last: float,
        character: CharacterMotion | None = None,
        progress: Progress = None,
        main_rig: Rig | None = None,
    ) -> None:
        """Build the systems, whose last frame is at ``last`` [s].

        ``main_rig`` is the rig of the scene's own character.
        """
        _check_steps(systems, last)
        self.systems = systems
        self.seconds = [0.0] * len(systems)
        self.written_indices = [
            i for i, system in enumerate(systems) if system.is_written
        ]
        self.stop_error: ToleranceError | None = None
        self.frames_done = 0
        self._character = character
        self._phases: ProgressPhases | None = None
        self._frame_progress: Progress = None
        # Requested time codes of systems that save states, and the states, by index.
        self._save_codes: dict[int, float | None] = {
            i: system.setup.spec.save_at
            for i, system in enumerate(systems)
            if system.setup.writes
        }
        self._saved_states: dict[int, tuple[float, ReachedState[Any]]] = {}
        self._warnings: list[Fault] = []
        if progress is not None:
            progress(0.0)
            self._phases = ProgressPhases(progress)
        self._entry_runs: list[EntryRun] = open_systems(
            systems,
            last,
            character,
            self._system_progress(last),
            self._warnings,
            main_rig,
        )

    def _system_progress(self, last: float) -> SystemProgress | None:
        """Return the progress callbacks of the systems; None if none is shown."""
        if self._phases is None:
            return None

        def report_preroll(fraction: float) -> None:
            # Before the first frame is done: a pre-roll, or history for other systems.
            if self._frame_progress is not None:
                self._frame_progress(fraction)

        return SystemProgress(self._phases, TimeProgress(report_preroll, last))

    def _begin_phase(self, *, is_last: bool = False) -> Progress:
        """Begin a phase of the progress; return its callback, None if not shown."""
        phases = self._phases
        return None if phases is None else phases.phase(is_last=is_last)

    @property
    def notices(self) -> list[Fault]:
        """Warnings collected so far, each located at its system."""
        notices = duplicate_prims([self.systems[i] for i in self.written_indices])
        notices += self._warnings
        for system, entry_run in zip(self.systems, self._entry_runs, strict=True):
            notices += map(system.location.locate, entry_run.notices)
        return notices

    def late_start_notices(self, last: float) -> list[Fault]:
        """Return warnings about systems in which nothing exists until a time [s]."""
        notices = []
        for system, entry_run in zip(self.systems, self._entry_runs, strict=True):
            simulation = entry_run.run.simulation
            if isinstance(simulation, StartsLater):
                notice = simulation.late_start_notice(last)
                notices += [] if notice is None else [system.location.locate(notice)]
        return notices

    @property
    def simulated(self) -> list[dict[str, object]]:
        """Reports of the systems as plain values."""
        return list(filter(None, (entry.report() for entry in self._entry_runs)))

    def coded_frames(
        self,
        codes: Sequence[Fraction],
        start: Fraction,
        fps: Fraction,
        *,
        keep_stopped: bool = False,
    ) -> Iterator[tuple[float, list[Any]]]:
        """Yield each time code with the frames of the written systems.

        With ``keep_stopped``, frames end before the first one that a system fails to
        reach; if that is the very first frame, the error is raised.
        """
        times = [float((code - start) / fps) for code in codes]
        self._run_tear_pre_pass(times)
        show_progress = self._begin_phase(is_last=True)
        self._frame_progress = show_progress
        for k, (code, t) in enumerate(zip(codes, times, strict=True)):
            try:
                system_frames = [self._system_frame(i, t) for i in self.written_indices]
            except ToleranceError as error:
                faults = self._faults_with_frame(code, error)
                if not (k and keep_stopped):
                    raise ToleranceError(faults) from error
                kept_text = (
                    f"frames {float(codes[0]):g} to {float(codes[k - 1]):g} are kept"
                )
                note = Fault("SIM193", kept_text, severity=Severity.NOTE)
                self.stop_error = ToleranceError([*faults, note])
                break
            yield float(code), system_frames
            self.frames_done = k + 1
            self._record_states(code)
            if show_progress is not None:
                show_progress((k + 1) / len(codes))
        self._warn_of_save_frames()

    def _warn_of_save_frames(self) -> None:
        """Warn of states to save at frames outside the range (SIM185)."""
        for i, save_code in self._save_codes.items():
            code = self._saved_states[i][0] if i in self._saved_states else None
            if save_code is not None and code != save_code:
                saved_text = (
                    "nothing" if code is None else f"the state of frame {code:g}"
                )
                message = f"save_at is {save_code:g}, which is not a frame: "
                message += f"{saved_text} is saved"
                hint = "use one of the frames that are written"
                notice = warning("SIM185", message, hint)
                self._warnings.append(self.systems[i].location.locate(notice))

    def _run_tear_pre_pass(self, times: Sequence[float]) -> None:
        """Simulate tearing systems once and give them their final states."""
        runs = {i: self._entry_runs[i].run for i in self.written_indices}
        tearing_simulations = {
            i: simulation
            for i, run in runs.items()
            if isinstance(simulation := run.simulation, NeedsFinalState)
            and simulation.needs_final_state
        }
        if not tearing_simulations:
            return
        start_time = time.perf_counter()
        settings = (times, self._character, self._begin_phase())
        states = last_states(self.systems, list(tearing_simulations), *settings)
        for i, simulation in tearing_simulations.items():
            simulation.set_final_state(states[i])
        self.seconds[min(tearing_simulations)] += time.perf_counter() - start_time

    def _faults_with_frame(
        self, time_code: Fraction, error: ToleranceError
    ) -> list[Fault]:
        """Return the faults of an error, with the frame in the last message."""
        *other_faults, last_fault = error.faults
        message = last_fault.message + f", before frame {float(time_code):g}"
        hints = [last_fault.hint] if last_fault.hint else []
        key = last_fault.where
        for system in self.systems if last_fault.code == "SIM102" else ():
            if key is not None and key.startswith(system.location.where):
                hints += _unusual_number_hint(system)
        hint = ", ".join(hints) or None
        return [*other_faults, replace(last_fault, message=message, hint=hint)]

    def _record_states(self, time_code: Fraction) -> None:
        """Record the states to save at a time code."""
        for i in self._save_codes:
            # Joined systems stop together, at the same time.
            self._entry_runs[i].run.apply_pushes()
        for i, save_code in self._save_codes.items():
            if save_code is None or time_code <= save_code:
                state = self._entry_runs[i].run.apply_pushes()
                self._saved_states[i] = float(time_code), state

    def save_states(self, folder: Path) -> None:
        """Write the states to save into the scene's folder."""
        for i, (_, state) in self._saved_states.items():
            system, run = self.systems[i], self._entry_runs[i].run
            for name in system.setup.writes:
                write_states(folder / name, {"": (state_clock(system, run), state)})

    def _system_frame(self, i: int, t: float) -> Any:
        """Return the frame of a system at a time [s]."""
        start_time = time.perf_counter()
        with located_systems([self.systems[i]]):
            frame = self._entry_runs[i].at(t)
        self.seconds[i] += time.perf_counter() - start_time
        return frame

    def add_notices(self, meshes: Sequence[CachedMesh]) -> None:
        """Add the notices about written meshes, each located at its system."""
        self._warnings += [
            self.systems[i].location.locate(notice)
            for i, prim in zip(self.written_indices, meshes, strict=True)
            for notice in prim.notices
        ]

    def reports(self, meshes: Sequence[CachedMesh], scene: str) -> list[MeshReport]:
        """Return the report of each written system."""
        reports = []
        for i, prim in zip(self.written_indices, meshes, strict=True):
            system, size = self.systems[i], (self.seconds[i], prim.samples)
            reports.append(
                MeshReport(system.name, prim, *size, system.kind, True, scene)
            )
        return reports


def _unusual_number_hint(system: SceneSystem) -> list[str]:
    """Return a hint to check the number whose exponent is the most extreme."""
    values = system.setup.spec.model_dump(exclude_unset=True, by_alias=True)
    sizes = [*_number_sizes(values, ""), *_number_sizes(system.setup.entries, "")]
    exponents = [
        (abs(math.log10(size)), name, size) for name, size in sizes if size > 0
    ]
    exponent, name, size = max(exponents, default=(0.0, "", 0.0))
    return (
        [f"check the unit of {name}: {size:g}"]
        if exponent > MAX_PLAUSIBLE_EXPONENT
        else []
    )


def _number_sizes(node: Any, key_path: str) -> Iterator[tuple[str, float]]:
    """Yield the magnitude of each number, vector and array extent, with its key."""
    if isinstance(node, Mapping):
        for key, value in node.items():
            inner_path = f"{key_path}.{key}" if key_path else str(key)
            yield from _number_sizes(value, inner_path)
    elif isinstance(node, float):
        yield key_path, abs(node)
    elif isinstance(node, np.ndarray) and node.size and node.dtype.kind == "f":
        rows = node.reshape(-1, node.shape[-1]) if node.ndim > 1 else node
        width = float(np.ptp(rows, axis=0).max())
        yield key_path, width or float(np.abs(rows).max())
    elif isinstance(node, (list, tuple)):
        if node and all(isinstance(item, float) for item in node):
            yield key_path, max(map(abs, node))
            return
        for i, value in enumerate(node):
            yield from _number_sizes(value, f"{key_path}[{i}]")


def _check_steps(systems: Sequence[SceneSystem], last: float) -> None:
    """Refuse systems whose steps would take hours (SCN091)."""
    faults = []
    for system in systems:
        step = system.setup.spec.step or MAX_ADAPTIVE_STEP
        seconds = max(last, 0.0) + system.setup.spec.preroll
        if seconds / step > MAX_STEP_COUNT:
            message = f"{plain_number(seconds)} s in steps of {plain_number(step)} s "
            message += f"are {seconds / step:.3g} steps; the limit is {MAX_STEP_COUNT}"
            hint = "use longer steps, a shorter pre-roll or fewer frames"
            faults.append(system.location.fault("SCN091", message, hint))
    if faults:
        raise FormatError(faults)


def system_job(
    systems: Sequence[SceneSystem],
    model_path: str,
    metadata: StageMetadata,
    meters_per_unit: float,
    up: UpAxis,
) -> SimulatedJob:
    """Return the writer's job for systems; ``meters_per_unit`` is [m]."""
    rotation = up_from_up(up, UpAxis.Y)
    written_systems = [system for system in systems if system.is_written]
    return SimulatedJob(
        model_path,
        _prim_names(written_systems),
        metadata,
        meters_per_unit,
        None if rotation is None else np.array(rotation),
    )


def duplicate_prims(systems: Sequence[SceneSystem]) -> list[Fault]:
    """Return a warning for each system whose prim name is already used (SCN090)."""
    faults = []
    for system, prim in zip(systems, _prim_names(systems), strict=True):
        if prim != legal_name(system.name):
            message = f"another system is already named {excerpt(system.name)}: its "
            message += f"prim is {excerpt(prim)}"
            notice = warning("SCN090", message, "give each a unique name")
            faults.append(system.location.locate(notice))
    return faults


def _prim_names(systems: Sequence[SceneSystem]) -> list[str]:
    names = [system.name for system in systems]
    return distinct_names(names, names, names).names
