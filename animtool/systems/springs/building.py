"""Ropes, strands, cloth and volumes of a scene as one system of particles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from animtool._types import IntArray
from animtool.errors import Fault
from animtool.quantities import length_text
from animtool.systems.simulation import SimContext
from animtool.systems.springs import Body, SpringSystem, Welded, find_rest, join, weld
from animtool.systems.springs.entry import (
    SpringEntry,
    contact_of,
    join_pairs,
    options_of,
    wind_of,
)
from animtool.systems.springs.motion import warning
from animtool.systems.springs.pins import (
    Tie,
    Ties,
    air_of,
    moved_to_pins,
    ties_of,
    wind_ties,
)
from animtool.systems.springs.simulation import SpringSimulation, SpringView
from animtool.systems.springs.spec import SpringsModel
from animtool.systems.springs.spec_parts import FaceWindModel

# Particles that are put together, or held, this far from where they are built are
# said to be apart [m].
APART = 1e-4


def build(spec: SpringsModel, context: SimContext) -> SpringSimulation:
    """Return springs that are joined, or those of one entry, at their beginning.

    Raises:
        FormatError: The file of a character is malformed.
        OptionError: Something makes no sense.
        ToleranceError: An error is to be kept, and it blew up at once.
    """
    return _Building(spec, context).simulation()


class _Building:
    """Bodies that become one system of particles."""

    def __init__(self, spec: SpringsModel, context: SimContext) -> None:
        self._spec, self._context = spec, context
        self._entries: list[SpringEntry] = [one.record for one in context.members]
        self._notices: list[Fault] = []  # what is odd about them together
        bodies, ties = self._placed()
        starts = np.cumsum([0, *(len(body.positions) for body in bodies)])
        welded = weld(join(bodies), join_pairs(context.members, starts))
        self._say_apart("particles that are joined are", welded.gap)
        self._rows: list[IntArray] = [  # of each body, its particles in the system
            welded.rows[start : start + len(body.positions)]
            for start, body in zip(starts, bodies, strict=False)
        ]
        self._system = self._made(welded, ties)

    def simulation(self) -> SpringSimulation:
        """Return them with what each entry shows."""
        context = self._context
        made = SpringSimulation(
            self._system, options_of(self._spec), context.begin, context
        )
        springs = 0
        views: list[SpringView] = []
        for member, rows in zip(context.members, self._rows, strict=True):
            entry: SpringEntry = member.record
            own = slice(springs, springs + len(entry.body.body.springs.rest))
            springs = own.stop
            notices = (*entry.body.notices, *(() if views else self._notices))
            views.append(SpringView(made, member, rows, own, notices, first=not views))
        made.views = views
        return made

    def _placed(self) -> tuple[list[Body], list[list[Tie]]]:
        """Return bodies where pins have them, and what ties each."""
        bodies, ties, begin = [], [], self._context.begin
        for entry in self._entries:
            body, pins = entry.body.body, entry.pins
            poses = [pin.poses(self._context.poses) for pin in pins]
            points = moved_to_pins(pins, poses, body.positions, begin)
            own = ties_of(pins, poses, points, begin)
            held = points.copy()
            for tie in own:
                if tie.stiffness is None:
                    held[tie.particles] = tie.start
            gap = float(np.linalg.norm(held - points, axis=1).max())
            self._say_apart("pins hold particles", gap)
            windy = isinstance(wind_of(entry.spec), FaceWindModel)
            faces = windy or contact_of(entry.spec) is not None
            none = np.zeros((0, 3), np.int64)
            triangles = body.triangles if faces else none
            bodies.append(replace(body, positions=held, triangles=triangles))
            ties.append(own)
        return bodies, ties

    def _made(self, welded: Welded, ties: Sequence[Sequence[Tie]]) -> SpringSystem:
        spec, context = self._spec, self._context
        every, count = Ties(), len(welded.body.positions)
        resistance, air, contact = np.zeros(count), None, None
        for entry, rows, own in zip(self._entries, self._rows, ties, strict=True):
            for tie in own:
                every.add(tie, rows)
            slowing = entry.spec.drag * entry.body.body.masses
            wind = wind_of(entry.spec)
            if wind is not None and not isinstance(wind, FaceWindModel):
                span = context.begin, context.last
                points = welded.body.positions[rows]
                every.add(wind_ties(wind, points, slowing, span), rows)
            else:
                np.add.at(resistance, rows, slowing)
            air = air_of(wind) if isinstance(wind, FaceWindModel) else air
            contact = contact_of(entry.spec) or contact
        system = SpringSystem(
            welded.body,
            pins=every.pins,
            targets=every.targets,
            gravity=spec.gravity,
            resistance=resistance,
            air=air,
            colliders=context.colliders,
            radius=spec.radius,
            speed_limit=spec.speed_limit,
            self_contact=contact,
        )
        return self._settled(system) if spec.settle else system

    def _settled(self, system: SpringSystem) -> SpringSystem:
        """Return a system that begins where it comes to rest."""
        rest = find_rest(system, self._context.begin, progress=self._context.phase())
        if not rest.solved:
            message = f"no rest was found: forces of {rest.residual:.2g} N are left"
            hint = "let it settle in a preroll, with drag"
            self._warn("SIM152", message, hint, "settle")
        return system.starting_at(rest.positions)

    def _say_apart(self, what: str, gap: float) -> None:
        if gap > APART:
            message = (
                f"{what} {length_text(gap)} from where they are built: springs pull"
            )
            hint = "place them so that they fit, or give pins an offset"
            self._warn("SIM150", message, hint, "pins")

    def _warn(self, code: str, message: str, hint: str, key: str) -> None:
        self._notices.append(replace(warning(code, message, hint), where=key))
