"""What a kind gets that is a spec and a build: it is read, run and tried from these."""

from __future__ import annotations

import time
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, TypeAlias, cast, get_args, get_origin

import numpy as np

from animtool._types import FloatArray
from animtool.documents.check import FileModel
from animtool.documents.document import Document, Location
from animtool.errors import AnimtoolError, Fault, ToleranceError, counted
from animtool.frames import Frame, PointsFrame, TransformsFrame
from animtool.plugins import load_object
from animtool.scene.entries import SceneSystem
from animtool.scene.systems.entries import PLACING, EntryReader
from animtool.scene.systems.prototypes import Prototype
from animtool.scene.systems.saved import Clocked, read_state
from animtool.scene.systems.setups import SystemFacts
from animtool.scene.systems.simulation import Opening
from animtool.scene.systems.surroundings import Surroundings
from animtool.sim.colliders import Colliders
from animtool.sim.trajectory import Status
from animtool.sim.trials.trial import FINER, Outcome, Setting, Shot, stepwise
from animtool.systems.fields import (
    Part,
    PlacedModel,
    PrototypeModel,
    SystemColliderModel,
    SystemSpec,
)
from animtool.systems.kinds import SYSTEM_KINDS
from animtool.systems.simulation import Simulation, SimulationRun

Reader: TypeAlias = Callable[[Location, Any], Any]


class PartReader(EntryReader):
    """Reads what the models of entries hold."""

    def parts(
        self, at: Location, model: FileModel, skipped: Container[str] = ()
    ) -> dict[str, Any]:
        """Return what the keys of a model are read as, by key; plain ones are left out.

        A list has one of each entry, without those that faults leave none. A model in a
        model is such parts again, and what is placed has its ``poses`` among them.
        """
        parts: dict[str, Any] = {}
        if isinstance(model, PlacedModel):
            parts["poses"] = self._sound(at, self._poses, model)
        for key, declared in type(model).model_fields.items():
            value = getattr(model, key)
            placing = isinstance(model, PlacedModel) and key in PLACING
            read = self._reader(declared.annotation, declared.metadata)
            if key in skipped or placing or read is None or value is None:
                continue
            if isinstance(value, list):
                each = [read((*at, key, i), entry) for i, entry in enumerate(value)]
                parts[key] = [part for part in each if part is not None]
            else:
                parts[key] = read((*at, key), value)
        return parts

    def _reader(self, annotation: Any, marks: Sequence[Any] = ()) -> Reader | None:
        """Return what reads entries of a type; None for plain values."""
        readers: dict[Part, Reader] = {
            Part.ARRAY: lambda at, text: self.array(at, text, "points"),
            Part.FORCE: self.force,
            Part.PLACE: lambda at, entry: self._sound(at, self.emitter_place, entry),
            Part.SHAPE: lambda at, entry: self._sound(at, self.shape, entry),
        }
        for mark in marks:
            if isinstance(mark, Part):
                return readers[mark]
        if get_origin(annotation) is Annotated:
            return self._reader(annotation.__origin__, annotation.__metadata__)
        if isinstance(annotation, type) and issubclass(annotation, FileModel):
            if issubclass(annotation, PrototypeModel):
                return self.prototype
            collides = issubclass(annotation, SystemColliderModel)
            return self.collider if collides else self.parts
        inner = (self._reader(one) for one in get_args(annotation))
        return next((read for read in inner if read is not None), None)

    def prototype(self, at: Location, model: PrototypeModel) -> Prototype | None:
        """Return a mesh that copies are made of; a USD file is looked at now."""
        if (model.prim is None) is (model.mesh is None):
            message = "it is the prim of a USD file, or the mesh of a rig"
            hint = "write prim: /bird/body, or mesh: body"
            self.note(at, Fault("SIM053", message, hint=hint))
            return None
        path = self.input((*at, "file"), model.file)
        if path is None:
            return None
        self.files.append(path)
        made = Prototype(path, model.prim, model.mesh, model.samples)
        if model.prim is not None:
            try:
                made()
            except AnimtoolError as error:
                self.note((*at, "prim"), replace(error.faults[0], code="SIM051"))
        return made

    def _poses(self, at: Location, model: PlacedModel) -> Any:
        return self.poses(at, model, "SIM020")

    def _sound(self, at: Location, read: Reader, entry: Any) -> Any:
        """Return what an entry is read as, its own faults noted; None of any."""
        part = read(at, entry)
        if part is None:
            self.sound = False
            return None
        for why in part.faults():
            self.note(at, Fault("SIM020", why))
        return part


_AROUND = {"colliders", "characters", "systems", "meshes"}
STEPS = "steps"  # what a setting of a kind that has no methods is called


@dataclass(frozen=True, slots=True)
class SpecSetup:
    """An entry whose kind is a spec and a build."""

    spec: SystemSpec
    around: Surroundings
    # What keys are read as that are neither plain nor what it runs into, by key.
    parts: Mapping[str, Any] = field(default_factory=dict)
    joined: tuple[tuple[str, Location], ...] = ()
    resume: Path | None = None  # file of a state to go on from

    @property
    def writes(self) -> tuple[str, ...]:
        """Files that are written along with the output."""
        return () if self.spec.save is None else (self.spec.save,)

    @property
    def needs(self) -> tuple[tuple[str, Location], ...]:
        """Systems that are to be there before it, and where they are named."""
        return self.around.needs

    @property
    def files(self) -> tuple[Path, ...]:
        """Files that are read along with the scene."""
        return (*self.around.files, *([self.resume] if self.resume else []))

    @property
    def reads(self) -> tuple[str, ...]:
        """What acts on it, in words."""
        forces = self.parts.get("forces", ())
        acting = [counted(len(forces), "force")] if forces else []
        return (*acting, *self.around.reads)

    @property
    def makes(self) -> str:
        """What results from it, in words."""
        by = f" by {self.method}" if self.spec.methods else ""
        return f"{self.spec.name},{by} in steps of {self.spec.step:g} s"

    @property
    def method(self) -> str:
        """Its method, or what stands for one."""
        return str(getattr(self.spec, "method", STEPS))

    @property
    def facts(self) -> SystemFacts:
        """What it is made of, in numbers."""
        return SystemFacts({}, self.method, self.spec.step, self.around.count)

    @property
    def preroll(self) -> float:
        """Time before 0 s that it begins in [s]."""
        return self.spec.preroll


@dataclass(frozen=True, slots=True)
class Context:
    """What a build may ask for."""

    begin: float  # time of the first step [s]
    last: float  # the last time that will be asked for [s]
    colliders: Colliders
    parts: Mapping[str, Any]  # what other keys are read as, by key


def read_spec(
    document: Document, at: Location, spec: SystemSpec, roots: Sequence[Path]
) -> SpecSetup | None:
    """Return the setup of an entry; None where faults leave none.

    What the keys `colliders`, `characters`, `systems` and `meshes` name is what it runs
    into, where the spec has them; other keys are read as their types say.
    """
    reader = PartReader(document, roots)

    def entries(key: str) -> tuple[Location, Any]:
        return (*at, key), getattr(spec, key, [])

    colliders = reader.colliders(*entries("colliders"))
    characters = reader.characters(*entries("characters"))
    surfaces = reader.surfaces(*entries("systems"))
    meshes = reader.meshes(*entries("meshes"))
    parts = reader.parts(at, spec, _AROUND)
    resume = None
    if spec.resume is not None:
        resume = reader.input((*at, "resume"), spec.resume)
    if spec.save is not None:
        reader.output((*at, "save"), spec.save)
    if not reader.sound:
        return None
    followed = tuple(reader.files)
    around = Surroundings(tuple(colliders), characters, surfaces, meshes, followed)
    return SpecSetup(spec, around, parts, resume=resume)


def open_spec(members: Sequence[SceneSystem], opening: Opening) -> list[SimulationRun]:
    """Return a system at its beginning; characters are read now."""
    (member,) = members
    setup = cast(SpecSetup, member.setup)
    run = _run(member, opening, setup.spec)
    if setup.resume is not None:
        run.state = read_state(setup.resume, clocked(member), run.state)
    return [run]


def clocked(member: SceneSystem) -> Clocked:
    """Return which steps lead to states of a system."""
    setup = cast(SpecSetup, member.setup)
    return Clocked(member.kind, -setup.preroll, setup.spec.step)


def _run(member: SceneSystem, opening: Opening, spec: SystemSpec) -> SimulationRun:
    setup = cast(SpecSetup, member.setup)
    begin = -setup.preroll
    colliders = Colliders(*setup.around.built(opening, begin, spec.step))
    build = cast(
        Callable[[SystemSpec, Context], Simulation[Any]],
        load_object(SYSTEM_KINDS[member.kind].build),
    )
    simulation = build(spec, Context(begin, opening.last, colliders, setup.parts))
    return SimulationRun(member.name, simulation, begin, spec.step)


def _shot(frame: Frame) -> Shot:
    """Return what a table compares of a frame."""
    if isinstance(frame, TransformsFrame):
        arms = [np.linalg.norm(mesh.points, axis=1) for mesh in frame.meshes]
        sizes = np.abs(frame.scales).max(initial=0.0)
        reach = float(max((arm.max(initial=0.0) for arm in arms), default=0.0) * sizes)
        return Shot(frame.points, frame.ids, frame.rotations, reach)
    ids = frame.ids if isinstance(frame, PointsFrame) else None
    return Shot(frame.points, ids)


def spec_trial(
    members: Sequence[SceneSystem], rebuild: Callable[[], Opening], times: FloatArray
) -> SpecTrial:
    """Return a system that can be simulated with several steps."""
    (member,) = members
    return SpecTrial(member, rebuild, times)


class SpecTrial:
    """A system with the method and the step of its file, and with others."""

    def __init__(
        self, member: SceneSystem, rebuild: Callable[[], Opening], times: FloatArray
    ) -> None:
        setup = cast(SpecSetup, member.setup)
        spec = self._spec = setup.spec
        self.name, self.kind = member.name, member.kind
        self.span = float(times[-1]) + spec.preroll
        self.chosen = Setting.of(setup.method, step=spec.step)
        self._member, self._rebuild, self._times = member, rebuild, times

    def settings(self) -> list[Setting]:
        """Return each method with several steps."""
        methods = self._spec.methods or [self.chosen.method]
        return [one for name in methods for one in stepwise(name, self._spec.step)]

    def references(self) -> list[list[Setting]]:
        """Return finer and finer steps of the method of the file."""
        return [stepwise(self.chosen.method, self._spec.step, FINER)]

    def run(self, setting: Setting) -> Outcome:
        """Simulate it in one way."""
        changes: dict[str, Any] = dict(setting.options)
        if self._spec.methods:
            changes["method"] = setting.method
        spec = self._spec.model_copy(update=changes)
        run = _run(self._member, self._rebuild(), spec)
        began = time.perf_counter()
        shots, energies, status, reason = [], [], Status.OK, ""
        try:
            for t in self._times.tolist():
                frame = run.at(t)
                shots.append(_shot(frame))
                energies.append(run.diagnostics.energy)
        except ToleranceError as error:
            status, reason = Status.UNSTABLE, error.faults[0].message
        known = [energy for energy in energies if energy is not None]
        return Outcome(
            time.perf_counter() - began,
            run.taken,
            shots,
            status,
            reason,
            energies=known if len(known) == len(shots) else None,
        )
