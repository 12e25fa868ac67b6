"""Springs of a scene as their entries say them: read, joined and checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, cast

import numpy as np

from animtool._types import IntArray
from animtool.errors import Fault, OptionError, counted
from animtool.options import OF_ENTRY, range_faults
from animtool.systems.fields import Member
from animtool.systems.springs import SelfContact, Solver, SpringOptions
from animtool.systems.springs.bodies import BodyEntry, SpringBody, families_of
from animtool.systems.springs.checks import check_keeping_apart, check_options
from animtool.systems.springs.drawing import Faces
from animtool.systems.springs.entry_bodies import (
    cloth_body,
    rope_body,
    strands_body,
    volume_body,
)
from animtool.systems.springs.pins import Join, Pin, air_of, numbered, read_pins
from animtool.systems.springs.spec import (
    ClothModel,
    RopeModel,
    SpringsModel,
    StrandsModel,
    VolumeModel,
)
from animtool.systems.springs.spec_parts import (
    FaceWindModel,
    SelfContactModel,
    WindModel,
)

_BODIES: dict[type[SpringsModel], Callable[..., SpringBody | None]] = {
    ClothModel: cloth_body,
    RopeModel: rope_body,
    StrandsModel: strands_body,
    VolumeModel: volume_body,
}


@dataclass(frozen=True, slots=True, eq=False)
class SpringEntry:
    """What particles and springs of an entry are made of."""

    spec: SpringsModel  # the keys of the entry
    body: SpringBody
    pins: tuple[Pin, ...]  # what holds and draws particles
    joins: tuple[Join, ...]  # what makes them one with those of other systems

    @property
    def joined(self) -> list[tuple[str, str]]:
        """Systems that it is one with, and the keys that say so."""
        return [(join.system, f"{join.where}.system") for join in self.joins]

    @property
    def reads(self) -> list[str]:
        """What acts on them, in words."""
        reads = [counted(len(self.pins), "pin")] if self.pins else []
        reads += [f"{join.system}, joined" for join in self.joins]
        reads += ["the wind"] if wind_of(self.spec) is not None else []
        reads += ["itself"] if contact_of(self.spec) is not None else []
        return reads

    @property
    def title(self) -> str:
        """What they are called in words."""
        body = self.body.body
        particles = counted(len(body.positions), "particle")
        return f"{particles} with {counted(len(body.springs.rest), 'spring')}"

    @property
    def counts(self) -> dict[str, int]:
        """What they are made of, by kind."""
        body, shape = self.body.body, self.body.shape
        drawn = "faces" if isinstance(shape, Faces) else "curves"
        return {
            "particles": len(body.positions),
            "springs": len(body.springs.rest),
            drawn: len(shape.counts),
        }

    def joined_faults(self, members: Sequence[Member]) -> list[Fault]:
        """Return what keeps them from being one with others (SIM046, SIM052)."""
        bodies = {member.name: member.record.body for member in members}
        faults = []
        for join in self.joins:
            faults += _join_faults(join, bodies[join.system])
        apart = any(contact_of(member.spec) for member in members)
        # One that wants it itself has been told.
        if apart and contact_of(self.spec) is None and "solver" in self.spec.shared():
            faults += _faults_of(
                lambda: check_keeping_apart(Solver(options_of(self.spec).solver))
            )
        return faults


def wind_of(spec: SpringsModel) -> WindModel | None:
    """Return the air of an entry; None is still, and faces bear none."""
    return cast(WindModel | None, getattr(spec, "wind", None))


def contact_of(spec: SpringsModel) -> SelfContact | None:
    """Return how the surface of an entry keeps apart from itself; None goes through."""
    model: SelfContactModel | None = getattr(spec, "self_contact", None)
    return None if model is None else SelfContact(**dict(model))


def options_of(spec: SpringsModel) -> SpringOptions:
    """Return the solver of an entry, and its steps."""
    names = ("solver", "step", "error", "stretch")
    return SpringOptions(**{name: getattr(spec, name) for name in names})


def _join_faults(join: Join, other: SpringBody) -> list[Fault]:
    numbers, faults = numbered(join.others, other)
    where = f"{join.where}.particles"
    located = [replace(fault, where=f"{where}[{i}]") for i, fault in faults]
    if not faults and len(numbers) not in {1, len(join.particles)}:
        message = f"{len(join.particles)} particles are joined to {len(numbers)}"
        hint = "name as many, or one for all"
        located.append(Fault("SIM054", message, hint=hint, where=where))
    return located


def join_pairs(members: Sequence[Member], starts: IntArray) -> IntArray:
    """Return particles that become one with others, and these ``(J, 2)``.

    They are numbered over all; starts are the first of each system.
    """
    names = [member.name for member in members]
    pairs = [np.zeros((0, 2), np.int64)]
    for member, start in zip(members, starts, strict=False):
        for join in member.record.joins:
            k = names.index(join.system)
            others = np.array(numbered(join.others, members[k].record.body)[0])
            two = np.broadcast_arrays(join.particles + start, others + starts[k])
            pairs.append(np.stack(two, axis=1))
    return np.concatenate(pairs)


def read_entry(
    spec: Any, parts: Mapping[str, Any]
) -> tuple[SpringEntry | None, list[Fault]]:
    """Return what an entry is made of, None where faults leave nothing, and these."""
    entry = BodyEntry(spec, parts)
    entry.families = families_of(entry, spec.springs)
    entry.mass = entry.mass_of("mass", spec.mass)
    body = _BODIES[type(spec)](entry, spec)
    _check_wind(entry, wind_of(spec))
    _check_options(entry)
    if spec.error is not None and any(one.two_way for one in spec.systems):
        message = "steps that keep an error are found by simulating several times, and "
        message += "bodies would be pushed each time"
        hint = "give a step, or leave out two_way"
        entry.note("SIM063", message, "error", hint=hint)
    if body is None:
        return None, entry.faults
    pins, joins = read_pins(entry, body)
    return SpringEntry(spec, body, pins, joins), entry.faults


def _faults_of(check: Callable[[], object]) -> Sequence[Fault]:
    """Return what a check raises."""
    try:
        check()
    except OptionError as error:
        return error.faults
    return ()


def _check_options(entry: BodyEntry) -> None:
    def check() -> None:
        solver = check_options(options_of(entry.spec))
        if contact_of(entry.spec) is not None:
            check_keeping_apart(solver)

    for fault in _faults_of(check):
        entry.add(fault, fault.where or "")


def _check_wind(entry: BodyEntry, model: WindModel | None) -> None:
    if model is None:
        return
    if any(after[0] <= before[0] for before, after in pairwise(model.gusts)):
        entry.note("SIM044", "its times must ascend", "wind", "gusts")
    if isinstance(model, FaceWindModel):
        for fault in range_faults(air_of(model), OF_ENTRY):
            entry.add(fault, "wind", fault.where or "")
