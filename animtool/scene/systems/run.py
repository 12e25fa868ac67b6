"""Simulation of systems over the frames, after a tear pre-pass."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from animtool.core.arguments import argument
from animtool.core.errors import Fault, FormatError, Severity, ToleranceError, excerpt
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
from animtool.systems.framework.run import STEP_TOLERANCE, EntryRun, ReachedState
from animtool.systems.framework.saved import write_states
from animtool.systems.framework.simulation import NeedsFinalState
from animtool.usd.caches.writer import CachedMesh
from animtool.usd.layers.names import distinct_names, legal_name
from animtool.usd.layers.sdf import StageMetadata
from animtool.usd.props.simulated import SimulatedJob


def last_states(
    systems: Sequence[SceneSystem],
    requested: Sequence[int],
    times: Sequence[float],
    character: CharacterMotion | None = None,
    progress: Progress = None,
) -> Mapping[int, Any]:
    """Return the final states of the requested systems, by index.

    The topology of a tearing mesh is constant: it has all its points from the first
    frame on. Therefore the final tears must be known before anything is written. Only
    the requested systems and their dependencies are simulated.

    ``times`` [s].
    """
    system_indices = with_dependencies(systems, requested)
    running_systems = open_systems(
        [systems[i] for i in system_indices], times[-1], character
    )
    final_runs = {
        i: system_run
        for i, system_run in zip(system_indices, running_systems, strict=True)
        if i in requested
    }
    for k, t in enumerate(times):
        for i, system_run in final_runs.items():
            with located_systems([systems[i]]):
                system_run.run.sample(t)
        if progress is not None:
            progress((k + 1) / len(times))
    return {i: system_run.run.state.state for i, system_run in final_runs.items()}


# Maximum number of steps of a system, from its pre-roll to the last frame; more would
# take hours.
MAX_STEPS = 10_000_000
# Maximum step of a solver that chooses its steps [s].
MAX_STEP = 1 / 240

# Scenes have numbers within this power of ten, in SI units.
MAX_EXPONENT = 9.0


class SystemRun:
    """A run of systems.

    Attributes:
        systems: Simulated systems.
        seconds: Time spent on each system [s].
        written: Indices of the systems to write.
        stopped: Error that stopped the run before the last frame; None if complete.
        done: Number of simulated frames.
    """

    def __init__(
        self,
        systems: Sequence[SceneSystem],
        last: float,
        character: CharacterMotion | None = None,
        progress: Progress = None,
        main_rig: Rig | None = None,
    ) -> None:
        """Build the systems: ``last`` [s]; ``main_rig`` is the scene's rig."""
        _check_steps(systems, last)
        self.systems = systems
        self.seconds = [0.0] * len(systems)
        self.written = [i for i, system in enumerate(systems) if system.written]
        self.stopped: ToleranceError | None = None
        self.done = 0
        self._character = character
        self._phases: ProgressPhases | None = None
        self._frames: Progress = None
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
        """Return the progress callbacks of the systems."""
        if self._phases is None:
            return None

        def report_preroll(fraction: float) -> None:
            # Before the first frame is done: a pre-roll, or history for other systems.
            if self._frames is not None:
                self._frames(fraction)

        return SystemProgress(self._phases, TimeProgress(report_preroll, last))

    @property
    def notices(self) -> list[Fault]:
        """Warnings collected so far, each located at its system."""
        duplicates = duplicate_prims([self.systems[i] for i in self.written])
        return (
            duplicates
            + self._warnings
            + [
                system.location.locate(notice)
                for system, entry_run in zip(
                    self.systems, self._entry_runs, strict=True
                )
                for notice in entry_run.notices
            ]
        )

    @property
    def simulated(self) -> list[dict[str, object]]:
        """Reports of the systems as plain values."""
        return [
            report for entry_run in self._entry_runs if (report := entry_run.report())
        ]

    def rows(
        self,
        codes: Sequence[Fraction],
        first: Fraction,
        fps: Fraction,
        *,
        keep_stopped: bool = False,
    ) -> Iterator[tuple[float, list[Any]]]:
        """Yield each time code with the frames of the written systems.

        With ``keep_stopped``, frames end before the first one that a system fails to
        reach; if that is the very first frame, the error is raised.
        """
        times = [float((code - first) / fps) for code in codes]
        self._check_resumed(codes, times, fps)
        self._run_tear_pre_pass(times)
        show_progress = (
            None if self._phases is None else self._phases.phase(is_last=True)
        )
        self._frames = show_progress
        for k, (code, t) in enumerate(zip(codes, times, strict=True)):
            try:
                row = [self._row(i, t) for i in self.written]
            except ToleranceError as error:
                if not (k and keep_stopped):
                    raise ToleranceError(
                        self._faults_with_frame(code, error)
                    ) from error
                kept_frames = (
                    f"frames {float(codes[0]):g} to {float(codes[k - 1]):g} are kept"
                )
                kept_note = Fault("SIM193", kept_frames, severity=Severity.NOTE)
                self.stopped = ToleranceError(
                    [*self._faults_with_frame(code, error), kept_note]
                )
                break
            yield float(code), row
            self.done = k + 1
            self._record_states(code)
            if show_progress is not None:
                show_progress((k + 1) / len(codes))
        self._warn_of_save_frames()

    def _check_resumed(
        self, codes: Sequence[Fraction], times: Sequence[float], fps: Fraction
    ) -> None:
        """Refuse frames before the state that a system resumes (SIM035)."""
        faults = []
        for system, entry_run in zip(self.systems, self._entry_runs, strict=True):
            run = entry_run.run
            resume_time = run.step_time(run.state.steps)
            if (
                run.state.steps
                and times[0] < resume_time - STEP_TOLERANCE * run.step_length
            ):
                frame = float(codes[0]) + (resume_time - times[0]) * float(fps)
                reason = _between_frames_text(frame, run.step_length, fps)
                message = f"its state is from frame {frame:g}, but {reason}and frame "
                message += f"{float(codes[0]):g} is requested"
                frames = f"{math.ceil(frame - STEP_TOLERANCE)}-{float(codes[-1]):g}"
                hint = argument("frame_range", frames)
                faults.append(system.location.fault("SIM035", message, hint))
        if faults:
            raise FormatError(faults)

    def _warn_of_save_frames(self) -> None:
        """Warn of states to save at frames outside the range (SIM185)."""
        for i, save_code in self._save_codes.items():
            code = self._saved_states[i][0] if i in self._saved_states else None
            if save_code is not None and code != save_code:
                saved_text = (
                    "nothing" if code is None else f"the state of frame {code:g}"
                )
                message = (
                    f"save_at is {save_code:g}, which is not a frame: "
                    f"{saved_text} is saved"
                )
                location = self.systems[i].location
                hint = "use one of the frames that are written"
                fault = location.fault("SIM185", message, hint, Severity.WARNING)
                self._warnings.append(fault)

    def _run_tear_pre_pass(self, times: Sequence[float]) -> None:
        """Simulate tearing systems once and give them their final states."""
        runs = {i: self._entry_runs[i].run for i in self.written}
        tearing_systems = {
            i: run
            for i, run in runs.items()
            if isinstance(run.simulation, NeedsFinalState)
            and run.simulation.needs_final_state
        }
        if not tearing_systems:
            return
        start_time = time.perf_counter()
        phase_progress = None if self._phases is None else self._phases.phase()
        final_states = last_states(
            self.systems, list(tearing_systems), times, self._character, phase_progress
        )
        for i, run in tearing_systems.items():
            run.simulation.set_final_state(final_states[i])
        self.seconds[min(tearing_systems)] += time.perf_counter() - start_time

    def _faults_with_frame(self, code: Fraction, error: ToleranceError) -> list[Fault]:
        """Return the faults of a stopped system; the last names the frame."""
        *other_faults, last_fault = error.faults
        message = last_fault.message + f", before frame {float(code):g}"
        hints = [last_fault.hint] if last_fault.hint else []
        for system in self.systems if last_fault.code == "SIM102" else ():
            if last_fault.where is not None and last_fault.where.startswith(
                system.location.where
            ):
                hints += _unusual_number_hint(system)
        return [
            *other_faults,
            replace(last_fault, message=message, hint=", ".join(hints) or None),
        ]

    def _record_states(self, code: Fraction) -> None:
        """Record the states to save at a time code."""
        for i in self._save_codes:
            # Joined systems stop together, at the same time.
            self._entry_runs[i].run.apply_pushes()
        for i, save_code in self._save_codes.items():
            if save_code is None or code <= save_code:
                self._saved_states[i] = (
                    float(code),
                    self._entry_runs[i].run.apply_pushes(),
                )

    def save_states(self, folder: Path) -> None:
        """Write the states to save into the scene's folder."""
        for i, (_, state) in self._saved_states.items():
            system, run = self.systems[i], self._entry_runs[i].run
            for name in system.setup.writes:
                write_states(folder / name, {"": (state_clock(system, run), state)})

    def _row(self, i: int, t: float) -> Any:
        start_time = time.perf_counter()
        with located_systems([self.systems[i]]):
            frame = self._entry_runs[i].at(t)
        self.seconds[i] += time.perf_counter() - start_time
        return frame

    def add_notices(self, meshes: Sequence[CachedMesh]) -> None:
        """Add the notices of written meshes, each located at its system."""
        self._warnings += [
            self.systems[i].location.locate(notice)
            for i, prim in zip(self.written, meshes, strict=True)
            for notice in prim.notices
        ]

    def reports(self, meshes: Sequence[CachedMesh], scene: str) -> list[MeshReport]:
        """Return the report of each written system."""
        return [
            MeshReport(
                self.systems[i].name,
                prim,
                self.seconds[i],
                prim.samples,
                self.systems[i].kind,
                True,
                scene,
            )
            for i, prim in zip(self.written, meshes, strict=True)
        ]


def _unusual_number_hint(system: SceneSystem) -> list[str]:
    """Return a hint to check the number whose exponent is the most extreme."""
    values = system.setup.spec.model_dump(exclude_unset=True, by_alias=True)
    sizes = [*_number_sizes(values, ""), *_number_sizes(system.setup.parts, "")]
    exponents = [
        (abs(math.log10(size)), name, size) for name, size in sizes if size > 0
    ]
    most_unusual, name, size = max(exponents, default=(0.0, "", 0.0))
    return (
        [f"check the unit of {name}: {size:g}"] if most_unusual > MAX_EXPONENT else []
    )


def _number_sizes(node: Any, key_path: str) -> Iterator[tuple[str, float]]:
    """Yield the magnitude of each number, vector and array extent, with its key."""
    if isinstance(node, Mapping):
        for key, value in node.items():
            yield from _number_sizes(
                value, f"{key_path}.{key}" if key_path else str(key)
            )
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


def _between_frames_text(frame: float, step_length: float, fps: Fraction) -> str:
    """Return the reason why a state is between frames; empty if it is on a frame."""
    if abs(frame - round(frame)) < 1e-6 or step_length * float(fps) > 1:
        return ""
    return (
        f"the end of its last step before frame {math.ceil(frame)} (of "
        f"{step_length:.4g} s, which does not divide a frame), "
    )


def _check_steps(systems: Sequence[SceneSystem], last: float) -> None:
    """Refuse systems whose steps would take hours (SCN091)."""
    faults = []
    for system in systems:
        step = system.setup.facts.step or MAX_STEP
        seconds = max(last, 0.0) + system.setup.spec.preroll
        if seconds / step > MAX_STEPS:
            message = (
                f"{plain_number(seconds)} s in steps of {plain_number(step)} s are "
                f"{seconds / step:.3g} steps; the limit is {MAX_STEPS}"
            )
            hint = "use longer steps, a shorter pre-roll or fewer frames"
            faults.append(system.location.fault("SCN091", message, hint))
    if faults:
        raise FormatError(faults)


def system_job(
    systems: Sequence[SceneSystem],
    model: str,
    metadata: StageMetadata,
    meters_per_unit: float,
    up: UpAxis,
) -> SimulatedJob:
    """Return the writer's job for systems: ``meters_per_unit`` [m]."""
    rotation = up_from_up(up, UpAxis.Y)
    written_systems = [system for system in systems if system.written]
    return SimulatedJob(
        model,
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
            hint = "give each a unique name"
            faults.append(
                system.location.fault("SCN090", message, hint, Severity.WARNING)
            )
    return faults


def _prim_names(systems: Sequence[SceneSystem]) -> list[str]:
    names = [system.name for system in systems]
    return distinct_names(names, names, names).names
