"""Read, join and check spring entries of a scene."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, RefusalCollector, counted
from animtool.core.options import ENTRY_RANGE_MESSAGE, range_faults
from animtool.core.record import dataclass
from animtool.documents.fields import record_from_model
from animtool.systems.framework.body_carriers import BodyCarrier
from animtool.systems.framework.spec import JoinedEntry, PinnedPoints
from animtool.systems.springs import Family, Solver
from animtool.systems.springs.bodies import BODY_BUILDERS, BodyEntry, SpringBody
from animtool.systems.springs.checks import check_supports_self_contact, checked_solver
from animtool.systems.springs.drawing import FaceShape
from animtool.systems.springs.pins import Join, Pin, air_of, particle_indices, read_pins
from animtool.systems.springs.spec import FaceWindModel, SpringsModel

# Solvers that compute the force of pins on rigid bodies.
COUPLED_SOLVERS = (Solver.AUTO, Solver.BDF2, Solver.IMPLICIT_EULER)


@dataclass(frozen=True, slots=True, eq=False)
class SpringEntry:
    """Particles, springs, pins and joins of an entry."""

    spec: SpringsModel  # the keys of the entry
    body: SpringBody
    pins: tuple[Pin, ...]  # pins and targets
    joins: tuple[Join, ...]  # particles merged with those of other systems

    @property
    def joined_systems(self) -> list[tuple[str, str]]:
        """Names of joined systems, and the keys that name them."""
        return [(join.to.system, f"{join.where}.system") for join in self.joins]

    @property
    def positions(self) -> FloatArray:
        """Built positions of particles ``(N, 3)`` [m]."""
        return self.body.body.positions

    @property
    def pinned_points(self) -> list[PinnedPoints]:
        """Particles carried by joints, vertices, prims or rigid bodies."""
        points = self.positions
        return [
            PinnedPoints(
                pin.where, pin.carrier, partial(pin.local_positions, points=points)
            )
            for pin in self.pins
            if pin.carrier is not None
        ]

    @property
    def carrier_bodies(self) -> list[tuple[str, str, str]]:
        """Rigid systems and bodies that carry particles, and their keys."""
        carriers = [pin.carrier for pin in self.pins]
        return [
            (carrier.system, carrier.body, carrier.where)
            for carrier in carriers
            if isinstance(carrier, BodyCarrier)
        ]

    @property
    def reads(self) -> list[str]:
        """Inputs of the entry in addition to its own particles, as text."""
        reads = [counted(len(self.pins), "pin")] if self.pins else []
        reads += [f"{join.to.system}, joined" for join in self.joins]
        reads += ["the wind"] if self.spec.air is not None else []
        reads += ["itself"] if self.spec.contact is not None else []
        return reads

    @property
    def title(self) -> str:
        """Particle and spring counts as text."""
        particles, springs, *_ = self.counts.values()
        return f"{counted(particles, 'particle')} with {counted(springs, 'spring')}"

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of particles, springs, and faces or curves."""
        body, shape = self.body.body, self.body.shape
        noun = "faces" if isinstance(shape, FaceShape) else "curves"
        return {
            "particles": len(body.positions),
            "springs": len(body.springs.rest),
            noun: len(shape.counts),
        }

    def joined_faults(self, members: Sequence[JoinedEntry]) -> list[Fault]:
        """Return faults of joins with other systems (SIM046, SIM052)."""
        bodies = {member.name: member.record.body for member in members}
        faults = []
        for join in self.joins:
            faults += _join_faults(join, bodies[join.to.system])
        has_self_contact = any(member.spec.contact is not None for member in members)
        # An entry with self-contact was checked when it was read.
        if (
            has_self_contact
            and self.spec.contact is None
            and "solver" in self.spec.shared()
        ):
            refusals = RefusalCollector()
            with refusals.collect():
                check_supports_self_contact(Solver(self.spec.options.solver))
            faults += refusals.faults
        return faults


def _join_faults(join: Join, other_body: SpringBody) -> list[Fault]:
    """Return faults of a join with the particles of another body (SIM052, SIM054)."""
    indices, faults = particle_indices(join.to.particles, other_body)
    where = f"{join.where}.particles"
    located_faults = [replace(fault, where=f"{where}[{i}]") for i, fault in faults]
    if not faults and len(indices) not in {1, len(join.particles)}:
        message = f"{len(join.particles)} particles are joined to {len(indices)}"
        hint = "name as many, or one for all"
        located_faults.append(Fault("SIM054", message, hint=hint, where=where))
    return located_faults


def join_pairs(members: Sequence[JoinedEntry], starts: IntArray) -> IntArray:
    """Return pairs of particles to merge ``(J, 2)``: removed, replacement.

    Particles are numbered over all systems; ``starts`` has the first index of each.
    """
    names = [member.name for member in members]
    pairs = [np.zeros((0, 2), np.int64)]
    for member, start in zip(members, starts, strict=False):
        for join in member.record.joins:
            k = names.index(join.to.system)
            body = members[k].record.body
            kept = np.array(particle_indices(join.to.particles, body)[0])
            rows = np.broadcast_arrays(join.particles + start, kept + starts[k])
            pairs.append(np.stack(rows, axis=1))
    return np.concatenate(pairs)


def read_entry(
    spec: Any, entry_data: Mapping[str, Any]
) -> tuple[SpringEntry | None, list[Fault]]:
    """Build the record of an entry, or None with faults; also return all faults."""
    entry = BodyEntry(spec, entry_data)
    entry.families = _families(entry)
    entry.mass = entry.checked_mass("mass", spec.mass)
    body = BODY_BUILDERS[type(spec)](entry, spec)
    _check_wind(entry)
    refusals = RefusalCollector()
    with refusals.collect():
        solver = checked_solver(spec.options)
        if spec.contact is not None:
            check_supports_self_contact(solver)
    for fault in refusals.faults:
        entry.add_fault(fault)
    if spec.error is not None and any(system.two_way for system in spec.systems):
        message = "adaptive steps repeat the simulation, and "
        message += "bodies would be pushed each time"
        hint = "set a step, or remove two_way"
        entry.report_fault("SIM063", message, "error", hint=hint)
    if any(pin.body is not None for pin in spec.pins):
        _check_body_pins(entry)
    if body is None:
        return None, entry.faults
    pins, joins = read_pins(entry, body)
    return SpringEntry(spec, body, pins, joins), entry.faults


def _check_body_pins(entry: BodyEntry) -> None:
    """Report options incompatible with pins on rigid bodies (SIM063, SIM163)."""
    spec = entry.spec
    if spec.error is not None:
        message = "adaptive steps repeat the simulation, and "
        message += "the bodies of its pins would be pulled each time"
        entry.report_fault("SIM063", message, "error", hint="set a step")
    if spec.solver not in COUPLED_SOLVERS:
        message = f"{spec.solver} does not compute the force of pins on a body"
        hint = "use auto, bdf2 or implicit_euler"
        entry.report_fault("SIM163", message, "solver", hint=hint)
    if spec.contact is not None:
        message = "a surface with self-contact is simulated by xpbd, which "
        message += "does not compute the force of pins on a body"
        entry.report_fault("SIM163", message, "self_contact", hint="remove it")


def _families(entry: BodyEntry) -> dict[str, Family | None]:
    """Return spring families by name; None for omitted ones."""
    models = dict(entry.spec.springs)
    families = {
        name: None if model is None else _family(entry, name, model)
        for name, model in models.items()
    }
    if not any(families.values()):
        message = "it has no springs, so its particles fall separately"
        fault = Fault("SIM050", message, hint=f"add some of {', '.join(models)}")
        entry.add_fault(fault, "springs", is_recoverable=True)
    return families


def _family(entry: BodyEntry, name: str, model: Any) -> Family:
    """Return a spring family; a family with invalid numbers has no force."""
    keys = ("stiffness", "frequency", "axial_stiffness")
    specified_keys = [key for key in keys if getattr(model, key, None) is not None]
    family = record_from_model(Family, model)
    hint = "stiffness [N/m] of each spring, frequency [Hz] of its oscillation"
    if "axial_stiffness" in type(model).model_fields:
        hint += ", or axial_stiffness [N], force over strain"
    message = ""
    if not specified_keys:
        message = "it has no stiffness"
    elif len(specified_keys) > 1:
        message = f"it has {' and '.join(specified_keys)}; write one of them"
    elif specified_keys == ["axial_stiffness"] and family.rest == 0:
        message = "springs of rest length 0 have no axial_stiffness"
        hint = "use stiffness, or a rest above 0"
    if message:
        where = specified_keys[-1] if specified_keys else None
        faults = [Fault("SIM190", message, hint=f"give {hint}", where=where)]
    else:
        faults = range_faults(family, ENTRY_RANGE_MESSAGE)
        if family.rest == 0 and (family.tear or 0) > 0:
            message, hint = "springs of rest length 0 tear at once", "remove tear"
            faults.append(Fault("SIM042", message, hint=hint, where="tear"))
    for fault in faults:
        entry.add_fault(fault, "springs", name, is_recoverable=True)
    return Family() if faults else family


def _check_wind(entry: BodyEntry) -> None:
    """Report faults of wind: gusts out of order, and speeds above the limit."""
    wind = entry.spec.air
    if wind is None:
        return
    if any(after[0] <= before[0] for before, after in pairwise(wind.gusts)):
        entry.report_fault("SIM044", "its times must ascend", "wind", "gusts")
    speed, limit = math.hypot(*wind.velocity), entry.spec.speed_limit
    if speed > limit:
        message = f"a wind of {speed:g} m/s is faster than speed_limit, {limit:g} m/s"
        hint = f"for mm/s write {speed / 1000:g}; else raise speed_limit"
        entry.report_fault("SIM050", message, "wind", "velocity", hint=hint)
    if isinstance(wind, FaceWindModel):
        for fault in range_faults(air_of(wind), ENTRY_RANGE_MESSAGE):
            entry.add_fault(fault, "wind")
