"""Build one particle system from the ropes, strands, cloth and volumes of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, warning
from animtool.core.quantities import length_text
from animtool.maths import so3
from animtool.systems.framework.simulation import SimContext
from animtool.systems.framework.tied import BodyCarrier, TiedBodies
from animtool.systems.springs import (
    Body,
    Pins,
    PointTargets,
    SpringSystem,
    Welded,
    find_rest,
    join,
    weld,
)
from animtool.systems.springs.entry import SpringEntry, join_pairs
from animtool.systems.springs.paths import combined
from animtool.systems.springs.pins import air_of, moved_to_pins, ties_of, wind_ties
from animtool.systems.springs.simulating import plan_springs
from animtool.systems.springs.simulation import SpringSimulation
from animtool.systems.springs.spec import FaceWindModel, SpringsModel
from animtool.systems.springs.ties import BodyTies, Tie
from animtool.systems.springs.view import SpringView

# Distance between merged or pinned particles above which a warning is given [m].
MAX_GAP = 1e-4


def build(spec: SpringsModel, context: SimContext) -> SpringSimulation:
    """Return the simulation of one entry, or of joined entries."""
    return _SystemBuilder(spec, context).simulation()


class _SystemBuilder:
    """Builds one particle system from several bodies."""

    def __init__(self, spec: SpringsModel, context: SimContext) -> None:
        self._spec, self._context = spec, context
        self._entries: list[SpringEntry] = [member.record for member in context.members]
        self._notices: list[Fault] = []  # warnings about the joined system
        bodies, ties = self._position_bodies()
        starts = np.cumsum([0, *(len(body.positions) for body in bodies)])
        welded = weld(join(bodies), join_pairs(context.members, starts))
        self._warn_gap("particles that are joined are", welded.gap)
        self._rows: list[IntArray] = [  # particle indices in the system, by body
            welded.rows[start : start + len(body.positions)]
            for start, body in zip(starts, bodies, strict=False)
        ]
        self._system = self._build_system(welded, ties)

    def simulation(self) -> SpringSimulation:
        """Return the simulation with one view for each entry."""
        context, spec = self._context, self._spec
        plan = plan_springs(self._system, spec.options, context, settled=spec.settle)
        start_grid = plan.start(context.begin)
        simulation = SpringSimulation(plan, start_grid, context.last, context.clock())
        springs = 0
        views: list[SpringView] = []
        for member, rows in zip(context.members, self._rows, strict=True):
            entry: SpringEntry = member.record
            spring_rows = slice(springs, springs + len(entry.body.body.springs.rest))
            springs = spring_rows.stop
            notices = (*entry.body.notices, *(() if views else self._notices))
            views.append(
                SpringView(
                    simulation, member, rows, spring_rows, notices, first=not views
                )
            )
        simulation.views = views
        return simulation

    def _position_bodies(self) -> tuple[list[Body], list[list[Pins | PointTargets]]]:
        """Return bodies moved to their pins, and pins and targets of each."""
        bodies, ties, begin = [], [], self._context.begin
        has_acting_faces = any(_has_acting_faces(entry) for entry in self._entries)
        for entry in self._entries:
            body = entry.body.body
            pins = [(pin, pin.poses(self._context.poses)) for pin in entry.pins]
            points = moved_to_pins(pins, body.positions, begin)
            ties.append(ties_of(pins, points))
            pinned = points.copy()
            for pin, frame in pins:
                if pin.model.stiffness is None:
                    pinned[pin.particles] = pin.start(frame, points, begin)
            gap = float(np.linalg.norm(pinned - points, axis=1).max())
            self._warn_gap("pins hold particles", gap)
            # With several entries, wind acts on the faces of those that request it.
            feels_wind = not has_acting_faces or _has_acting_faces(entry)
            triangles = body.triangles if feels_wind else body.triangles[:0]
            bodies.append(replace(body, positions=pinned, triangles=triangles))
        return bodies, ties

    def _build_system(
        self, welded: Welded, ties: Sequence[Sequence[Pins | PointTargets]]
    ) -> SpringSystem:
        spec, context = self._spec, self._context
        all_ties: list[Pins | PointTargets] = []
        resistance = np.zeros(len(welded.body.positions))
        air, contact = None, None
        for entry, rows, entry_ties in zip(
            self._entries, self._rows, ties, strict=True
        ):
            particle_ties = list(entry_ties)
            drags = entry.spec.drag * entry.body.body.masses
            wind = entry.spec.air
            if isinstance(wind, FaceWindModel) or wind is None:
                np.add.at(resistance, rows, drags)
                air = air if wind is None else air_of(wind)
            else:
                span = context.begin, context.last
                points = welded.body.positions[rows]
                particle_ties.append(wind_ties(wind, points, drags, span))
            for tie in particle_ties:
                all_ties.append(replace(tie, particles=rows[np.asarray(tie.particles)]))
            contact = entry.spec.contact or contact
        system = SpringSystem(
            welded.body,
            pins=combined([tie for tie in all_ties if isinstance(tie, Pins)]),
            targets=combined(
                [tie for tie in all_ties if isinstance(tie, PointTargets)]
            ),
            gravity=spec.gravity,
            resistance=resistance,
            air=air,
            colliders=context.colliders,
            radius=spec.radius,
            speed_limit=spec.speed_limit,
            self_contact=contact,
        )
        system.ties = self._tie_pins(system)
        return self._settle(system) if spec.settle else system

    def _tie_pins(self, system: SpringSystem) -> BodyTies | None:
        """Return the rigid bodies that carry pins; None if there are none."""
        carriers = self._context.carriers
        names, ties = list(carriers), []
        columns = {n: k for k, n in enumerate(system.pinned.tolist())}
        for entry, rows in zip(self._entries, self._rows, strict=True):
            for pin in entry.pins:
                if not isinstance(pin.carrier, BodyCarrier):
                    continue
                bodies, pinned = carriers[pin.carrier.system], rows[pin.particles]
                points = system.body.positions[pinned]
                self._warn_distant(entry.spec.name, pin.carrier, bodies, points)
                frame = bodies.start(pin.carrier).rows[0]
                ties.append(
                    Tie(
                        np.array([columns[n] for n in pinned.tolist()], np.int64),
                        names.index(pin.carrier.system),
                        bodies.number(pin.carrier),
                        so3.rotate(so3.conjugate(frame[3:]), points - frame[:3]),
                        system.body.masses[pinned],
                    )
                )
        if not ties:
            return None
        return BodyTies(list(carriers.values()), ties, system.gravity, system.spacing)

    def _warn_distant(
        self, name: str, carrier: BodyCarrier, bodies: TiedBodies, points: FloatArray
    ) -> None:
        """Warn about pins that start farther from their body than its size."""
        gap, size = bodies.gap(carrier, points)
        if gap > size:
            message = f"pins of {name} start {length_text(gap)} from the surface of "
            message += (
                f"{carrier.body!r}, which has a size of {length_text(size)}: it is "
            )
            message += "moved as by a rigid arm"
            hint = "place the particles at the body, or give the pin an offset"
            self._notices.append(warning("SIM160", message, hint, carrier.where))

    def _settle(self, system: SpringSystem) -> SpringSystem:
        """Return the system with its static equilibrium as the start."""
        rest = find_rest(system, self._context.begin, progress=self._context.phase())
        if not rest.solved:
            message = f"no rest state was found: forces of {rest.residual:.2g} N remain"
            hint = "let it settle in a preroll, with drag"
            if _stands_on_pins(system):
                message = "it stands upright on its pins, and would fall over"
                hint = "pin its other end, or let it settle in a preroll, with drag"
            self._notices.append(warning("SIM152", message, hint, "settle"))
        return system.starting_at(rest.positions)

    def _warn_gap(self, what: str, gap: float) -> None:
        if gap > MAX_GAP:
            message = f"{what} {length_text(gap)} from where they are built: springs "
            hint = "place them to match, or give pins an offset"
            self._notices.append(warning("SIM150", f"{message}pull", hint, "pins"))


def _stands_on_pins(system: SpringSystem) -> bool:
    """Return whether all that is free is above the pins, like a rope on its end."""
    heights = -system.body.positions @ system.gravity
    is_free = np.ones(len(heights), np.bool_)
    is_free[system.pinned] = False
    return bool(
        is_free.any()
        and not is_free.all()
        and heights[is_free].min() > heights[~is_free].max()
    )


def _has_acting_faces(entry: SpringEntry) -> bool:
    """Return whether the faces of a body feel wind or collide with themselves."""
    return isinstance(entry.spec.air, FaceWindModel) or entry.spec.contact is not None
