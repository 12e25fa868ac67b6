"""Trials of systems with other methods, steps and tolerances."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError, ToleranceError
from animtool.core.plugins import load_object
from animtool.motion.frames import Frame, PointsFrame, TransformsFrame
from animtool.scene.file.entries import SceneSystem
from animtool.scene.systems.character_motion import CharacterMotion, CharacterMotions
from animtool.scene.systems.links import dependencies, simulation_order
from animtool.scene.systems.simulation import (
    BuildContext,
    build_systems,
    character_cache,
    located_systems,
    run_entries,
)
from animtool.sim.integrators.integrator import (
    INTEGRATORS,
    StepControl,
    find_integrator,
)
from animtool.sim.options import DEFAULT_TOLERANCE
from animtool.sim.trajectory import Status
from animtool.sim.trials.trial import (
    REFERENCE_FACTORS,
    Figure,
    Setting,
    Snapshot,
    Trial,
    TrialOutcome,
    rounded_multiples,
    step_settings,
)
from animtool.systems.framework.run import SimulationRun
from animtool.systems.framework.simulation import (
    HasTrialSettings,
    StoppedError,
    TrialSettings,
)
from animtool.systems.framework.spec import SystemSpec

# Step of the exact method over the file's step, if the file's step is too long.
FINE_STEP_RATIO = 1 / 8
# Tolerances over the default one; and the maximum step of adaptive methods over the
# file's step.
TOLERANCES = (100.0, 1.0, 0.01)
LONG_STEP_RATIO = 4.0
# Number of unknowns up to which implicit methods are tried: forces have no analytic
# derivatives, and numerical ones take as many evaluations.
MAX_IMPLICIT_UNKNOWNS = 30
# Maximum number of evaluations in a step; a method that needs more is unsuitable.
MAX_STEP_EVALUATIONS = 1000


def system_trials(
    systems: Sequence[SceneSystem],
    times: FloatArray,
    character: CharacterMotion | None = None,
) -> list[tuple[list[SceneSystem], Trial]]:
    """Return trials of systems at times ``(F,)`` [s], each with its systems."""
    end_time, characters = float(times[-1]), character_cache(character)
    trials = []
    for group in simulation_order(systems):
        members = [systems[i] for i in group]
        needed_systems = [systems[i] for i in dependencies(systems, group)]

        with located_systems(members):
            rebuild = partial(_rebuild, needed_systems, end_time, characters)
            trials.append((members, _trial(members, rebuild, times)))
    return trials


def _rebuild(
    systems: Sequence[SceneSystem], last_time: float, characters: CharacterMotions
) -> BuildContext:
    """Return a new context with systems built for times up to ``last_time`` [s]."""
    context = BuildContext(last_time, characters)
    build_systems(systems, context)
    return context


def _trial(
    members: Sequence[SceneSystem],
    rebuild: Callable[[], BuildContext],
    times: FloatArray,
) -> Trial:
    """Return the trial of jointly simulated systems at times ``(F,)`` [s].

    ``rebuild`` rebuilds their dependencies for each run.
    """
    max_point_count = 0  # maximum number of points in any run so far
    spec = members[0].setup.spec
    if spec.has_trial_settings:
        simulation = run_entries(members, rebuild()).simulation
        assert isinstance(simulation, HasTrialSettings)
        trial_settings = simulation.trial_settings()
    else:
        trial_settings = _trial_settings(spec, members[0].setup.method)

    def run(setting: Setting) -> TrialOutcome:
        nonlocal max_point_count
        method, max_evaluations = setting.method, None
        if not spec.has_trial_settings:
            is_other_method = method != trial_settings.configured_setting.method
            max_evaluations = _evaluation_limit(
                method, max_point_count, is_other_method=is_other_method
            )
        changes = trial_settings.changes(setting)
        outcome = _outcome(
            run_entries(members, rebuild(), changes, max_evaluations), times
        )
        point_counts = [len(snapshot.points) for snapshot in outcome.snapshots]
        max_point_count = max([max_point_count, *point_counts])
        return outcome

    return Trial(
        " + ".join(member.name for member in members),
        " + ".join(dict.fromkeys(member.kind for member in members)),
        float(times[-1]) + max(member.setup.spec.preroll for member in members),
        trial_settings.configured_setting,
        trial_settings.settings,
        trial_settings.references,
        run,
        changed_keys=trial_settings.changes,
        request_lines=lambda setting: [
            _scene_text(members[0], trial_settings.changes(setting))
        ],
    )


def _scene_text(system: SceneSystem, changes: Mapping[str, Any]) -> str:
    """Return the keys that select a setting of a system, as scene text."""
    keys = ", ".join(
        f"{key}: {value:.6g}" if isinstance(value, float) else f"{key}: {value}"
        for key, value in changes.items()
        if value is not None
    )
    return f"{system.kind}: {{{keys}}}"


def _trial_settings(spec: SystemSpec, spec_method: str) -> TrialSettings:
    """Return the methods, steps and tolerances to try for a spec."""
    tolerance = getattr(spec, "tolerance", None)
    default = DEFAULT_TOLERANCE if tolerance is None else tolerance
    options = {} if _is_fixed(spec_method) else {"tolerance": default}

    def settings() -> list[Setting]:
        """Return the settings to try: each method with several steps or tolerances."""
        methods = INTEGRATORS if spec.methods is None else spec.methods or [spec_method]
        tried_settings: list[Setting] = []
        for method in methods:
            if _is_fixed(method):
                tried_settings += step_settings(method, spec.step)
                continue
            max_step, centre = LONG_STEP_RATIO * spec.step, DEFAULT_TOLERANCE
            if method == spec_method:
                max_step, centre = spec.step, default
            for value in rounded_multiples(centre, TOLERANCES):
                tried_settings.append(
                    Setting.of(method, step=max_step, tolerance=value)
                )
        return tried_settings

    def references() -> list[list[Setting]]:
        """Return reference settings with decreasing steps of the exact method.

        If the exact method is unstable, use the file's method or far shorter steps.
        """
        exact_method = spec.reference_method or spec_method
        step_ratios = [(exact_method, 1.0)]
        if spec_method != exact_method and _is_fixed(spec_method):
            step_ratios.append((spec_method, 1.0))
        if spec.reference_method:
            step_ratios.append((exact_method, FINE_STEP_RATIO))
        return [
            step_settings(method, ratio * spec.step, REFERENCE_FACTORS)
            for method, ratio in step_ratios
        ]

    def changes(setting: Setting) -> dict[str, Any]:
        keys = type(spec).model_fields
        changes: dict[str, Any] = dict(setting.options)
        changes |= {spec.method_key: setting.method} if spec.method_key in keys else {}
        if "tolerance" in keys:
            kept_tolerance = tolerance if setting.method == spec_method else None
            changes.setdefault("tolerance", kept_tolerance)
        return changes

    file_setting = Setting.of(spec_method, step=spec.step, **options)
    return TrialSettings(file_setting, settings, references, changes)


def _evaluation_limit(
    method: str, max_point_count: int, *, is_other_method: bool
) -> int | None:
    """Return the maximum number of evaluations per step; None is unlimited.

    ``max_points`` is the largest number of points in any run so far,
    ``is_other_method`` whether the method differs from that of the file.
    """
    if method not in INTEGRATORS:
        return None
    integrator = find_integrator(method)
    unknown_count = 3 * max_point_count
    if (
        is_other_method
        and integrator.is_implicit
        and unknown_count > MAX_IMPLICIT_UNKNOWNS
    ):
        message = f"{method} would solve for {unknown_count} unknowns at "
        raise OptionError(Fault("SIM024", f"{message}once", where="method"))
    if integrator.solver:
        # Imports are not part of the simulation's time.
        load_object(integrator.solver)
    return MAX_STEP_EVALUATIONS if is_other_method else None


def _outcome(run: SimulationRun, times: FloatArray) -> TrialOutcome:
    """Simulate a run and return its points and errors at times ``(F,)`` [s]."""
    start_time = time.perf_counter()
    snapshots: list[Snapshot] = []
    energies, status, reason, stable_step = [], Status.OK, "", None
    try:
        for sample_time in times.tolist():
            snapshots.append(_snapshot(run.at(sample_time)))
            energies.append(run.diagnostics.energy)
    except ToleranceError as error:
        status, reason = Status.UNSTABLE, error.faults[0].message
        stats = error.stats if isinstance(error, StoppedError) else None
        if stats is not None:
            status, reason, stable_step = stats.status, stats.reason, stats.stable_step
    seconds = time.perf_counter() - start_time
    last_diagnostics = run.simulation.diagnostics(
        run.state.state, run.step_time(run.state.step_count)
    )
    known_energies = [energy for energy in energies if energy is not None]
    is_complete = len(known_energies) == len(snapshots) and _has_constant_points(
        snapshots
    )
    stretch = last_diagnostics.stretch
    return TrialOutcome(
        seconds,
        run.steps_taken if last_diagnostics.steps is None else last_diagnostics.steps,
        snapshots,
        status,
        reason,
        last_diagnostics.stable_step() if stable_step is None else stable_step,
        known_energies if is_complete else None,
        figures={} if stretch is None else {Figure.STRETCH: stretch},
    )


def _is_fixed(method: str) -> bool:
    """Return whether a method has a constant step length."""
    is_known = method in INTEGRATORS
    return not is_known or find_integrator(method).control is StepControl.FIXED


def _has_constant_points(snapshots: Sequence[Snapshot]) -> bool:
    """Return whether no point appears or disappears between snapshots."""
    ids = [snapshot.ids for snapshot in snapshots if snapshot.ids is not None]
    return all(np.array_equal(frame_ids, ids[0]) for frame_ids in ids)


def _snapshot(frame: Frame) -> Snapshot:
    """Return the points of a frame that are compared with the reference."""
    if isinstance(frame, TransformsFrame):
        point_distances = [np.linalg.norm(mesh.points, axis=1) for mesh in frame.meshes]
        max_scale = np.abs(frame.scales).max(initial=0.0)
        extent = float(
            max(
                (distances.max(initial=0.0) for distances in point_distances),
                default=0.0,
            )
            * max_scale
        )
        return Snapshot(frame.points, frame.ids, frame.rotations, extent)
    ids = frame.ids if isinstance(frame, PointsFrame) else None
    return Snapshot(frame.points, ids)
