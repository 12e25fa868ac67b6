"""Build one particle system from the ropes, strands, cloth and volumes of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, warning
from animtool.core.quantities import length_text
from animtool.maths import so3
from animtool.systems.framework.body_carriers import BodyCarrier, CarrierBodies
from animtool.systems.framework.simulation import SimContext
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
from animtool.systems.springs.body_coupling import BodyAttachment, BodyCoupling
from animtool.systems.springs.constraints import merge_constraints
from animtool.systems.springs.entry import SpringEntry, join_pairs
from animtool.systems.springs.notices import MAX_LENGTH_RATIO, stretch_warning
from animtool.systems.springs.pins import (
    air_of,
    align_to_pins,
    constraints_of,
    wind_targets,
)
from animtool.systems.springs.simulation import SpringSimulation
from animtool.systems.springs.spec import FaceWindModel, SpringsModel
from animtool.systems.springs.trajectories import plan_springs
from animtool.systems.springs.view import SpringView

# Largest unreported distance between merged or pinned particles [m].
MAX_GAP = 1e-4


def build(spec: SpringsModel, context: SimContext) -> SpringSimulation:
    """Return the simulation of one entry, or of joined entries."""
    return _SystemBuilder(spec, context).simulation()


class _SystemBuilder:
    """Joins the bodies of all entries into one particle system."""

    def __init__(self, spec: SpringsModel, context: SimContext) -> None:
        self._spec, self._context = spec, context
        self._entries: list[SpringEntry] = [member.record for member in context.members]
        self._notices: list[Fault] = []  # warnings about the joined system
        bodies, constraints = self._position_bodies()
        starts = np.cumsum([0, *(len(body.positions) for body in bodies)])
        welded = weld(join(bodies), join_pairs(context.members, starts))
        self._warn_gap("particles that are joined are", welded.gap)
        self._rows: list[IntArray] = [  # particle indices in the system, by body
            welded.rows[start : start + len(body.positions)]
            for start, body in zip(starts, bodies, strict=False)
        ]
        self._system = self._build_system(welded, constraints)

    def simulation(self) -> SpringSimulation:
        """Return the simulation with one view for each entry."""
        context, spec = self._context, self._spec
        plan = plan_springs(
            self._system, spec.options, context, starts_at_rest=spec.settle
        )
        start_grid = plan.start(context.begin)
        simulation = SpringSimulation(plan, start_grid, context.last, context.clock())
        counts = [len(entry.body.body.springs.rest) for entry in self._entries]
        ends = np.cumsum(counts).tolist()
        for k, member in enumerate(context.members):
            springs = slice(ends[k] - counts[k], ends[k])
            notices = (*self._entries[k].body.notices, *(() if k else self._notices))
            view = SpringView(
                simulation, member, self._rows[k], springs, notices, is_first=not k
            )
            simulation.views.append(view)
        return simulation

    def _position_bodies(self) -> tuple[list[Body], list[list[Pins | PointTargets]]]:
        """Return bodies moved to their pins, and the pins and targets of each."""
        bodies, constraints, begin = [], [], self._context.begin
        any_uses_faces = any(_uses_faces(entry) for entry in self._entries)
        for entry in self._entries:
            body = entry.body.body
            pins = [(pin, pin.poses(self._context.poses)) for pin in entry.pins]
            points = align_to_pins(pins, body.positions, begin)
            constraints.append(constraints_of(pins, points))
            pinned_points = points.copy()
            for pin, poses in pins:
                if pin.model.stiffness is None:
                    pinned_points[pin.particles] = pin.start(poses, points, begin)
            max_gap = float(np.linalg.norm(pinned_points - points, axis=1).max())
            self._warn_gap("pins hold particles", max_gap)
            # With several entries, wind acts on the faces of those that request it.
            has_wind = not any_uses_faces or _uses_faces(entry)
            triangles = body.triangles if has_wind else body.triangles[:0]
            bodies.append(replace(body, positions=pinned_points, triangles=triangles))
        return bodies, constraints

    def _build_system(
        self, welded: Welded, constraints: Sequence[Sequence[Pins | PointTargets]]
    ) -> SpringSystem:
        """Return the system of joined bodies with their pins, targets and wind."""
        spec, context = self._spec, self._context
        all_constraints: list[Pins | PointTargets] = []
        resistance = np.zeros(len(welded.body.positions))
        air, contact = None, None
        for entry, rows, entry_constraints in zip(
            self._entries, self._rows, constraints, strict=True
        ):
            particle_constraints = list(entry_constraints)
            drags = entry.spec.drag * entry.body.body.masses
            wind = entry.spec.air
            if isinstance(wind, FaceWindModel) or wind is None:
                np.add.at(resistance, rows, drags)
                air = air if wind is None else air_of(wind)
            else:
                span = context.begin, context.last
                points = welded.body.positions[rows]
                particle_constraints.append(wind_targets(wind, points, drags, span))
            for constraint in particle_constraints:
                particles = rows[np.asarray(constraint.particles)]
                all_constraints.append(replace(constraint, particles=particles))
            contact = entry.spec.contact or contact
        system = SpringSystem(
            welded.body,
            pins=merge_constraints(all_constraints, Pins),
            targets=merge_constraints(all_constraints, PointTargets),
            gravity=spec.gravity,
            resistance=resistance,
            air=air,
            colliders=context.colliders,
            radius=spec.radius,
            speed_limit=spec.speed_limit,
            self_contact=contact,
        )
        system.coupling = self._body_coupling(system)
        return self._settle(system) if spec.settle else system

    def _body_coupling(self, system: SpringSystem) -> BodyCoupling | None:
        """Return the pins on rigid bodies of other systems; None if there are none."""
        carriers = self._context.carriers
        names, attachments = list(carriers), []
        column_of_particle = {n: k for k, n in enumerate(system.pinned.tolist())}
        for entry, rows in zip(self._entries, self._rows, strict=True):
            for pin in entry.pins:
                if not isinstance(pin.carrier, BodyCarrier):
                    continue
                carrier, pinned = carriers[pin.carrier.system], rows[pin.particles]
                points = system.body.positions[pinned]
                self._warn_distant_pins(entry.spec.name, pin.carrier, carrier, points)
                frame = carrier.start(pin.carrier).rows[0]
                columns = [column_of_particle[n] for n in pinned.tolist()]
                attachments.append(
                    BodyAttachment(
                        np.array(columns, np.int64),
                        names.index(pin.carrier.system),
                        carrier.body_index(pin.carrier),
                        so3.rotate(so3.conjugate(frame[3:]), points - frame[:3]),
                        system.body.masses[pinned],
                    )
                )
        if not attachments:
            return None
        systems, spring_length = list(carriers.values()), system.mean_rest_length
        return BodyCoupling(systems, attachments, system.gravity, spring_length)

    def _warn_distant_pins(
        self, name: str, carrier: BodyCarrier, bodies: CarrierBodies, points: FloatArray
    ) -> None:
        """Warn about pins that start farther from a body than the size of the body."""
        gap, size = bodies.surface_distance(carrier, points)
        if gap > size:
            message = f"the pins of {name!r} start {length_text(gap)} from the surface "
            message += f"of {carrier.body!r}, whose points are within "
            message += f"{length_text(size)} of its centre: the pins move as if on a "
            message += "rigid arm"
            hint = "place the particles on the body, or give the pin an offset"
            self._notices.append(warning("SIM160", message, hint, carrier.where))

    def _settle(self, system: SpringSystem) -> SpringSystem:
        """Return the system starting in static equilibrium; warn if it has none."""
        progress = self._context.phase()
        equilibrium = find_rest(system, self._context.begin, progress=progress)
        if not equilibrium.solved:
            message = "no rest state was found: forces of "
            message += f"{equilibrium.residual:.2g} N remain"
            hint = "let it settle in a preroll, with drag"
            if _stands_on_pins(system):
                message = "it stands upright on its pins, and would fall over"
                hint = "pin its other end, or let it settle in a preroll, with drag"
            self._notices.append(warning("SIM152", message, hint, "settle"))
        springs = system.body.springs
        has_length = springs.rest > 0
        lengths = springs.lengths(equilibrium.positions)
        ratios = np.divide(
            lengths, springs.rest, out=np.ones_like(lengths), where=has_length
        )
        if ratios.max(initial=1.0) > MAX_LENGTH_RATIO:
            longest = int(ratios.argmax())
            strain, stiffness = ratios[longest] - 1.0, springs.stiffness[longest]
            fault = stretch_warning(float(strain), float(stiffness))
            self._notices.append(replace(fault, where="springs"))
        return system.starting_at(equilibrium.positions)

    def _warn_gap(self, subject: str, gap: float) -> None:
        """Warn about merged or pinned particles that start a gap [m] apart."""
        if gap > MAX_GAP:
            distance = length_text(gap)
            message = f"{subject} {distance} from where they are built: springs pull"
            hint = "place them to match, or give pins an offset"
            self._notices.append(warning("SIM150", message, hint, "pins"))


def _stands_on_pins(system: SpringSystem) -> bool:
    """Return whether all free particles are above the pins, as in an upright rope."""
    heights = -system.body.positions @ system.gravity
    free_heights, pin_heights = heights[~system.is_pinned], heights[system.is_pinned]
    has_both = len(free_heights) > 0 and len(pin_heights) > 0
    return has_both and bool(free_heights.min() > pin_heights.max())


def _uses_faces(entry: SpringEntry) -> bool:
    """Return whether wind acts on the faces of an entry, or the faces collide."""
    return isinstance(entry.spec.air, FaceWindModel) or entry.spec.contact is not None
