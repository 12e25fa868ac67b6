"""What a kind gets that is a spec and a build: it is read, run and tried from these."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    TypeAlias,
    TypeVar,
    get_args,
    get_origin,
)

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import AnimtoolError, Fault, OptionError
from animtool.core.units import UpAxis
from animtool.documents.check import FileModel
from animtool.documents.document import Document, Location, location_of
from animtool.motion.frames import MeshFrame
from animtool.motion.physics import Physics
from animtool.motion.transforms import PropRequest
from animtool.scene.file.entries import SystemSetup
from animtool.scene.systems.carriers import OnJoint, OnPrim, OnVertex
from animtool.scene.systems.character_motion import open_take
from animtool.scene.systems.entries import PLACING, EntryReader
from animtool.scene.systems.surroundings import Surroundings
from animtool.systems.framework.conversion import METRES, SceneUnits
from animtool.systems.framework.fields import (
    AROUND,
    CarryingBodyModel,
    CarryingJointModel,
    CarryingPrimModel,
    CarryingVertexModel,
    CharacterModel,
    GaitsModel,
    MovingMeshModel,
    Part,
    PhysicsStageModel,
    PlacedModel,
    PrimMeshModel,
    PrototypeModel,
    RecordModel,
    SystemColliderModel,
    SystemSurfaceModel,
)
from animtool.systems.framework.spec import SystemSpec
from animtool.systems.framework.tied import OnBody

if TYPE_CHECKING:
    from animtool.scene.systems.gaits import GaitsSource
    from animtool.usd.caches.reader import StillMesh

Reader: TypeAlias = Callable[[Location, Any], Any]


@dataclass(frozen=True, slots=True)
class Prototype:
    """A mesh, and the phases of its cycle; those that are equal are shown by one."""

    path: Path
    prim: str | None  # of a USD file
    mesh: str | None  # of a rig
    samples: int  # phases of what moves

    def __call__(self) -> tuple[MeshFrame, ...]:
        """Return its mesh at each phase; of what does not move there is one.

        Raises:
            OptionError: There is no such mesh (SIM051, SIM053).
            FormatError: The file cannot be read.
        """
        at, span = self._of_rig() if self.prim is None else self._of_stage()
        shares = [0.0] if span is None else np.arange(self.samples) / self.samples
        first, last = span or (0.0, 0.0)
        return tuple(at(first + (last - first) * float(share)) for share in shares)

    def _of_stage(self) -> _Moving:
        from animtool.usd.caches.reader import open_mesh

        assert self.prim is not None
        source = open_mesh(self.path, self.prim, UpAxis.Y)

        def at(code: float) -> MeshFrame:
            found = source.at(None if source.span is None else code)
            return _frame(found.points, found.counts, found.indices)

        return at, source.span

    def _of_rig(self) -> _Moving:
        from animtool.scene.systems.character_motion import CharacterMotions, SkinMotion

        assert self.mesh is not None
        character = CharacterMotions().of(self.path)
        motion = SkinMotion(character, self.mesh)
        counts, indices = motion.faces

        def at(t: float) -> MeshFrame:
            return _frame(motion.points(t), counts, indices)

        first, last = character.times[[0, -1]].tolist()
        return at, (first, last) if last > first else None


_Moving = tuple[Callable[[float], MeshFrame], tuple[float, float] | None]


def _frame(points: FloatArray, counts: IntArray, indices: IntArray) -> MeshFrame:
    return MeshFrame(
        points, np.zeros_like(points), counts.astype(np.int64), indices.astype(np.int64)
    )


CarrierT = TypeVar("CarrierT", OnJoint, OnVertex)


class PartReader(EntryReader):
    """Reads what the models of entries hold.

    Attributes:
        carriers: Files of what carries others.
    """

    def __init__(
        self,
        document: Document,
        roots: Sequence[Path],
        units: SceneUnits = METRES,
    ) -> None:
        super().__init__(document, roots, units)
        self.carriers: list[Path] = []
        # Populations often share their gaits, which take long to read.
        self._gaits: dict[GaitsSource, GaitsSource] = {}

    def parts(
        self, at: Location, model: FileModel, keys: Collection[str] | None = None
    ) -> dict[str, Any]:
        """Return what keys of a model are read as, by key; plain ones are left out.

        A list has one of each entry, without those that faults leave none. A model in a
        model is such parts again, or its record, and what is placed has its ``poses``
        among them.
        """
        parts: dict[str, Any] = {}
        check = not isinstance(model, RecordModel)
        if isinstance(model, PlacedModel):
            poses = self.poses(at, model, model.code)
            parts["poses"] = self._sound(at, poses, check=check)
        for key, declared in type(model).model_fields.items():
            if keys is not None and key not in keys:
                continue
            value = getattr(model, key)
            placing = isinstance(model, PlacedModel) and key in PLACING
            read = self._reader(declared.annotation, declared.metadata, check=check)
            if placing or read is None or value is None:
                continue
            if Part.ARRAY in _marks(declared.annotation, declared.metadata):
                values = read((*at, key), value)
                factor = self.units.array_factor(declared.description)
                parts[key] = values
                if values is not None and factor != 1.0:
                    parts[key] = values * factor
            elif isinstance(value, list):
                each = [read((*at, key, i), entry) for i, entry in enumerate(value)]
                parts[key] = [part for part in each if part is not None]
            else:
                parts[key] = read((*at, key), value)
        return parts

    def _entry(self, at: Location, model: FileModel) -> Any:
        """Return the parts of a model, or its record; None where faults leave none."""
        self.note_ranges(at, model)
        parts = self.parts(at, model)
        if not isinstance(model, RecordModel):
            return parts
        whole = all(part is not None for part in parts.values())
        record = model.record(parts) if whole else None
        return self.checked(at, record, model)

    def _reader(
        self, annotation: Any, marks: Sequence[Any] = (), *, check: bool
    ) -> Reader | None:
        """Return what reads entries of a type; None for plain values.

        Faults of places and shapes are noted where nothing else does.
        """

        def sound(read: Reader) -> Reader:
            return lambda at, entry: self._sound(at, read(at, entry), check=check)

        readers: dict[Part, Reader] = {
            Part.ARRAY: lambda at, text: self.array(at, text, str(at[-1])),
            Part.NAMES: self.names,
            Part.FORCE: self.force,
            Part.PLACE: sound(self.emitter_place),
            Part.SHAPE: sound(self.shape),
        }
        for mark in marks:
            if isinstance(mark, Part):
                return readers[mark]
        if get_origin(annotation) is Annotated:
            marks = annotation.__metadata__
            return self._reader(annotation.__origin__, marks, check=check)
        if isinstance(annotation, type) and issubclass(annotation, FileModel):
            models: dict[type[FileModel], Reader] = {
                PrototypeModel: self.prototype,
                GaitsModel: self.gaits,
                PhysicsStageModel: self.physics,
                PrimMeshModel: self.still_mesh,
                CarryingJointModel: self.carrying_joint,
                CarryingVertexModel: self.carrying_vertex,
                CarryingPrimModel: self.carrying_prim,
                CarryingBodyModel: self.carrying_body,
                SystemColliderModel: self.collider,
                CharacterModel: self.character_collider,
                SystemSurfaceModel: self.surface,
                MovingMeshModel: self.mesh,
            }
            own = (
                read for kind, read in models.items() if issubclass(annotation, kind)
            )
            return next(own, self._entry)
        inner = (self._reader(one, check=check) for one in get_args(annotation))
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

    def gaits(self, at: Location, model: GaitsModel) -> GaitsSource | None:
        """Return clips of a rig; they are looked at now, once for all of one rig."""
        from animtool.scene.systems.gaits import GaitsSource

        rig = self.input((*at, "rig"), model.rig)
        clips = [
            self.input((*at, "clips", i), clip) for i, clip in enumerate(model.clips)
        ]
        found = [path for path in (rig, *clips) if path is not None]
        self.files += found
        if rig is None or len(found) < 1 + len(clips):
            return None
        made = GaitsSource(rig, tuple(found[1:]))
        made = self._gaits.setdefault(made, made)
        try:
            made()
        except AnimtoolError as error:
            for fault in error.faults:
                self.note(at, fault)
            return None
        return made

    def physics(self, at: Location, model: PhysicsStageModel) -> Physics | None:
        """Return what UsdPhysics says of a stage."""
        from animtool.usd.physics.read import read_bodies

        path = self.input((*at, "file"), model.file)
        if path is None:
            return None
        self.files.append(path)
        try:
            return read_bodies(path, model.prim, model.frame)
        except AnimtoolError as error:
            for fault in error.faults:
                of = path.name, fault.where or model.prim
                message = ": ".join([*of, fault.message])
                self.note((*at, "prim"), replace(fault, code="SIM051", message=message))
            return None

    def names(self, at: Location, entry: str | int) -> list[str | int]:
        """Return a name or number, or those of an array; none of one not read."""
        if not isinstance(entry, str) or ".npz" not in entry:
            return [entry]
        above = [step for step in at[:-2] if isinstance(step, str)]
        values = self.array(at, entry, above[-1])
        return [] if values is None else [int(n) for n in values.ravel().tolist()]

    def still_mesh(self, at: Location, model: PrimMeshModel) -> StillMesh | None:
        """Return a mesh of a USD file as it is at its first frame."""
        from animtool.usd.caches.reader import read_still_mesh

        path = self.input((*at, "file"), model.file)
        if path is None:
            return None
        try:
            return read_still_mesh(path, model.prim, UpAxis.Y)
        except OptionError as error:
            self.note((*at, "prim"), error.faults[0])
            return None

    def carrying_joint(self, at: Location, model: CarryingJointModel) -> OnJoint | None:
        """Return a joint that carries others."""
        path = self.character(at, model)
        if path is None:
            return None
        return self._there(at, OnJoint(path, model.joint, self.place(at, model)))

    def carrying_vertex(
        self, at: Location, model: CarryingVertexModel
    ) -> OnVertex | None:
        """Return a vertex that carries others."""
        path = self.character(at, model)
        if path is None:
            return None
        place = self.place(at, model)
        return self._there(at, OnVertex(path, model.mesh, model.vertex, place))

    def _there(self, at: Location, carrier: CarrierT) -> CarrierT | None:
        """Return what carries, checked; of the scene's own character that is later."""
        self.carriers.append(carrier.file)
        if carrier.file == self.document.path:
            return carrier
        try:
            rig = open_take(carrier.file).rig
        except AnimtoolError as error:
            # They are of that file, and are told with it.
            self.document.faults.extend(error.faults)
            self.sound = False
            return None
        fault = carrier.fault(rig)
        if fault is not None:
            self.note((*at, str(fault.where)), fault)
        return carrier

    def carrying_prim(self, at: Location, model: CarryingPrimModel) -> OnPrim | None:
        """Return a prim that carries others."""
        from animtool.usd.props.reader import open_prop

        path = self.input((*at, "file"), model.file)
        if path is None:
            return None
        self.carriers.append(path)
        try:
            open_prop(PropRequest(path, model.prim, model.prim), UpAxis.Y)
        except AnimtoolError as error:
            (fault, *_) = error.faults
            self.note((*at, "prim"), Fault("SIM053", fault.message, hint=fault.hint))
        return OnPrim(path, model.prim, model.frame)

    def carrying_body(self, at: Location, model: CarryingBodyModel) -> OnBody:  # noqa: ARG002
        """Return a rigid body that carries others; systems are looked at later."""
        return OnBody(model.system, model.body)

    def _sound(self, at: Location, part: Any, *, check: bool) -> Any:
        """Return what an entry is read as, and note its own faults if asked to."""
        self.sound &= part is not None
        for why in part.faults() if check and part is not None else ():
            self.note(at, Fault("SIM020", why))
        return part


def _marks(annotation: Any, marks: Sequence[Any]) -> list[Any]:
    """Return what marks a type, or one that it may be."""
    inner = [_marks(one, ()) for one in get_args(annotation)]
    own = getattr(annotation, "__metadata__", ())
    return [*marks, *own, *(mark for found in inner for mark in found)]


def read_spec(
    document: Document,
    at: Location,
    spec: SystemSpec,
    roots: Sequence[Path],
    units: SceneUnits = METRES,
) -> SystemSetup | None:
    """Return the setup of an entry; None where faults leave none.

    ``units`` are those of the scene, which arrays of files that it names count too.

    What the keys `colliders`, `characters`, `systems` and `meshes` name is what it runs
    into, where the spec has them; other keys are read as their types say.
    """
    spec = units.converted(spec)
    outside, reader = (PartReader(document, roots, units) for _ in range(2))
    outer = outside.parts(at, spec, AROUND[:1])
    # Systems that are named are looked for, whatever else makes no sense.
    sound = outside.sound
    outer |= outside.parts(at, spec, AROUND[1:])
    parts = reader.parts(at, spec, type(spec).model_fields.keys() - {*AROUND})
    reader.note_ranges(at, spec)
    record, faults = spec.made(parts)
    for fault in faults:
        place = (*at, *location_of(fault.where or ""))
        document.add(fault.code, place, fault.message, fault.hint)
    if reader.sound:
        reader.note_whole(at, spec, spec.faults(parts))
    resume = None
    if spec.resume is not None:
        resume = reader.input((*at, "resume"), spec.resume)
    if spec.save is not None:
        reader.output((*at, "save"), spec.save)
    if record is None and (faults or not (sound and reader.sound)):
        return None
    followed = (*outside.files, *reader.files)
    read = {key: tuple(parts) for key, parts in outer.items()}
    tied = tuple(getattr(record, "tied", ()))
    around = Surroundings(**read, tied=tied, followed=followed, at=at)
    carriers = tuple(reader.carriers)
    return SystemSetup(spec, around, parts, record, at, carriers, resume)
