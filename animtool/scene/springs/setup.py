"""Springs of a scene as their entries say them: read, joined, shared and checked."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import numpy as np

from animtool._types import IntArray
from animtool.documents.document import Document, Location
from animtool.errors import Fault, OptionError, counted
from animtool.options import OF_ENTRY, range_faults
from animtool.scene.entries import SceneSystem, SystemFacts
from animtool.scene.springs.bodies import BodyEntry, SpringBody, families_of, mass_of
from animtool.scene.springs.pins import Join, Pin, air_of, numbered, read_pins
from animtool.scene.springs.shaped_bodies import (
    cloth_body,
    rope_body,
    strands_body,
    volume_body,
)
from animtool.scene.systems.entries import EntryReader
from animtool.scene.systems.surroundings import Surroundings
from animtool.systems.springs import SelfContact, Solver, SpringOptions
from animtool.systems.springs.checks import check_keeping_apart, check_options
from animtool.systems.springs.drawing import Faces
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

_OPTIONS = ("solver", "step", "error", "stretch")
_OWN = ("gravity", "radius", "speed_limit", "self_contact", "preroll", "settle")


@dataclass(frozen=True, slots=True, eq=False)
class SpringSetup:
    """What particles and springs of an entry are made of."""

    spec: SpringsModel  # the keys of the entry
    body: SpringBody
    pins: tuple[Pin, ...]  # what holds and draws particles
    joins: tuple[Join, ...]  # what makes them one with those of other systems
    around: Surroundings  # what they run into
    at: Location  # place of the entry

    @property
    def joined(self) -> tuple[tuple[str, Location], ...]:
        """Systems that it is one with, and where it says so."""
        return tuple((join.system, join.at[0]) for join in self.joins)

    @property
    def pushes(self) -> tuple[tuple[str, Location], ...]:
        """Systems whose bodies it pushes, and where that is said."""
        return self.around.pushes

    @property
    def needs(self) -> tuple[tuple[str, Location], ...]:
        """Systems that are run into, and where they are named."""
        return self.around.needs

    @property
    def preroll(self) -> float:
        """Time before 0 s that they begin in [s]."""
        return self.spec.preroll

    @property
    def files(self) -> tuple[Path, ...]:
        """Files that are read along with the scene."""
        around = self.around
        carriers = [pin.carrier.file for pin in self.pins if pin.carrier is not None]
        return (*(one.file for one in around.characters), *carriers, *around.followed)

    @property
    def reads(self) -> tuple[str, ...]:
        """What acts on them, in words."""
        around, many = self.around, len(self.around.colliders)
        reads = [counted(len(self.pins), "pin")] if self.pins else []
        reads += [f"{join.system}, joined" for join in self.joins]
        reads += ["the wind"] if wind_of(self.spec) is not None else []
        reads += ["itself"] if contact_of(self.spec) is not None else []
        reads += [counted(many, "collider")] if many else []
        reads += [one.file.name for one in around.characters]
        reads += [one.system for one in around.surfaces]
        reads += [mesh.prim for mesh in around.meshes]
        return tuple(reads)

    @property
    def makes(self) -> str:
        """What becomes of them, in words."""
        body = self.body.body
        particles = counted(len(body.positions), "particle")
        springs = counted(len(body.springs.rest), "spring")
        solver, step = options_of(self.spec).solver, options_of(self.spec).step
        how = f"by {solver}" if step is None else f"by {solver} in steps of {step:g} s"
        return f"{particles} with {springs}, {how}"

    @property
    def facts(self) -> SystemFacts:
        """What they are made of, in numbers."""
        body, shape = self.body.body, self.body.shape
        drawn = "faces" if isinstance(shape, Faces) else "curves"
        counts = {
            "particles": len(body.positions),
            "springs": len(body.springs.rest),
            drawn: len(shape.counts),
        }
        options = options_of(self.spec)
        return SystemFacts(counts, str(options.solver), options.step, self.around.count)


def wind_of(spec: SpringsModel) -> WindModel | None:
    """Return the air of an entry; None is still, and faces bear none."""
    return cast(WindModel | None, getattr(spec, "wind", None))


def contact_of(spec: SpringsModel) -> SelfContact | None:
    """Return how the surface of an entry keeps apart from itself; None goes through."""
    model: SelfContactModel | None = getattr(spec, "self_contact", None)
    return None if model is None else SelfContact(**dict(model))


def options_of(spec: SpringsModel) -> SpringOptions:
    """Return the solver of an entry, and its steps."""
    return SpringOptions(**{name: getattr(spec, name) for name in _OPTIONS})


def shared(setups: Sequence[SpringSetup]) -> SpringsModel:
    """Return what bodies have in common: what any of them states."""
    stated: dict[str, Any] = {}
    for setup in setups:
        own = {name: _value(setup, name) for name in (*_OPTIONS, *_OWN, "wind")}
        stated |= {name: value for name, value in own.items() if _states(setup, name)}
    first = setups[0].spec
    faced = {name: None for name in ("self_contact", "wind")}
    return first.model_copy(update=faced | stated)


def conflicts(setups: Sequence[SpringSetup]) -> Iterator[tuple[int, str, int]]:
    """Yield a body, a key that it states otherwise, and the body that stated it."""
    meets = any(setup.around.anything for setup in setups)
    for name in (*_OPTIONS, *_OWN, "wind"):
        if name == "radius" and not meets:
            continue
        stating = [i for i, setup in enumerate(setups) if _states(setup, name)]
        for i in stating[1:]:
            if _value(setups[i], name) != _value(setups[stating[0]], name):
                yield i, name, stating[0]


def _states(setup: SpringSetup, name: str) -> bool:
    if name == "wind":
        return isinstance(wind_of(setup.spec), FaceWindModel)
    return name in setup.spec.model_fields_set


def _value(setup: SpringSetup, name: str) -> Any:
    return getattr(setup.spec, name, None)


def check_joins(document: Document, members: Sequence[SceneSystem]) -> None:
    """Note what keeps systems that are joined from being one."""
    setups = [cast(SpringSetup, member.setup) for member in members]
    bodies = {
        member.name: setup.body for member, setup in zip(members, setups, strict=True)
    }
    for setup in setups:
        for join in setup.joins:
            for at, fault in _faults(join, bodies[join.system]):
                document.add(fault.code, at, fault.message, fault.hint)
    for i, key, before in conflicts(setups):
        message = f"{key} is another than that of {members[before].name}: they are "
        message += "joined, and simulated as one"
        at = (*setups[i].at, key)
        document.add("SIM054", at, message, "state it once, or twice the same")
    _check_solver(document, setups)


def _check_solver(document: Document, setups: Sequence[SpringSetup]) -> None:
    """Note a solver that does not keep apart what another system wants apart."""
    if not any(contact_of(setup.spec) for setup in setups):
        return
    for setup in setups:
        # One that wants it itself has been told.
        if contact_of(setup.spec) is None and _states(setup, "solver"):
            try:
                check_keeping_apart(Solver(options_of(setup.spec).solver))
            except OptionError as error:
                fault, at = error.faults[0], (*setup.at, "solver")
                document.add(fault.code, at, fault.message, fault.hint)


def _faults(join: Join, other: SpringBody) -> list[tuple[Location, Fault]]:
    numbers, faults = numbered(join.others, other)
    located = [((*join.at[1], i), fault) for i, fault in faults]
    if not faults and len(numbers) not in {1, len(join.particles)}:
        message = f"{len(join.particles)} particles are joined to {len(numbers)}"
        hint = "name as many, or one for all"
        located.append((join.at[1], Fault("SIM054", message, hint=hint)))
    return located


def join_pairs(
    names: Sequence[str], setups: Sequence[SpringSetup], starts: IntArray
) -> IntArray:
    """Return particles that become one with others, and these ``(J, 2)``.

    They are numbered over all; starts are the first of each system.
    """
    pairs = [np.zeros((0, 2), np.int64)]
    for setup, start in zip(setups, starts, strict=False):
        for join in setup.joins:
            k = list(names).index(join.system)
            others = np.array(numbered(join.others, setups[k].body)[0])
            two = np.broadcast_arrays(join.particles + start, others + starts[k])
            pairs.append(np.stack(two, axis=1))
    return np.concatenate(pairs)


def read_springs(
    document: Document, at: Location, spec: SpringsModel, roots: Sequence[Path]
) -> SpringSetup | None:
    """Return what an entry is made of; None where faults leave nothing."""
    reader = EntryReader(document, roots)
    body = _body(reader, at, spec)
    colliders = reader.colliders((*at, "colliders"), spec.colliders)
    characters = reader.characters((*at, "characters"), spec.characters)
    surfaces = reader.surfaces((*at, "systems"), spec.systems)
    meshes = reader.meshes((*at, "meshes"), spec.meshes)
    _check_wind(reader, (*at, "wind"), wind_of(spec))
    _check_options(reader, at, spec)
    reader.note_ranges(at, spec)
    if options_of(spec).error is not None and any(one.two_way for one in spec.systems):
        message = "steps that keep an error are found by simulating several times, and "
        message += "bodies would be pushed each time"
        hint = "give a step, or leave out two_way"
        reader.note((*at, "error"), Fault("SIM063", message, hint=hint))
    if body is None:
        return None
    pins, joins = read_pins(reader, (*at, "pins"), spec.pins, body)
    followed = tuple(reader.files)
    around = Surroundings(tuple(colliders), characters, surfaces, meshes, followed)
    return SpringSetup(spec, body, pins, joins, around, at)


def _body(reader: EntryReader, at: Location, spec: Any) -> SpringBody | None:
    families = families_of(reader, (*at, "springs"), spec.springs)
    mass = mass_of(reader, (*at, "mass"), spec.mass)
    return _BODIES[type(spec)](BodyEntry(reader, at, families, mass), spec)


def _check_options(reader: EntryReader, at: Location, spec: SpringsModel) -> None:
    try:
        solver = check_options(options_of(spec))
        if contact_of(spec) is not None:
            check_keeping_apart(solver)
    except OptionError as error:
        for fault in error.faults:
            reader.note((*at, fault.where or ""), fault)


def _check_wind(reader: EntryReader, at: Location, model: WindModel | None) -> None:
    if model is None:
        return
    if any(after[0] <= before[0] for before, after in pairwise(model.gusts)):
        reader.note((*at, "gusts"), Fault("SIM044", "its times must ascend"))
    if isinstance(model, FaceWindModel):
        for fault in range_faults(air_of(model), OF_ENTRY):
            reader.note((*at, fault.where or ""), fault)
