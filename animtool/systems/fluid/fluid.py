"""Fluid simulation: steps with a pressure solve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace
from typing import Any

import numpy as np

from animtool import _kernels
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, counted, warning
from animtool.core.quantities import floor_to_two_digits, plain_number
from animtool.core.record import dataclass
from animtool.motion.frames import MeshFrame, PointsFrame
from animtool.sim.colliders import Colliders, collide
from animtool.sim.colliders.bodies import (
    Wrenches,
    body_owners,
    pushable_table,
    split_by_system,
)
from animtool.sim.system import Energy
from animtool.systems.fluid.filling import (
    Nozzle,
    coarse_drop_warnings,
    coarse_fill_warnings,
    find_clear_points,
    initial_fluid,
)
from animtool.systems.fluid.spec import FluidModel
from animtool.systems.fluid.substeps import Substeps
from animtool.systems.framework.colours import Colouring, Quantities
from animtool.systems.framework.simulation import (
    Diagnostics,
    SimContext,
    SteppedState,
    StoppedError,
    growing_field,
    saved_as,
)
from animtool.systems.particles.forces.base import Force
from animtool.systems.particles.state import ParticleState

# Mean compression above which a fluid has collapsed [1], and its ratio to the limit.
COLLAPSE_COMPRESSION, COLLAPSE_RATIO = 0.1, 5
# Largest energy gain without a source, relative to the exchanged energy [1].
MAX_ENERGY_GROWTH = 0.05
# Substeps are doubled while that reduces compression to less than this fraction.
DOUBLING_GAIN = 0.8
# Steps that would have to be more times shorter fail for another reason.
MAX_SHORTENING = 1000
# Divisors of the step to try for a hint, and the number of trial steps of each.
STEP_DIVISORS, TRIAL_STEPS = (2.0, 4.0, 8.0, 16.0), 4
REMEDY_HINT = "use weaker forces, a larger spacing, or slower colliders"


@dataclass(frozen=True, slots=True)
class FluidState:
    """State of N fluid particles at the end of a step."""

    ids: IntArray = field(metadata=growing_field())  # particle ids, ascending (N,)
    # Positions [m], then velocities [m/s] (2, N, 3).
    motion: FloatArray = field(metadata=growing_field(1))
    births: FloatArray = field(metadata=growing_field())  # birth times (N,) [s]
    # Mean pressures over a step (N,) [Pa].
    pressures: FloatArray = field(metadata=growing_field())
    made: int = 0  # number of particles born so far
    held: int = 0  # number of particles not emitted so far, for lack of room
    sound: float = 0.0  # speed of sound [m/s]
    energy: float = 0.0  # upper bound of kinetic and potential energy [J]
    compression: float = 0.0  # mean compression [1]
    # Largest compression so far [1].
    max_compression: float = field(default=0.0, metadata=saved_as("densest"))
    # Number of substeps of the last step.
    substep_count: int = field(default=0, metadata=saved_as("parts"))


def build(spec: FluidModel, context: SimContext) -> Fluid:
    """Build the fluid of a spec with its initial particles; raise SIM064 if invalid."""
    entry_data, colliders, begin = context.entry_data, context.colliders, context.begin
    initial_motion = initial_fluid(spec, entry_data.get("fills", ()), colliders, begin)
    emitters = zip(spec.emitters, entry_data.get("emitters", ()), strict=True)
    nozzles = [
        Nozzle(spec, emitter, nozzle_data["poses"], begin)
        for emitter, nozzle_data in emitters
    ]
    notices = colliders.notices()
    fills = entry_data.get("fills", ())
    notices += coarse_fill_warnings(spec, fills, colliders, begin)
    notices += coarse_drop_warnings(spec, fills)
    if spec.surface is not None:
        from animtool.systems.fluid.surface import check_surface

        check_surface()
    return Fluid(
        spec,
        begin,
        colliders,
        entry_data.get("forces", ()),
        initial_motion,
        nozzles,
        [Colliders([drain.as_solid()]) for drain in entry_data.get("drains", ())],
        notices,
    )


class Fluid:
    """Simulates an incompressible fluid of particles."""

    def __init__(
        self,
        spec: FluidModel,
        begin: float,
        colliders: Colliders,
        forces: Sequence[Force],
        initial_motion: FloatArray,
        nozzles: Sequence[Nozzle],
        drains: Sequence[Colliders],
        notices: list[Fault],
    ) -> None:
        """Start at a time [s] with positions and velocities ``(2, N, 3)``."""
        self._spec, self._begin, self._initial_motion = spec, begin, initial_motion
        self._colliders, self._forces = colliders, forces
        self._nozzles, self._drains, self._notices = nozzles, drains, notices
        self._mass = spec.density * spec.spacing**3
        self._substeps = Substeps(spec)
        self._colouring = (
            None if spec.colour is None else Colouring.from_model(spec.colour, {})
        )
        # Without moving colliders the initial energy is an upper bound.
        is_static = not colliders.bodies and not colliders.sheets
        is_static &= all(collider.poses.is_fixed for collider in colliders)
        self._conserves_energy = is_static

    def initial_state(self) -> FluidState:
        """Return the initial fluid, with its speed of sound and its energy bound."""
        count = self._initial_motion.shape[1]
        state = FluidState(
            np.arange(count, dtype=np.int64),
            self._initial_motion,
            np.full(count, self._begin),
            np.zeros(count),
            made=count,
        )
        accelerations = self._accelerations(state, self._begin)
        points = self._initial_motion[0]
        sound = self._substeps.initial_sound_speed(points, accelerations)
        return replace(state, sound=sound, energy=self._energy(state)[0])

    def incompatibility(self, state: FluidState, t: float) -> str:
        """Return why a saved state cannot be resumed; empty if it can."""
        del t
        return "" if state.sound >= 0 else "the speed of sound is below 0"

    def step(self, state: FluidState, t: float, dt: float) -> SteppedState[FluidState]:
        """Return the state after a step [s], and impulses on bodies."""
        end_time, notices = t + dt, list[Fault]()
        accelerations = self._accelerations(state, t)
        if not np.isfinite(accelerations).all():
            self._stop("SIM102", end_time, "a force is not finite", "weaker forces")
        wrenches: Sequence[Wrenches] = [
            Wrenches.zeros(system.count) for system in self._colliders.bodies
        ]
        if len(state.ids):
            state, wrenches = self._solve_pressure(state, t, dt, accelerations, notices)
        state = self._remove_drained(state, end_time)
        state = self._add_inflow(state, t, end_time, accelerations, notices)
        return SteppedState(state, wrenches, notices)

    def _particles(self, state: FluidState) -> ParticleState:
        """Return the fluid as particles, for force fields."""
        births, points = state.births, state.motion[0]
        radius = self._spec.spacing / 2
        return ParticleState.everlasting(state.ids, self._mass, radius, births, points)

    def _accelerations(self, state: FluidState, t: float) -> FloatArray:
        """Return accelerations of forces ``(N, 3)`` [m/s²]."""
        (x, v), particles = state.motion, self._particles(state)
        accelerations: FloatArray = np.zeros_like(x)
        with np.errstate(all="ignore"):
            for force in self._forces:
                accelerations += force.force(t, x, v, particles) / self._mass
        return accelerations

    def _energy(self, state: FluidState) -> tuple[float, float, bool]:
        """Return total and kinetic energy [J], and if all forces have a potential."""
        kinetic_energy = 0.5 * self._mass * float((state.motion[1] ** 2).sum())
        particles, has_all_potentials = self._particles(state), True
        total_energy = kinetic_energy
        for force in self._forces:
            potentials = force.potential(state.motion[0], particles)
            has_all_potentials &= potentials is not None
            total_energy += 0.0 if potentials is None else float(potentials.sum())
        if self._spec.tension:
            points = np.ascontiguousarray(state.motion[0])
            area = _kernels.fluid_area(points, self._spec.spacing)
            total_energy += self._spec.tension * area
        return total_energy, kinetic_energy, has_all_potentials

    def _solve_pressure(
        self,
        state: FluidState,
        t: float,
        dt: float,
        accelerations: FloatArray,
        notices: list[Fault] | None = None,
    ) -> tuple[FluidState, Sequence[Wrenches]]:
        """Return the state after a step, in the substeps that compression requires.

        Without a list of notices, this is a trial that does not suggest a shorter step.
        """
        speeds = np.linalg.norm(state.motion[1], axis=1) + self._colliders.max_speed
        max_acceleration = float(np.linalg.norm(accelerations, axis=1).max())
        max_speed = float(speeds.max()) + max_acceleration * dt
        sound_speed = self._substeps.step_sound_speed(
            state.sound, state.pressures, speeds, max_acceleration, dt
        )
        needed_count = self._substeps.substep_count(dt, max_speed, sound_speed)
        if needed_count > self._substeps.max_substeps:
            max_substeps, spacing = self._substeps.max_substeps, self._spec.spacing
            message = f"at {max_speed:.3g} m/s and a spacing of {spacing:g} m, a step "
            message += f"of {dt:g} s needs more than {max_substeps} substeps"
            substep_ratio = needed_count / max_substeps
            self._stop_for_long_step(state, t, dt, message, substep_ratio, notices)
        substep_count, max_compression = int(needed_count), self._spec.compression
        result = self._run_kernel(
            state, t, dt, accelerations, sound_speed, substep_count
        )
        while result.compression > max_compression:
            finer_sound, finer_substeps = 2 * sound_speed, 2 * substep_count
            if finer_substeps > self._substeps.max_substeps:
                break
            finer_result = self._run_kernel(
                state, t, dt, accelerations, finer_sound, finer_substeps
            )
            if finer_result.compression > DOUBLING_GAIN * result.compression:
                break
            result, sound_speed, substep_count = (
                finer_result,
                finer_sound,
                finer_substeps,
            )
        if not np.isfinite(result.motion).all():
            self._stop("SIM102", t + dt, "numbers are not finite", "use shorter steps")
        compression = result.compression
        if compression > max(COLLAPSE_COMPRESSION, COLLAPSE_RATIO * max_compression):
            message = f"it is {compression:.1%} denser than at rest: there is too "
            message += "little room"
            hint = "enlarge its container, open a drain, or close an emitter earlier"
            self._stop("SIM108", t + dt, message, hint)
        if compression > max_compression and notices is not None:
            message = f"it is {compression:.2%} denser than at rest at "
            message += f"{t + dt:g} s; the limit is {max_compression:.2%}"
            hint = "give it more room: it is compressed"
            notices.append(warning("SIM137", message, hint))
        end_state = replace(
            state,
            motion=result.motion,
            pressures=result.pressures,
            sound=sound_speed,
            compression=compression,
            max_compression=max(state.max_compression, compression),
            substep_count=substep_count,
        )
        if self._has_energy_gain(end_state):
            message = f"its energy changed to {self._energy(end_state)[0]:.3g} J, from "
            message += f"{state.energy:.3g} J"
            self._stop_for_long_step(state, t, dt, message, 1.0, notices)
        return end_state, result.wrenches

    def _run_kernel(
        self,
        state: FluidState,
        t: float,
        dt: float,
        accelerations: FloatArray,
        sound_speed: float,
        substep_count: int,
    ) -> PressureResult:
        """Return the state after all substeps; sheets collide after each block."""
        colliders, motion = self._colliders, state.motion
        collision_substeps = self._substeps.collision_substeps(
            colliders, substep_count, dt
        )
        substep = dt / collision_substeps
        pressures = np.zeros(len(state.ids))
        compression = 0.0
        wrenches = [Wrenches.zeros(system.count) for system in colliders.bodies]
        for k in range(collision_substeps):
            t0 = t + k * substep
            t1 = t0 + substep
            start_motion = motion
            solid_colliders = self._solid_colliders(t0)
            motion, step_pressures, body_impulses, step_compression = (
                _kernels.fluid_steps(
                    solid_colliders.kernel_arrays(t0, t1),
                    body_owners(colliders.bodies, len(solid_colliders)),
                    pushable_table(colliders.bodies, t0, t1),
                    motion,
                    accelerations,
                    self._spec.spacing,
                    self._spec.density,
                    self._spec.viscosity,
                    self._spec.tension,
                    sound_speed,
                    substep,
                    -(-substep_count // collision_substeps),
                )
            )
            pressures += step_pressures / collision_substeps
            compression = max(compression, step_compression)
            if colliders.sheets:
                sheets = Colliders((), colliders.sheets)
                radius = self._spec.spacing / 2
                x, v = motion
                collision = collide(x, v, start_motion, sheets, t0, t1, radius)
                motion = np.stack([collision.points, collision.velocities])
            impulses = split_by_system(colliders.bodies, body_impulses)
            wrenches = [
                Wrenches.sum([earlier_wrenches.delayed_by(substep), Wrenches(*system)])
                for earlier_wrenches, system in zip(wrenches, impulses, strict=True)
            ]
        return PressureResult(motion, pressures, compression, wrenches)

    def _solid_colliders(self, t: float) -> Colliders:
        """Return the colliders of the pressure solve: rigid ones, closed surfaces."""
        colliders = self._colliders
        closed_sheets = [
            sheet.collider(sheet.motion.points(t), sheet.motion.triangles(t))
            for sheet in colliders.sheets
            if sheet.closed
        ]
        if closed_sheets:
            return Colliders([*colliders, *closed_sheets], (), colliders.bodies)
        return colliders

    def _has_energy_gain(self, state: FluidState) -> bool:
        """Return whether the energy of a closed system grew beyond the tolerance."""
        total, kinetic_energy, has_all_potentials = self._energy(state)
        if not has_all_potentials or not self._conserves_energy:
            return False
        gain = total - state.energy
        # Potential energy is exchanged as well.
        exchanged_energy = max(kinetic_energy, state.energy - (total - kinetic_energy))
        mass = self._mass * len(state.ids)
        exchanged_energy += mass * state.sound**2 * self._spec.compression
        return gain > MAX_ENERGY_GROWTH * exchanged_energy

    def _stop_for_long_step(
        self,
        state: FluidState,
        t: float,
        dt: float,
        message: str,
        min_ratio: float,
        notices: list[Fault] | None,
    ) -> None:
        """Raise SIM102 because the step is too long; suggest a shorter one."""
        step = None
        if notices is not None and min_ratio < MAX_SHORTENING:
            step = self._find_stable_step(state, t, dt, min_ratio)
        hint = REMEDY_HINT
        if step is not None:
            hint = f"step: {plain_number(step)}, or {REMEDY_HINT}"
        self._stop("SIM102", t + dt, message, hint)

    def _find_stable_step(
        self, state: FluidState, t: float, dt: float, min_ratio: float
    ) -> float | None:
        """Return a shorter step that succeeds from a state [s]; None if none does.

        The step is shorter by a factor above ``min_ratio``.
        """
        for divisor in STEP_DIVISORS:
            step = floor_to_two_digits(dt / (min_ratio * divisor))
            if self._is_stable_step(state, t, step):
                return step
        return None

    def _is_stable_step(self, state: FluidState, t: float, step: float) -> bool:
        """Return whether the first steps of length ``step`` [s] succeed."""
        try:
            for k in range(TRIAL_STEPS):
                time = t + k * step
                accelerations = self._accelerations(state, time)
                state, _ = self._solve_pressure(state, time, step, accelerations)
        except StoppedError:
            return False
        return True

    def _stop(self, code: str, t: float, reason: str, hint: str) -> None:
        """Stop the simulation: raise a fault code with a reason."""
        verb = "blew up" if code == "SIM102" else "collapsed"
        message = f"{self._spec.name} {verb} at {t:g} s: {reason}"
        raise StoppedError([Fault(code, message, hint=hint)])

    def _remove_drained(self, state: FluidState, t: float) -> FluidState:
        """Return a state without the particles in drains."""
        is_kept = np.ones(len(state.ids), bool)
        for drain in self._drains:
            is_kept &= drain.sample(state.motion[0], t).distances[0] >= 0
        return state if is_kept.all() else self._select(state, is_kept)

    def _select(self, state: FluidState, is_selected: BoolArray) -> FluidState:
        """Return a state with the selected particles only."""
        remaining_state = replace(
            state,
            ids=state.ids[is_selected],
            motion=np.ascontiguousarray(state.motion[:, is_selected]),
            births=state.births[is_selected],
            pressures=state.pressures[is_selected],
        )
        removed_energy = self._energy(state)[0] - self._energy(remaining_state)[0]
        return replace(remaining_state, energy=state.energy - removed_energy)

    def _add_inflow(
        self,
        state: FluidState,
        t: float,
        end: float,
        accelerations: FloatArray,
        notices: list[Fault],
    ) -> FluidState:
        """Return a state with the inflow of a step, at the end of the step."""
        gravity = accelerations.mean(axis=0) if len(accelerations) else np.zeros(3)
        for nozzle in self._nozzles:
            capacity = max(self._spec.max_particles - len(state.ids), 0)
            inflow = nozzle.inflow(t, end, gravity, capacity)
            if inflow.skipped_count:
                limit = self._spec.max_particles
                message = f"the limit of {limit:,} particles is reached at {end:g} s "
                message += "and stops the emitters"
                hint = "raise max_particles, open a drain, or close an emitter"
                notices.append(warning("SIM121", message, hint))
            points, spacing = state.motion[0], self._spec.spacing
            has_room = find_clear_points(
                inflow.state[0], points, self._colliders, end, spacing
            )
            blocked_count = int((~has_room).sum())
            if blocked_count:
                message = f"{counted(blocked_count, 'particle')} could not be emitted "
                message += f"until {end:g} s: fluid or a collider blocks the nozzle"
                hint = "use a faster or higher nozzle, or move it away from colliders"
                notices.append(warning("SIM138", message, hint))
            count, new_motion = int(has_room.sum()), inflow.state[:, has_room]
            next_state = replace(
                state,
                ids=np.concatenate([state.ids, state.made + np.arange(count)]),
                motion=np.concatenate([state.motion, new_motion], axis=1),
                births=np.concatenate([state.births, inflow.births[has_room]]),
                pressures=np.concatenate([state.pressures, np.zeros(count)]),
                made=state.made + count,
                held=state.held + inflow.skipped_count + blocked_count,
            )
            energy = state.energy
            if count:
                energy += self._energy(next_state)[0] - self._energy(state)[0]
            state = replace(next_state, energy=energy)
        return state

    def _quantities(self, state: FluidState, t: float) -> Quantities:
        """Return the quantities by which particles can be coloured, by name."""
        points = np.ascontiguousarray(state.motion[0])
        return {
            "age": lambda: t - state.births,
            "density": lambda: _kernels.fluid_densities(
                self._solid_colliders(t).kernel_arrays(t, t), points, self._spec.spacing
            ),
            "pressure": lambda: state.pressures,
            "speed": lambda: np.linalg.norm(state.motion[1], axis=1),
        }

    def frame(self, state: FluidState, t: float) -> PointsFrame | MeshFrame:
        """Return the particles, or their surface mesh."""
        spec, (points, velocities) = self._spec, state.motion
        quantities = self._quantities(state, t)
        primvars: dict[str, Any] = {name: quantities[name]() for name in spec.primvars}
        if self._colouring is not None:
            primvars["displayColor"] = self._colouring.colours(quantities)
        if spec.surface is not None:
            from animtool.systems.fluid.surface import build_surface

            return build_surface(spec, points, velocities, primvars)
        radii = np.full(len(points), spec.spacing / 2)
        return PointsFrame(state.ids, points, velocities, radii, primvars)

    def diagnostics(self, state: FluidState, t: float) -> Diagnostics:  # noqa: ARG002
        """Return the number, compression, pressure and speed of particles."""
        total, kinetic_energy, has_all_potentials = self._energy(state)
        speeds = np.linalg.norm(state.motion[1], axis=1)
        values = {
            "particles": float(len(state.ids)),
            "compression": state.compression,
            "densest": state.max_compression,
            "pressure": float(state.pressures.max(initial=0.0)),
            "speed": float(speeds.max(initial=0.0)),
            "parts": float(state.substep_count),
        }
        if state.held:
            values["held_back"] = float(state.held)
        hint = "give it a fill, or a nozzle that is open in the range"
        message = "there is no fluid in any frame"
        empty_warning = warning("SIM188", message, hint)
        energy = None
        if has_all_potentials and self._conserves_energy:
            energy = Energy(kinetic_energy, total - kinetic_energy)
        return Diagnostics(energy, values, self._notices, [empty_warning])


@dataclass(frozen=True, slots=True)
class PressureResult:
    """Motion, pressures and wrenches after all substeps of a pressure solve."""

    motion: FloatArray  # (2, N, 3)
    pressures: FloatArray  # (N,) [Pa]
    compression: float
    wrenches: Sequence[Wrenches]  # impulses on the bodies of each system
