"""Fluid simulation: steps with a pressure solve."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from typing import Any

import numpy as np

from animtool import _kernels
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, counted, warning
from animtool.core.quantities import floored, plain
from animtool.core.record import dataclass
from animtool.motion.frames import MeshFrame, PointsFrame
from animtool.sim.colliders import Colliders, collide
from animtool.sim.colliders.bodies import (
    Wrenches,
    body_owners,
    by_system,
    pushable_rows,
)
from animtool.sim.system import Energy
from animtool.systems.fluid.filling import Nozzle, coarse_drops, filled, has_room
from animtool.systems.fluid.spec import FluidModel
from animtool.systems.fluid.substeps import Substeps
from animtool.systems.framework.colours import Colouring, Quantities
from animtool.systems.framework.simulation import (
    Diagnostics,
    SimContext,
    Stepped,
    StoppedError,
    growing,
)
from animtool.systems.particles.forces.base import Force
from animtool.systems.particles.state import ParticleState

# Mean compression above which a fluid has collapsed, and likewise over the requested
# compression.
COLLAPSED, TIMES = 0.1, 5
# Fraction of the energy in play that may appear without a source.
GROWTH = 0.05
# Substeps are doubled as long as compression falls below this fraction.
HELPS = 0.8
# If a step must be this many times shorter, the step is not the cause.
MAX_SHORTENING = 1000
# Step divisors that are tried for a hint, and trial steps of each.
ROOM, TRIED = (2.0, 4.0, 8.0, 16.0), 4
LESS = "use weaker forces, a larger spacing, or slower colliders"
_NONE = np.zeros((2, 0, 3))


@dataclass(frozen=True, slots=True)
class FluidState:
    """N particles at the end of a step."""

    ids: IntArray = field(metadata=growing())  # ascending (N,)
    motion: FloatArray = field(metadata=growing(1))  # [m], then [m/s] (2, N, 3)
    births: FloatArray = field(metadata=growing())  # birth times (N,) [s]
    pressures: FloatArray = field(metadata=growing())  # means over the step (N,) [Pa]
    made: int = 0  # number born so far
    held: int = 0  # number held back so far, for lack of room
    sound: float = 0.0  # speed of sound [m/s]
    energy: float = 0.0  # upper bound of kinetic and potential energy [J]
    compression: float = 0.0  # mean compression [1]
    densest: float = 0.0  # largest compression so far [1]
    parts: int = 0  # substeps of the last step


def build(spec: FluidModel, context: SimContext) -> Fluid:
    """Return the fluid of a spec, its fills made.

    Raises:
        OptionError: Something of the spec makes no sense (SIM064).
    """
    parts, colliders, begin = context.parts, context.colliders, context.begin
    start = filled(spec, parts.get("fills", ()), colliders, begin)
    emitters = zip(spec.emitters, parts.get("emitters", ()), strict=True)
    nozzles = [Nozzle(spec, one, part["poses"], begin) for one, part in emitters]
    notices = colliders.notices()
    notices += coarse_drops(spec, parts.get("fills", ()))
    if spec.surface is not None:
        from animtool.systems.fluid.surface import check_surface

        check_surface()
    return Fluid(
        spec,
        begin,
        colliders,
        parts.get("forces", ()),
        start,
        nozzles,
        [Colliders([drain.volume()]) for drain in parts.get("drains", ())],
        notices,
    )


class Fluid:
    """An incompressible fluid of particles, in steps."""

    def __init__(
        self,
        spec: FluidModel,
        begin: float,
        colliders: Colliders,
        forces: Sequence[Force],
        start: FloatArray,
        nozzles: Sequence[Nozzle],
        drains: Sequence[Colliders],
        notices: list[Fault],
    ) -> None:
        """``start``: positions and velocities at ``begin`` [s] ``(2, N, 3)``."""
        self._spec, self._begin, self._start = spec, begin, start
        self._colliders, self._forces = colliders, forces
        self._nozzles, self._drains, self._notices = nozzles, drains, notices
        self._mass = spec.density * spec.spacing**3
        self._substeps = Substeps(spec)
        self._colouring = None if spec.colour is None else Colouring.of(spec.colour, {})
        # No energy can enter: the initial energy is an upper bound.
        static = not colliders.bodies and not colliders.sheets
        self._closed = static and all(len(c.poses.sample_times) == 1 for c in colliders)

    def initial(self) -> FluidState:
        """Return the initial state."""
        count = self._start.shape[1]
        state = FluidState(
            np.arange(count, dtype=np.int64),
            self._start,
            np.full(count, self._begin),
            np.zeros(count),
            made=count,
        )
        pull = self._pull(state, self._begin)
        sound = self._substeps.first_sound(self._start[0], pull)
        return replace(state, sound=sound, energy=self._energy(state)[0])

    def incompatibility(self, state: FluidState, t: float) -> str:
        """Return why a saved state cannot be resumed; empty if it can."""
        del t
        return "" if state.sound >= 0 else "the speed of sound is below 0"

    def step(self, state: FluidState, t: float, dt: float) -> Stepped[FluidState]:
        """Return the state after a step [s], and impulses on bodies.

        Raises:
            StoppedError: It collapsed, or the step is too long (SIM102, SIM108).
        """
        until, notices = t + dt, list[Fault]()
        pull = self._pull(state, t)
        if not np.isfinite(pull).all():
            self._stop("SIM102", until, "a force is not finite", "weaker forces")
        wrenches: Sequence[Wrenches] = [
            Wrenches.none(system.count) for system in self._colliders.bodies
        ]
        if len(state.ids):
            state, wrenches = self._pressed(state, t, dt, pull, notices)
        state = self._drained(state, until)
        state = self._fed(state, t, until, pull, notices)
        return Stepped(state, wrenches, notices)

    def _particles(self, state: FluidState) -> ParticleState:
        """Return the fluid as particles, for forces."""
        half, points = self._spec.spacing / 2, state.motion[0]
        return ParticleState.lasting(state.ids, self._mass, half, state.births, points)

    def _pull(self, state: FluidState, t: float) -> FloatArray:
        """Return accelerations of forces ``(N, 3)`` [m/s²]."""
        (x, v), particles = state.motion, self._particles(state)
        accelerations: FloatArray = np.zeros_like(x)
        with np.errstate(all="ignore"):
            for force in self._forces:
                accelerations += force.force(t, x, v, particles) / self._mass
        return accelerations

    def _energy(self, state: FluidState) -> tuple[float, float, bool]:
        """Return total and kinetic energy [J], and whether potentials are known."""
        kinetic = 0.5 * self._mass * float((state.motion[1] ** 2).sum())
        particles, total, known = self._particles(state), kinetic, True
        for force in self._forces:
            potentials = force.potential(state.motion[0], particles)
            known &= potentials is not None
            total += 0.0 if potentials is None else float(potentials.sum())
        if self._spec.tension:
            points = np.ascontiguousarray(state.motion[0])
            area = _kernels.fluid_area(points, self._spec.spacing)
            total += self._spec.tension * area
        return total, kinetic, known

    def _pressed(
        self,
        state: FluidState,
        t: float,
        dt: float,
        pull: FloatArray,
        notices: list[Fault] | None = None,
    ) -> tuple[FluidState, Sequence[Wrenches]]:
        """Return the state after a step, in as many substeps as density needs.

        Without a list of notices it is a trial, which looks for no shorter step.
        """
        speeds = np.linalg.norm(state.motion[1], axis=1) + self._colliders.fastest
        max_pull = float(np.linalg.norm(pull, axis=1).max())
        fastest = float(speeds.max()) + max_pull * dt
        sound = self._substeps.sound(state.sound, state.pressures, speeds, max_pull, dt)
        needed = self._substeps.parts(dt, fastest, sound)
        if needed > self._substeps.most:
            most, spacing = self._substeps.most, self._spec.spacing
            message = f"at {fastest:.3g} m/s and a spacing of {spacing:g} m, a step of "
            message += f"{dt:g} s needs more than {most} substeps"
            self._stop_long(state, t, dt, message, needed / most, notices)
        parts, allowed = int(needed), self._spec.compression
        pressed = self._kernel(state, t, dt, pull, sound, parts)
        while pressed.compression > allowed and 2 * parts <= self._substeps.most:
            again = self._kernel(state, t, dt, pull, 2 * sound, 2 * parts)
            if again.compression > HELPS * pressed.compression:
                break
            pressed, sound, parts = again, 2 * sound, 2 * parts
        if not np.isfinite(pressed.motion).all():
            self._stop("SIM102", t + dt, "numbers are not finite", "use shorter steps")
        dense = pressed.compression
        if dense > max(COLLAPSED, TIMES * allowed):
            message = f"it is {dense:.1%} denser than at rest: there is too little room"
            hint = "enlarge its container, open a drain, or close an emitter earlier"
            self._stop("SIM108", t + dt, message, hint)
        if dense > allowed and notices is not None:
            message = f"it is {dense:.2%} denser than at rest at "
            message += f"{t + dt:g} s; the limit is {allowed:.2%}"
            notices.append(
                warning("SIM137", message, "give it more room: it is compressed")
            )
        after = replace(
            state,
            motion=pressed.motion,
            pressures=pressed.pressures,
            sound=sound,
            compression=dense,
            densest=max(state.densest, dense),
            parts=parts,
        )
        if self._gains(after):
            message = f"its energy changed to {self._energy(after)[0]:.3g} J, from "
            message += f"{state.energy:.3g} J"
            self._stop_long(state, t, dt, message, 1.0, notices)
        return after, pressed.wrenches

    def _kernel(
        self,
        state: FluidState,
        t: float,
        dt: float,
        pull: FloatArray,
        sound: float,
        parts: int,
    ) -> Pressed:
        """Return the state after some substeps; sheets collide between pieces."""
        around, motion = self._colliders, state.motion
        pieces = self._substeps.collision_substeps(around, parts, dt)
        each, pressures, compression = dt / pieces, np.zeros(len(state.ids)), 0.0
        wrenches = [Wrenches.none(system.count) for system in around.bodies]
        for k in range(pieces):
            t0 = t + k * each
            before = motion
            solid = self._solid(t0)
            motion, pressed, pushes, dense = _kernels.fluid_steps(
                solid.arrays(t0, t0 + each),
                body_owners(around.bodies, len(solid)),
                pushable_rows(around.bodies, t0, t0 + each),
                motion,
                pull,
                self._spec.spacing,
                self._spec.density,
                self._spec.viscosity,
                self._spec.tension,
                sound,
                each,
                -(-parts // pieces),
            )
            pressures += pressed / pieces
            compression = max(compression, dense)
            if around.sheets:
                sheets = Colliders((), around.sheets)
                radius = self._spec.spacing / 2
                x, v = motion
                met = collide(x, v, before, sheets, t0, t0 + each, radius)
                motion = np.stack([met.points, met.velocities])
            wrenches = [
                Wrenches.sum([one.after(each), Wrenches(*system)])
                for one, system in zip(
                    wrenches, by_system(around.bodies, pushes), strict=True
                )
            ]
        return Pressed(motion, pressures, compression, wrenches)

    def _solid(self, t: float) -> Colliders:
        """Return the colliders of the pressure solve: rigid ones, and current skins."""
        around = self._colliders
        skins = [
            sheet.collider(sheet.motion.points(t), sheet.motion.triangles(t))
            for sheet in around.sheets
            if sheet.closed
        ]
        return Colliders([*around, *skins], (), around.bodies) if skins else around

    def _gains(self, state: FluidState) -> bool:
        """Return whether energy grew without a source."""
        total, kinetic, known = self._energy(state)
        if not known or not self._closed:
            return False
        gain = total - state.energy
        # Potential energy is in play as well.
        in_play = max(kinetic, state.energy - (total - kinetic))
        in_play += self._mass * len(state.ids) * state.sound**2 * self._spec.compression
        return gain > GROWTH * in_play

    def _stop_long(
        self,
        state: FluidState,
        t: float,
        dt: float,
        message: str,
        shorter: float,
        notices: list[Fault] | None,
    ) -> None:
        """Stop because a step is too long; suggest one, except in trials."""
        step = None
        if notices is not None and shorter < MAX_SHORTENING:
            step = self._working_step(state, t, dt, shorter)
        hint = LESS if step is None else f"step: {plain(step)}, or {LESS}"
        self._stop("SIM102", t + dt, message, hint)

    def _working_step(
        self, state: FluidState, t: float, dt: float, shorter: float
    ) -> float | None:
        """Return a shorter step that works from a state; None if none does.

        At least ``shorter`` times shorter, with a margin.
        """
        steps = (floored(dt / (shorter * room)) for room in ROOM)
        return next((step for step in steps if self._goes_on(state, t, step)), None)

    def _goes_on(self, state: FluidState, t: float, step: float) -> bool:
        """Return whether the first steps of a length [s] succeed from a state."""
        try:
            for k in range(TRIED):
                now = t + k * step
                state, _ = self._pressed(state, now, step, self._pull(state, now))
        except StoppedError:
            return False
        return True

    def _stop(self, code: str, t: float, why: str, hint: str) -> None:
        what = "blew up" if code == "SIM102" else "collapsed"
        message = f"{self._spec.name} {what} at {t:g} s: {why}"
        raise StoppedError([Fault(code, message, hint=hint)])

    def _drained(self, state: FluidState, t: float) -> FluidState:
        """Return a state without the particles in drains."""
        kept = np.ones(len(state.ids), bool)
        for drain in self._drains:
            kept &= drain.sample(state.motion[0], t).distances[0] >= 0
        return state if kept.all() else self._kept(state, kept)

    def _kept(self, state: FluidState, kept: BoolArray) -> FluidState:
        left = replace(
            state,
            ids=state.ids[kept],
            motion=np.ascontiguousarray(state.motion[:, kept]),
            births=state.births[kept],
            pressures=state.pressures[kept],
        )
        gone = self._energy(state)[0] - self._energy(left)[0]
        return replace(left, energy=state.energy - gone)

    def _fed(
        self,
        state: FluidState,
        t: float,
        until: float,
        pull: FloatArray,
        notices: list[Fault],
    ) -> FluidState:
        """Return a state with the inflow of a step, at its end."""
        for nozzle in self._nozzles:
            room = max(self._spec.max_particles - len(state.ids), 0)
            mean = pull.mean(axis=0) if len(pull) else np.zeros(3)
            new = nozzle.inflow(t, until, mean, room)
            if new.missed:
                most = self._spec.max_particles
                message = f"the limit of {most:,} particles is reached at {until:g} s "
                hint = "raise max_particles, open a drain, or close an emitter"
                notices.append(
                    warning("SIM121", f"{message}and stops the emitters", hint)
                )
            others, spacing = state.motion[0], self._spec.spacing
            free = has_room(new.state[0], others, self._colliders, until, spacing)
            blocked = int((~free).sum())
            if blocked:
                message = f"{counted(blocked, 'particle')} could not be emitted until "
                message += f"{until:g} s: fluid or a collider blocks the nozzle"
                hint = "use a faster or higher nozzle, or move it away from colliders"
                notices.append(warning("SIM138", message, hint))
            count = int(free.sum())
            grown = replace(
                state,
                ids=np.concatenate([state.ids, state.made + np.arange(count)]),
                motion=np.concatenate([state.motion, new.state[:, free]], axis=1),
                births=np.concatenate([state.births, new.births[free]]),
                pressures=np.concatenate([state.pressures, np.zeros(count)]),
                made=state.made + count,
                held=state.held + new.missed + blocked,
            )
            gained = self._energy(grown)[0] - self._energy(state)[0] if count else 0.0
            state = replace(grown, energy=state.energy + gained)
        return state

    def _quantities(self, state: FluidState, t: float) -> Quantities:
        points = np.ascontiguousarray(state.motion[0])
        return {
            "age": lambda: t - state.births,
            "density": lambda: _kernels.fluid_densities(
                self._solid(t).arrays(t, t), points, self._spec.spacing
            ),
            "pressure": lambda: state.pressures,
            "speed": lambda: np.linalg.norm(state.motion[1], axis=1),
        }

    def frame(self, state: FluidState, t: float) -> PointsFrame | MeshFrame:
        """Return the particles, or their surface mesh."""
        spec, (points, velocities) = self._spec, state.motion
        quantities = self._quantities(state, t)
        primvars: dict[str, Any] = {one: quantities[one]() for one in spec.primvars}
        if self._colouring is not None:
            primvars["displayColor"] = self._colouring.colours(quantities)
        if spec.surface is not None:
            from animtool.systems.fluid.surface import surface_of

            return surface_of(spec, points, velocities, primvars)
        radii = np.full(len(points), spec.spacing / 2)
        return PointsFrame(state.ids, points, velocities, radii, primvars)

    def diagnostics(self, state: FluidState, t: float) -> Diagnostics:  # noqa: ARG002
        """Return particle count, density, speed and depth."""
        total, kinetic, known = self._energy(state)
        speeds = np.linalg.norm(state.motion[1], axis=1)
        values: Mapping[str, float] = {
            "particles": float(len(state.ids)),
            "compression": state.compression,
            "densest": state.densest,
            "pressure": float(state.pressures.max(initial=0.0)),
            "speed": float(speeds.max(initial=0.0)),
            "parts": float(state.parts),
        }
        if state.held:
            values = {**values, "held_back": float(state.held)}
        hint = "give it a fill, or a nozzle that is open in the range"
        message = "there is no fluid in any frame"
        nobody = warning("SIM188", message, hint)
        energy = Energy(kinetic, total - kinetic) if known and self._closed else None
        return Diagnostics(energy, values, self._notices, [nobody])


@dataclass(frozen=True, slots=True)
class Pressed:
    """The result of a pressure step."""

    motion: FloatArray  # (2, N, 3)
    pressures: FloatArray  # (N,) [Pa]
    compression: float
    wrenches: Sequence[Wrenches]  # on bodies of each system
