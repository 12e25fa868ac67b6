"""A run of systems through the frames, after a tear pre-pass."""

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
)
from animtool.systems.framework.run import STEP_TOLERANCE, EntryRun, ReachedState
from animtool.systems.framework.saved import StateClock, write_states
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
    """Return the final states of some systems, by index.

    A mesh that tears has all its points from the first frame on, so that its topology
    is constant: what will tear must be known before anything is written. Systems that
    these do not depend on are left out, since they do not affect them.

    ``times`` [s].
    """
    numbers = with_dependencies(systems, requested)
    running_systems = open_systems([systems[i] for i in numbers], times[-1], character)
    final_runs = {
        i: system_run
        for i, system_run in zip(numbers, running_systems, strict=True)
        if i in requested
    }
    for k, t in enumerate(times):
        for i, system_run in final_runs.items():
            with located_systems([systems[i]]):
                system_run.run.reach(t)
        if progress is not None:
            progress((k + 1) / len(times))
    return {i: system_run.run.state.state for i, system_run in final_runs.items()}


# Maximum number of steps of a system, from its pre-roll to the last frame; more take
# hours.
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
        stopped: Why frames ended before the last one; None if they did not.
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
        # Time codes and states of systems with saved states.
        self._saving: dict[int, float | None] = {
            i: system.setup.spec.save_at
            for i, system in enumerate(systems)
            if system.setup.writes
        }
        self._kept: dict[int, tuple[float, ReachedState[Any]]] = {}
        self._warnings: list[Fault] = []
        if progress is not None:
            progress(0.0)
            self._phases = ProgressPhases(progress)
        self._open: list[EntryRun] = open_systems(
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

        def tell(fraction: float) -> None:
            # Before the first frame is done: a pre-roll, or history for other systems.
            if self._frames is not None:
                self._frames(fraction)

        return SystemProgress(self._phases, TimeProgress(tell, last))

    @property
    def notices(self) -> list[Fault]:
        """Warnings collected so far, each located at its system."""
        duplicates = duplicate_prims([self.systems[i] for i in self.written])
        return (
            duplicates
            + self._warnings
            + [
                system.location.locate(notice)
                for system, opened in zip(self.systems, self._open, strict=True)
                for notice in opened.notices
            ]
        )

    @property
    def simulated(self) -> list[dict[str, object]]:
        """Reports of the systems as plain values."""
        return [report for opened in self._open if (report := opened.report())]

    def rows(
        self,
        codes: Sequence[Fraction],
        first: Fraction,
        fps: Fraction,
        *,
        keep_stopped: bool = False,
    ) -> Iterator[tuple[float, list[Any]]]:
        """Yield every time code with the frames of the written systems.

        With ``keep_stopped``, frames end before the first one that a system does not
        reach, unless it is the very first.
        """
        times = [float((code - first) / fps) for code in codes]
        self._check_resumed(codes, times, fps)
        self._run_tear_pre_pass(times)
        show_progress = None if self._phases is None else self._phases.last()
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
                note = Fault("SIM193", kept_frames, severity=Severity.NOTE)
                self.stopped = ToleranceError(
                    [*self._faults_with_frame(code, error), note]
                )
                break
            yield float(code), row
            self.done = k + 1
            self._keep(code)
            if show_progress is not None:
                show_progress((k + 1) / len(codes))
        self._note_kept()

    def _check_resumed(
        self, codes: Sequence[Fraction], times: Sequence[float], fps: Fraction
    ) -> None:
        """Refuse frames before the state that a system resumes (SIM035)."""
        faults = []
        for system, opened in zip(self.systems, self._open, strict=True):
            run = opened.run
            resume_time = run.time(run.state.steps)
            if (
                run.state.steps
                and times[0] < resume_time - STEP_TOLERANCE * run.step_length
            ):
                frame = float(codes[0]) + (resume_time - times[0]) * float(fps)
                message = f"its state is from frame {frame:g}, but "
                message += _step_end(frame, run.step_length, fps) + "and frame "
                message += f"{float(codes[0]):g} is requested"
                frames = f"{math.ceil(frame - STEP_TOLERANCE)}-{float(codes[-1]):g}"
                hint = argument("frame_range", frames)
                faults.append(system.location.fault("SIM035", message, hint))
        if faults:
            raise FormatError(faults)

    def _note_kept(self) -> None:
        """Warn of states to save at frames outside the range (SIM185)."""
        for i, at in self._saving.items():
            code = self._kept[i][0] if i in self._kept else None
            if at is not None and code != at:
                saved_text = (
                    "nothing" if code is None else f"the state of frame {code:g}"
                )
                message = (
                    f"save_at is {at:g}, which is not a frame: {saved_text} is saved"
                )
                location = self.systems[i].location
                hint = "use one of the frames that are written"
                fault = location.fault("SIM185", message, hint, Severity.WARNING)
                self._warnings.append(fault)

    def _run_tear_pre_pass(self, times: Sequence[float]) -> None:
        """Give their final states to systems that need them in advance."""
        runs = {i: self._open[i].run for i in self.written}
        tearing_systems = {
            i: run
            for i, run in runs.items()
            if isinstance(run.simulation, NeedsFinalState)
            and run.simulation.needs_final_state
        }
        if not tearing_systems:
            return
        start_time = time.perf_counter()
        phase = None if self._phases is None else self._phases.phase()
        final_states = last_states(
            self.systems, list(tearing_systems), times, self._character, phase
        )
        for i, run in tearing_systems.items():
            run.simulation.set_final_state(final_states[i])
        self.seconds[min(tearing_systems)] += time.perf_counter() - start_time

    def _faults_with_frame(self, code: Fraction, error: ToleranceError) -> list[Fault]:
        """Return the faults of a stopped system, the last with the frame."""
        *other_faults, last_fault = error.faults
        message = last_fault.message + f", before frame {float(code):g}"
        hints = [last_fault.hint] if last_fault.hint else []
        for system in self.systems if last_fault.code == "SIM102" else ():
            if last_fault.where is not None and last_fault.where.startswith(
                system.location.where
            ):
                hints += _unlikely(system)
        return [
            *other_faults,
            replace(last_fault, message=message, hint=", ".join(hints) or None),
        ]

    def _keep(self, code: Fraction) -> None:
        """Keep the states that are saved at a time code."""
        for i in self._saving:
            # Joined systems stop together, at the same time.
            self._open[i].run.receive()
        for i, at in self._saving.items():
            if at is None or code <= at:
                self._kept[i] = float(code), self._open[i].run.receive()

    def save_states(self, folder: Path) -> None:
        """Write the states to save into the scene's folder."""
        for i, (_, state) in self._kept.items():
            system, run = self.systems[i], self._open[i].run
            clocked_system = StateClock(system.kind, run.begin, run.step_length)
            for name in system.setup.writes:
                write_states(folder / name, {"": (clocked_system, state)})

    def _row(self, i: int, t: float) -> Any:
        start_time = time.perf_counter()
        with located_systems([self.systems[i]]):
            row = self._open[i].at(t)
        self.seconds[i] += time.perf_counter() - start_time
        return row

    def note(self, written: Sequence[CachedMesh]) -> None:
        """Add the notices of prims, each located at its system."""
        self._warnings += [
            self.systems[i].location.locate(notice)
            for i, prim in zip(self.written, written, strict=True)
            for notice in prim.notices
        ]

    def reports(self, written: Sequence[CachedMesh], scene: str) -> list[MeshReport]:
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
            for i, prim in zip(self.written, written, strict=True)
        ]


def _unlikely(system: SceneSystem) -> list[str]:
    """Return a hint at the number of a system that is most unusual."""
    values = system.setup.spec.model_dump(exclude_unset=True, by_alias=True)
    sizes = [*_sizes(values, ""), *_sizes(system.setup.parts, "")]
    exponents = [
        (abs(math.log10(size)), name, size) for name, size in sizes if size > 0
    ]
    most_unusual, name, size = max(exponents, default=(0.0, "", 0.0))
    return (
        [f"check the unit of {name}: {size:g}"] if most_unusual > MAX_EXPONENT else []
    )


def _sizes(node: Any, name: str) -> Iterator[tuple[str, float]]:
    """Yield numbers, the longest component of vectors, and the width of arrays."""
    if isinstance(node, Mapping):
        for key, value in node.items():
            yield from _sizes(value, f"{name}.{key}" if name else str(key))
    elif isinstance(node, float):
        yield name, abs(node)
    elif isinstance(node, np.ndarray) and node.size and node.dtype.kind == "f":
        rows = node.reshape(-1, node.shape[-1]) if node.ndim > 1 else node
        width = float(np.ptp(rows, axis=0).max())
        yield name, width or float(np.abs(rows).max())
    elif isinstance(node, (list, tuple)):
        if node and all(isinstance(item, float) for item in node):
            yield name, max(map(abs, node))
            return
        for i, value in enumerate(node):
            yield from _sizes(value, f"{name}[{i}]")


def _step_end(frame: float, length: float, fps: Fraction) -> str:
    """Return why a state is between frames; empty if it is on one."""
    if abs(frame - round(frame)) < 1e-6 or length * float(fps) > 1:
        return ""
    return (
        f"the end of its last step before frame {math.ceil(frame)} (of "
        f"{length:.4g} s, which does not divide a frame), "
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
            )
            message += f"{seconds / step:.3g} steps; the limit is {MAX_STEPS}"
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
    written = [system for system in systems if system.written]
    return SimulatedJob(
        model,
        _prim_names(written),
        metadata,
        meters_per_unit,
        None if rotation is None else np.array(rotation),
    )


def duplicate_prims(systems: Sequence[SceneSystem]) -> list[Fault]:
    """Return a warning for each system whose prim name is taken (SCN090)."""
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
