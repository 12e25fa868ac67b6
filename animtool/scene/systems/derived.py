"""Reading, running and trials of a system kind, derived from its spec and build."""

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
from animtool.documents.document import Document, Location, parse_location
from animtool.motion.frames import MeshFrame
from animtool.motion.physics import Physics
from animtool.motion.transforms import PropRequest
from animtool.scene.file.entries import SystemSetup, entry_location
from animtool.scene.systems.carriers import OnJoint, OnPrim, OnVertex
from animtool.scene.systems.character_motion import open_take
from animtool.scene.systems.entries import POSE_KEYS, EntryReader
from animtool.scene.systems.surroundings import Surroundings
from animtool.scene.systems.suspicions import shape_volume, warn_of_sizes
from animtool.scene.systems.suspicious_forces import FORCE_KEYS, warn_of_forces
from animtool.systems.framework.conversion import METRES, SceneUnits
from animtool.systems.framework.fields import (
    COLLISION_KEYS,
    CarryingBodyModel,
    CarryingJointModel,
    CarryingPrimModel,
    CarryingVertexModel,
    CharacterModel,
    EntryPart,
    GaitsModel,
    MovingMeshModel,
    PhysicsStageModel,
    PlacedModel,
    PrimMeshModel,
    PrototypeModel,
    RecordModel,
    SystemColliderModel,
    SystemSurfaceModel,
)
from animtool.systems.framework.spec import SystemSpec
from animtool.systems.framework.tied import BodyCarrier

if TYPE_CHECKING:
    from animtool.scene.systems.gaits import GaitsSource
    from animtool.usd.caches.reader import StaticMesh

Reader: TypeAlias = Callable[[Location, Any], Any]


@dataclass(frozen=True, slots=True)
class Prototype:
    """A mesh that copies are made of, at the phases of its cycle."""

    path: Path
    prim: str | None  # path of a prim in a USD file
    mesh: str | None  # name of a mesh in a rig
    samples: int  # number of phases of the cycle

    def __call__(self) -> tuple[MeshFrame, ...]:
        """Return its mesh at each phase; one for a static mesh."""
        frame_at, span = self._of_rig() if self.prim is None else self._of_stage()
        fractions = [0.0] if span is None else np.arange(self.samples) / self.samples
        begin, end = span or (0.0, 0.0)
        return tuple(
            frame_at(begin + (end - begin) * float(fraction)) for fraction in fractions
        )

    def _of_stage(self) -> _MovingFrame:
        from animtool.usd.caches.reader import open_mesh

        assert self.prim is not None
        source = open_mesh(self.path, self.prim, UpAxis.Y)

        def at(code: float) -> MeshFrame:
            surface = source.at(None if source.span is None else code)
            return _frame(surface.points, surface.counts, surface.indices)

        return at, source.span

    def _of_rig(self) -> _MovingFrame:
        from animtool.scene.systems.character_motion import CharacterMotions, SkinMotion

        assert self.mesh is not None
        character = CharacterMotions().of(self.path)
        motion = SkinMotion(character, self.mesh)
        counts, indices = motion.faces

        def at(t: float) -> MeshFrame:
            return _frame(motion.points(t), counts, indices)

        first, last = character.times[[0, -1]].tolist()
        return at, (first, last) if last > first else None


_MovingFrame = tuple[Callable[[float], MeshFrame], tuple[float, float] | None]


def _frame(points: FloatArray, counts: IntArray, indices: IntArray) -> MeshFrame:
    return MeshFrame(
        points, np.zeros_like(points), counts.astype(np.int64), indices.astype(np.int64)
    )


class SpecPartReader(EntryReader):
    """Reads the entries of a system spec by the types of their keys.

    Attributes:
        carriers: Files of the carriers.
    """

    def __init__(
        self,
        document: Document,
        roots: Sequence[Path],
        units: SceneUnits = METRES,
    ) -> None:
        super().__init__(document, roots, units)
        self.carriers: list[Path] = []
        # Populations often share their gaits, which are slow to read.
        self._gaits: dict[GaitsSource, GaitsSource] = {}

    def parts(
        self, at: Location, model: FileModel, keys: Collection[str] | None = None
    ) -> dict[str, Any]:
        """Return the parsed entries of a model by key, without plain values.

        A list contains one part per valid entry. A nested model becomes such parts
        again, or its record; a placed entry includes its ``poses``.
        """
        parts: dict[str, Any] = {}
        check = not isinstance(model, RecordModel)
        if isinstance(model, PlacedModel):
            poses = self.poses(at, model, model.code)
            parts["poses"] = self._checked_part(at, poses, check=check)
        for key, field_info in type(model).model_fields.items():
            if keys is not None and key not in keys:
                continue
            value = getattr(model, key)
            is_placed = isinstance(model, PlacedModel) and key in POSE_KEYS
            part_reader = self._reader(
                field_info.annotation, field_info.metadata, check=check
            )
            if is_placed or part_reader is None or value is None:
                continue
            if EntryPart.ARRAY in _marks(field_info.annotation, field_info.metadata):
                values = part_reader((*at, key), value)
                factor = self.units.array_factor(field_info.description)
                parts[key] = values
                if values is not None and factor != 1.0:
                    parts[key] = values * factor
            elif isinstance(value, list):
                parts[key] = self.each((*at, key), value, part_reader)
            else:
                parts[key] = part_reader((*at, key), value)
        return parts

    def entry(self, at: Location, model: FileModel) -> Any:
        """Return the parts of a model, or its record; None with faults."""
        self.note_ranges(at, model)
        parts = self.parts(at, model)
        if not isinstance(model, RecordModel):
            return parts
        complete = all(part is not None for part in parts.values())
        record = model.record(parts) if complete else None
        return self.checked(at, record, model)

    def _reader(
        self, annotation: Any, marks: Sequence[Any] = (), *, check: bool
    ) -> Reader | None:
        """Return the method that reads entries of a type; None for plain values.

        Faults of places and shapes are noted where nothing else does.
        """
        for mark in marks:
            if isinstance(mark, EntryPart):
                read: Reader = getattr(self, READERS[mark])
                if mark in {EntryPart.EMITTER_SHAPE, EntryPart.SHAPE}:
                    return lambda at, base: self._checked_part(
                        at, read(at, base), check=check
                    )
                return read
        if get_origin(annotation) is Annotated:
            marks = annotation.__metadata__
            return self._reader(annotation.__origin__, marks, check=check)
        if isinstance(annotation, type) and issubclass(annotation, FileModel):
            readers = (READERS[base] for base in annotation.__mro__ if base in READERS)
            reader: Reader = getattr(self, next(readers, "entry"))
            return reader
        item_type = (self._reader(base, check=check) for base in get_args(annotation))
        return next((read for read in item_type if read is not None), None)

    def prototype(self, at: Location, model: PrototypeModel) -> Prototype | None:
        """Return the mesh of copies; a USD file is checked now."""
        if (model.prim is None) is (model.mesh is None):
            message = "write either the prim of a USD file, or the mesh of a rig"
            hint = "write prim: /bird/body, or mesh: body"
            self.note(at, Fault("SIM053", message, hint=hint))
            return None
        path = self.followed((*at, "file"), model.file)
        if path is None:
            return None
        prototype = Prototype(path, model.prim, model.mesh, model.samples)
        if model.prim is not None:
            self.opened((*at, "prim"), prototype, "SIM051")
        return prototype

    def gaits(self, at: Location, model: GaitsModel) -> GaitsSource | None:
        """Return gait clips of a rig, checked now and once for each rig."""
        from animtool.scene.systems.gaits import GaitsSource

        rig = self.followed((*at, "rig"), model.rig)
        clips = self.each((*at, "clips"), model.clips, self.followed)
        if rig is None or len(clips) < len(model.clips):
            return None
        source = GaitsSource(rig, tuple(clips))
        source = self._gaits.setdefault(source, source)
        return None if self.opened(at, source) is None else source

    def physics(self, at: Location, model: PhysicsStageModel) -> Physics | None:
        """Return the UsdPhysics bodies of a stage."""
        from animtool.usd.physics.read import read_bodies

        path = self.followed((*at, "file"), model.file)
        if path is None:
            return None
        try:
            return read_bodies(path, model.prim, model.frame)
        except AnimtoolError as error:
            for fault in error.faults:
                prim_name = path.name, fault.where or model.prim
                message = ": ".join([*prim_name, fault.message])
                self.note((*at, "prim"), replace(fault, code="SIM051", message=message))
            return None

    def names(self, at: Location, entry: str | int) -> list[str | int]:
        """Return a name or number, or those of an array; none if unreadable."""
        if not isinstance(entry, str) or ".npz" not in entry:
            return [entry]
        parent_keys = [step for step in at[:-2] if isinstance(step, str)]
        values = self.array(at, entry, parent_keys[-1])
        return [] if values is None else [int(n) for n in values.ravel().tolist()]

    def rest_mesh(self, at: Location, model: PrimMeshModel) -> StaticMesh | None:
        """Return a mesh of a USD file at its first frame."""
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
        """Return a joint or vertex as a carrier.

        It is checked now; of the scene's own character that is later.
        """
        path = self.character(at, model)
        if path is None:
            return None
        location = entry_location(self.document, at, model)
        carrier: OnJoint | OnVertex
        if isinstance(model, CarryingJointModel):
            carrier = OnJoint(path, model.joint, location)
        else:
            carrier = OnVertex(path, model.mesh, model.vertex, location)
        self.carriers.append(path)
        if path == self.document.path:
            return carrier
        try:
            rig = open_take(path).rig
        except AnimtoolError as error:
            # They are faults of that file, which reports them.
            self.document.faults.extend(error.faults)
            self.sound = False
            return None
        fault = carrier.fault(rig)
        if fault is not None:
            self.note((*at, str(fault.where)), fault)
        return carrier

    def carrying_prim(self, at: Location, model: CarryingPrimModel) -> OnPrim | None:
        """Return a prim as a carrier."""
        from animtool.usd.props.reader import open_prop

        path = self.input((*at, "file"), model.file)
        if path is None:
            return None
        self.carriers.append(path)
        request = PropRequest(path, model.prim, model.prim)
        self.opened((*at, "prim"), lambda: open_prop(request, UpAxis.Y), "SIM053")
        return OnPrim(path, model.prim, model.frame)

    def carrying_body(self, at: Location, model: CarryingBodyModel) -> BodyCarrier:  # noqa: ARG002
        """Return a rigid body as a carrier; its system is checked later."""
        return BodyCarrier(model.system, model.body)

    def _checked_part(self, at: Location, part: Any, *, check: bool) -> Any:
        """Return a parsed entry, with its own faults recorded if requested."""
        self.sound &= part is not None
        for reason in part.faults() if check and part is not None else ():
            self.note(at, Fault("SIM020", reason))
        return part


# Readers of marked entries, or of a model, by the name of the method.
READERS: Mapping[Any, str] = {
    EntryPart.ARRAY: "array",
    EntryPart.NAMES: "names",
    EntryPart.FORCE: "force",
    EntryPart.EMITTER_SHAPE: "emitter_shape",
    EntryPart.SHAPE: "shape",
    PrototypeModel: "prototype",
    GaitsModel: "gaits",
    PhysicsStageModel: "physics",
    PrimMeshModel: "rest_mesh",
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
    """Return the markers of a type or of its alternatives."""
    inner = [_marks(argument, ()) for argument in get_args(annotation)]
    metadata = getattr(annotation, "__metadata__", ())
    return [*marks, *metadata, *(mark for alternative in inner for mark in alternative)]


# Keys of system sizes to check, and the values to compare them with.
SIZES = {"stretch", "bodies"}
OF_SIZES = {"radius", "self_contact", "springs", "mass", "start", "end", "across", "up"}


def read_spec(
    document: Document,
    at: Location,
    spec: SystemSpec,
    roots: Sequence[Path],
    units: SceneUnits = METRES,
) -> SystemSetup | None:
    """Return the setup of an entry; None with faults.

    ``units`` are those of the scene, which arrays of files that it names count too.

    The keys `colliders`, `characters`, `systems` and `meshes` name its colliders, if
    the spec has them; other keys are read as their types say.
    """
    spec = units.converted(spec)
    collider_reader, reader = (SpecPartReader(document, roots, units) for _ in range(2))
    collider_parts = collider_reader.parts(at, spec, COLLISION_KEYS[:1])
    # Named systems are looked up even if other keys are invalid.
    is_valid = collider_reader.sound
    collider_parts |= collider_reader.parts(at, spec, COLLISION_KEYS[1:])
    parts = reader.parts(at, spec, type(spec).model_fields.keys() - {*COLLISION_KEYS})
    reader.note_ranges(at, spec)
    if not SIZES.isdisjoint(type(spec).model_fields):
        warn_of_sizes(document, at, spec.model_dump(include=SIZES | OF_SIZES))
    stated_values = spec.model_dump(include=FORCE_KEYS, exclude_unset=True)
    warn_of_forces(document, at, stated_values, units.length, shape_volume)
    record, faults = spec.build_record(parts)
    for fault in faults:
        at_key = (*at, *parse_location(fault.where or ""))
        document.add(fault.code, at_key, fault.message, fault.hint)
    if reader.sound:
        reader.note_entry(at, spec, spec.faults(parts))
    resume = None
    if spec.resume is not None:
        resume = reader.input((*at, "resume"), spec.resume)
    if spec.save is not None:
        reader.output((*at, "save"), spec.save)
    if record is None and (faults or not (is_valid and reader.sound)):
        return None
    followed_files = (*collider_reader.files, *reader.files)
    collider_arguments = {key: tuple(parts) for key, parts in collider_parts.items()}
    tied_bodies = tuple(getattr(record, "tied", ()))
    surroundings = Surroundings(
        **collider_arguments, tied=tied_bodies, followed=followed_files, at=at
    )
    carriers = tuple(reader.carriers)
    return SystemSetup(spec, surroundings, parts, record, at, carriers, resume)
