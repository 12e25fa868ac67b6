"""What a kind gets that is a spec and a build: it is read, run and tried from these."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    TypeAlias,
    get_args,
    get_origin,
)

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import AnimtoolError, Fault, OptionError
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.documents.check import FileModel
from animtool.documents.document import Document, Location, location_of
from animtool.motion.frames import MeshFrame
from animtool.motion.physics import Physics
from animtool.motion.transforms import PropRequest
from animtool.scene.file.entries import SystemSetup, place_of_entry
from animtool.scene.systems.carriers import OnJoint, OnPrim, OnVertex
from animtool.scene.systems.character_motion import open_take
from animtool.scene.systems.entries import PLACING, EntryReader
from animtool.scene.systems.surroundings import Surroundings
from animtool.scene.systems.suspicions import warn_of_sizes
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
    from animtool.usd.caches.reader import StaticMesh

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
                parts[key] = self.each((*at, key), value, read)
            else:
                parts[key] = read((*at, key), value)
        return parts

    def entry(self, at: Location, model: FileModel) -> Any:
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
        for mark in marks:
            if isinstance(mark, Part):
                read: Reader = getattr(self, READERS[mark])
                if mark in {Part.PLACE, Part.SHAPE}:
                    return lambda at, one: self._sound(at, read(at, one), check=check)
                return read
        if get_origin(annotation) is Annotated:
            marks = annotation.__metadata__
            return self._reader(annotation.__origin__, marks, check=check)
        if isinstance(annotation, type) and issubclass(annotation, FileModel):
            own = (READERS[one] for one in annotation.__mro__ if one in READERS)
            found: Reader = getattr(self, next(own, "entry"))
            return found
        inner = (self._reader(one, check=check) for one in get_args(annotation))
        return next((read for read in inner if read is not None), None)

    def prototype(self, at: Location, model: PrototypeModel) -> Prototype | None:
        """Return a mesh that copies are made of; a USD file is looked at now."""
        if (model.prim is None) is (model.mesh is None):
            message = "write either the prim of a USD file, or the mesh of a rig"
            hint = "write prim: /bird/body, or mesh: body"
            self.note(at, Fault("SIM053", message, hint=hint))
            return None
        path = self.followed((*at, "file"), model.file)
        if path is None:
            return None
        made = Prototype(path, model.prim, model.mesh, model.samples)
        if model.prim is not None:
            self.opened((*at, "prim"), made, "SIM051")
        return made

    def gaits(self, at: Location, model: GaitsModel) -> GaitsSource | None:
        """Return clips of a rig; they are looked at now, once for all of one rig."""
        from animtool.scene.systems.gaits import GaitsSource

        rig = self.followed((*at, "rig"), model.rig)
        clips = self.each((*at, "clips"), model.clips, self.followed)
        if rig is None or len(clips) < len(model.clips):
            return None
        made = GaitsSource(rig, tuple(clips))
        made = self._gaits.setdefault(made, made)
        return None if self.opened(at, made) is None else made

    def physics(self, at: Location, model: PhysicsStageModel) -> Physics | None:
        """Return what UsdPhysics says of a stage."""
        from animtool.usd.physics.read import read_bodies

        path = self.followed((*at, "file"), model.file)
        if path is None:
            return None
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

    def still_mesh(self, at: Location, model: PrimMeshModel) -> StaticMesh | None:
        """Return a mesh of a USD file as it is at its first frame."""
        from animtool.usd.caches.reader import read_static_mesh

        path = self.input((*at, "file"), model.file)
        if path is None:
            return None
        return self.opened(
            (*at, "prim"),
            lambda: read_static_mesh(path, model.prim, UpAxis.Y),
            kind=OptionError,
        )

    def carrying_character(
        self, at: Location, model: CarryingJointModel | CarryingVertexModel
    ) -> OnJoint | OnVertex | None:
        """Return a joint or a vertex that carries others.

        It is checked now; of the scene's own character that is later.
        """
        path = self.character(at, model)
        if path is None:
            return None
        place = place_of_entry(self.document, at, model)
        carrier: OnJoint | OnVertex
        if isinstance(model, CarryingJointModel):
            carrier = OnJoint(path, model.joint, place)
        else:
            carrier = OnVertex(path, model.mesh, model.vertex, place)
        self.carriers.append(path)
        if path == self.document.path:
            return carrier
        try:
            rig = open_take(path).rig
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
        request = PropRequest(path, model.prim, model.prim)
        self.opened((*at, "prim"), lambda: open_prop(request, UpAxis.Y), "SIM053")
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


# What reads entries that are marked, or of a model, by the name of its method.
READERS: Mapping[Any, str] = {
    Part.ARRAY: "array",
    Part.NAMES: "names",
    Part.FORCE: "force",
    Part.PLACE: "emitter_place",
    Part.SHAPE: "shape",
    PrototypeModel: "prototype",
    GaitsModel: "gaits",
    PhysicsStageModel: "physics",
    PrimMeshModel: "still_mesh",
    CarryingJointModel: "carrying_character",
    CarryingVertexModel: "carrying_character",
    CarryingPrimModel: "carrying_prim",
    CarryingBodyModel: "carrying_body",
    SystemColliderModel: "collider",
    CharacterModel: "character_collider",
    SystemSurfaceModel: "surface",
    MovingMeshModel: "mesh",
}


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
    if "stretch" in type(spec).model_fields:
        sizes = {"radius", "stretch", "self_contact"}
        warn_of_sizes(document, at, spec.model_dump(include=sizes))
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
