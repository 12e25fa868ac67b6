"""Reading of system entries, derived from the types of their spec."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, get_args, get_origin

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
from animtool.scene.systems.carriers import JointCarrier, PrimCarrier, VertexCarrier
from animtool.scene.systems.character_motion import open_take
from animtool.scene.systems.entries import POSE_KEYS, EntryReader
from animtool.scene.systems.surroundings import Surroundings
from animtool.scene.systems.suspicions import (
    shape_volume,
    warn_of_agents_and_atoms,
    warn_of_radians,
    warn_of_rotations,
    warn_of_suspect_units,
)
from animtool.scene.systems.suspicious_forces import warn_of_forces
from animtool.systems.framework.body_carriers import BodyCarrier
from animtool.systems.framework.conversion import DEFAULT_UNITS, SceneUnits
from animtool.systems.framework.fields import (
    COLLISION_KEYS,
    CarryingBodyModel,
    CarryingJointModel,
    CarryingPrimModel,
    CarryingVertexModel,
    CharacterModel,
    FieldKind,
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

if TYPE_CHECKING:
    from animtool.scene.systems.gaits import GaitsSource
    from animtool.usd.caches.reader import StaticMesh

Reader: TypeAlias = Callable[[Location, Any], Any]


@dataclass(frozen=True, slots=True)
class Prototype:
    """A mesh to copy, sampled at phases of its animation cycle."""

    path: Path
    prim: str | None  # path of a prim in a USD file
    mesh: str | None  # name of a mesh in a rig
    phase_count: int  # number of phases of the cycle

    def __call__(self) -> tuple[MeshFrame, ...]:
        """Return the mesh at each phase of the cycle; a single mesh if it is static."""
        open_sampler = self._rig_sampler if self.prim is None else self._stage_sampler
        sample_frame, span = open_sampler()
        fractions = (
            [0.0] if span is None else np.arange(self.phase_count) / self.phase_count
        )
        begin, end = span or (0.0, 0.0)
        times = (begin + (end - begin) * float(fraction) for fraction in fractions)
        return tuple(map(sample_frame, times))

    def _stage_sampler(self) -> _FrameSampler:
        """Return a function that samples a prim at a time code, and its time span."""
        from animtool.usd.caches.reader import open_mesh

        assert self.prim is not None
        source = open_mesh(self.path, self.prim, UpAxis.Y)

        def frame_at_code(time_code: float) -> MeshFrame:
            surface = source.sample(None if source.span is None else time_code)
            return _mesh_frame(surface.points, surface.counts, surface.indices)

        return frame_at_code, source.span

    def _rig_sampler(self) -> _FrameSampler:
        """Return a function that samples a skin at a time, and its time span."""
        from animtool.scene.systems.character_motion import CharacterMotions, SkinMotion

        assert self.mesh is not None
        character = CharacterMotions().for_file(self.path)
        motion = SkinMotion(character, self.mesh)
        counts, indices = motion.faces

        def frame_at_time(t: float) -> MeshFrame:
            return _mesh_frame(motion.points(t), counts, indices)

        first, last = character.times[[0, -1]].tolist()
        return frame_at_time, (first, last) if last > first else None


_FrameSampler = tuple[Callable[[float], MeshFrame], tuple[float, float] | None]


def _mesh_frame(points: FloatArray, counts: IntArray, indices: IntArray) -> MeshFrame:
    return MeshFrame(
        points, np.zeros_like(points), counts.astype(np.int64), indices.astype(np.int64)
    )


class SpecEntryReader(EntryReader):
    """Reads the entries of a system spec by the types of their keys.

    Attributes:
        carriers: Files of the carriers.
    """

    def __init__(
        self,
        document: Document,
        roots: Sequence[Path],
        units: SceneUnits = DEFAULT_UNITS,
    ) -> None:
        super().__init__(document, roots, units)
        self.carriers: list[Path] = []
        # Populations often share their gaits, which are slow to read.
        self._gaits: dict[GaitsSource, GaitsSource] = {}

    def entry_values(
        self, location: Location, model: FileModel, keys: Collection[str] | None = None
    ) -> dict[str, Any]:
        """Return the parsed entries of a model by key; plain values are left out.

        A list has one element per valid entry. A nested model becomes such a mapping,
        or its record; an entry with a position includes its ``poses``.
        """
        entries: dict[str, Any] = {}
        is_checked = not isinstance(model, RecordModel)
        if isinstance(model, PlacedModel):
            poses = self.poses(location, model, model.code)
            entries["poses"] = self._checked_entry(
                location, poses, is_checked=is_checked
            )
        for key, field_info in type(model).model_fields.items():
            if keys is not None and key not in keys:
                continue
            value = getattr(model, key)
            is_placed = isinstance(model, PlacedModel) and key in POSE_KEYS
            field_type = (field_info.annotation, field_info.metadata)
            read_entry = self._reader(*field_type, is_checked=is_checked)
            if is_placed or read_entry is None or value is None:
                continue
            if FieldKind.ARRAY in _field_markers(*field_type):
                values = read_entry((*location, key), value)
                factor = self.units.array_factor(field_info.description)
                entries[key] = values
                if values is not None and factor != 1.0:
                    entries[key] = values * factor
            elif isinstance(value, list):
                entries[key] = self.read_each((*location, key), value, read_entry)
            else:
                entries[key] = read_entry((*location, key), value)
        return entries

    def parse_entry(self, location: Location, model: FileModel) -> Any:
        """Return the parsed entries of a model, or its record; None if it is faulty."""
        self.check_ranges(location, model)
        entries = self.entry_values(location, model)
        if not isinstance(model, RecordModel):
            return entries
        is_complete = all(entry is not None for entry in entries.values())
        record = model.record(entries) if is_complete else None
        return self.check_record(location, record, model)

    def _reader(
        self, annotation: Any, markers: Sequence[Any] = (), *, is_checked: bool
    ) -> Reader | None:
        """Return the method that reads entries of a type; None for plain values.

        With ``is_checked``, the faults of the parsed entries are recorded too.
        """
        for marker in markers:
            if isinstance(marker, FieldKind):
                read: Reader = getattr(self, READER_METHODS[marker])
                if marker in {FieldKind.EMITTER_SHAPE, FieldKind.SHAPE}:
                    return lambda location, base: self._checked_entry(
                        location, read(location, base), is_checked=is_checked
                    )
                return read
        if get_origin(annotation) is Annotated:
            markers = annotation.__metadata__
            return self._reader(annotation.__origin__, markers, is_checked=is_checked)
        if isinstance(annotation, type) and issubclass(annotation, FileModel):
            readers = (
                READER_METHODS[base]
                for base in annotation.__mro__
                if base in READER_METHODS
            )
            reader: Reader = getattr(self, next(readers, "parse_entry"))
            return reader
        item_readers = (
            self._reader(base, is_checked=is_checked) for base in get_args(annotation)
        )
        return next((read for read in item_readers if read is not None), None)

    def prototype(self, location: Location, model: PrototypeModel) -> Prototype | None:
        """Return the mesh to copy; the file of a USD prim is checked immediately."""
        if (model.prim is None) is (model.mesh is None):
            message = "write either the prim of a USD file, or the mesh of a rig"
            hint = "write prim: /bird/body, or mesh: body"
            self.record_fault(location, Fault("SIM053", message, hint=hint))
            return None
        path = self.find_followed((*location, "file"), model.file)
        if path is None:
            return None
        prototype = Prototype(path, model.prim, model.mesh, model.samples)
        if model.prim is not None:
            self.try_read((*location, "prim"), prototype, "SIM051")
        return prototype

    def gaits(self, location: Location, model: GaitsModel) -> GaitsSource | None:
        """Return the gait clips of a rig, read only once; None if they have a fault."""
        from animtool.scene.systems.gaits import GaitsSource

        rig = self.find_followed((*location, "rig"), model.rig)
        clips = self.read_each((*location, "clips"), model.clips, self.find_followed)
        if rig is None or len(clips) < len(model.clips):
            return None
        source = GaitsSource(rig, tuple(clips))
        source = self._gaits.setdefault(source, source)
        return None if self.try_read(location, source) is None else source

    def physics(self, location: Location, model: PhysicsStageModel) -> Physics | None:
        """Return a stage's UsdPhysics bodies; None after recording faults (SIM051)."""
        from animtool.usd.physics.read import read_bodies

        path = self.find_followed((*location, "file"), model.file)
        if path is None:
            return None
        try:
            return read_bodies(path, model.prim, model.frame)
        except AnimtoolError as error:
            for fault in error.faults:
                prim_name = path.name, fault.where or model.prim
                message = ": ".join([*prim_name, fault.message])
                prim_fault = replace(fault, code="SIM051", message=message)
                self.record_fault((*location, "prim"), prim_fault)
            return None

    def names(self, location: Location, entry: str | int) -> list[str | int]:
        """Return a name or number, or an array of them; empty if it is unreadable."""
        if not isinstance(entry, str) or ".npz" not in entry:
            return [entry]
        parent_keys = [step for step in location[:-2] if isinstance(step, str)]
        values = self.array(location, entry, parent_keys[-1])
        return [] if values is None else [int(n) for n in values.ravel().tolist()]

    def rest_mesh(self, location: Location, model: PrimMeshModel) -> StaticMesh | None:
        """Return a mesh of a USD file at its first frame."""
        from animtool.usd.caches.reader import read_static_mesh

        path = self.input((*location, "file"), model.file)
        if path is None:
            return None
        read = partial(read_static_mesh, path, model.prim, UpAxis.Y)
        return self.try_read((*location, "prim"), read, error_type=OptionError)

    def character_carrier(
        self, entry_path: Location, model: CarryingJointModel | CarryingVertexModel
    ) -> JointCarrier | VertexCarrier | None:
        """Return a joint or vertex as a carrier.

        It is checked now; the scene's own character is checked later.
        """
        path = self.character(entry_path, model)
        if path is None:
            return None
        location = entry_location(self.document, entry_path, model)
        carrier: JointCarrier | VertexCarrier
        if isinstance(model, CarryingJointModel):
            carrier = JointCarrier(path, model.joint, location)
        else:
            carrier = VertexCarrier(path, model.mesh, model.vertex, location)
        self.carriers.append(path)
        if path == self.document.path:
            return carrier
        try:
            rig = open_take(path).rig
        except AnimtoolError as error:
            # They are faults of that file, which reports them.
            self.document.faults.extend(error.faults)
            self.is_valid = False
            return None
        fault = carrier.fault(rig)
        if fault is not None:
            self.record_fault((*entry_path, str(fault.where)), fault)
        return carrier

    def prim_carrier(
        self, location: Location, model: CarryingPrimModel
    ) -> PrimCarrier | None:
        """Open a USD prim and return it as a carrier; None if its file is missing."""
        from animtool.usd.props.reader import open_prop

        path = self.input((*location, "file"), model.file)
        if path is None:
            return None
        self.carriers.append(path)
        request = PropRequest(path, model.prim, model.prim)
        read = partial(open_prop, request, UpAxis.Y)
        self.try_read((*location, "prim"), read, "SIM053")
        return PrimCarrier(path, model.prim, model.frame)

    def body_carrier(
        self,
        location: Location,  # noqa: ARG002
        model: CarryingBodyModel,
    ) -> BodyCarrier:
        """Return a rigid body as a carrier; its system is checked later."""
        return BodyCarrier(model.system, model.body)

    def _checked_entry(
        self, location: Location, entry: Any, *, is_checked: bool
    ) -> Any:
        """Return a parsed entry; if requested, record the faults that it reports."""
        self.is_valid &= entry is not None
        for reason in entry.faults() if is_checked and entry is not None else ():
            self.record_fault(location, Fault("SIM020", reason))
        return entry


# Readers of marked entries, or of a model, by the name of the method.
READER_METHODS: Mapping[Any, str] = {
    FieldKind.ARRAY: "array",
    FieldKind.NAMES: "names",
    FieldKind.FORCE: "force",
    FieldKind.EMITTER_SHAPE: "emitter_shape",
    FieldKind.SHAPE: "shape",
    PrototypeModel: "prototype",
    GaitsModel: "gaits",
    PhysicsStageModel: "physics",
    PrimMeshModel: "rest_mesh",
    CarryingJointModel: "character_carrier",
    CarryingVertexModel: "character_carrier",
    CarryingPrimModel: "prim_carrier",
    CarryingBodyModel: "body_carrier",
    SystemColliderModel: "collider",
    CharacterModel: "character_collider",
    SystemSurfaceModel: "surface",
    MovingMeshModel: "mesh",
}


def _field_markers(annotation: Any, markers: Sequence[Any]) -> list[Any]:
    """Return the annotations of a type and of its alternatives, such as arrays."""
    all_markers = [*markers, *getattr(annotation, "__metadata__", ())]
    for alternative in get_args(annotation):
        all_markers += _field_markers(alternative, ())
    return all_markers


# Keys whose values are compared with sizes, and keys of the sizes.
COMPARED_KEYS = {"stretch", "bodies", "viscosity"}
SIZE_KEYS = {
    *("radius", "self_contact", "springs", "mass", "density"),
    *("start", "end", "across", "up"),
}


def read_spec(
    document: Document,
    location: Location,
    spec: SystemSpec,
    roots: Sequence[Path],
    units: SceneUnits = DEFAULT_UNITS,
) -> SystemSetup | None:
    """Return the setup of a system's entry; None if it is faulty.

    ``units`` are those of the scene; they also apply to arrays that it names.

    The keys `colliders`, `characters`, `systems` and `meshes` name its colliders, if
    the spec has them; other keys are read as their types say.
    """
    spec = units.convert(spec)
    # One for the keys of colliders, one for the other keys, which make the record.
    collider_reader, record_reader = (
        SpecEntryReader(document, roots, units) for _ in range(2)
    )
    parsed_colliders = collider_reader.entry_values(location, spec, COLLISION_KEYS[:1])
    # Named systems are looked up even if other keys are invalid.
    are_colliders_valid = collider_reader.is_valid
    parsed_colliders |= collider_reader.entry_values(location, spec, COLLISION_KEYS[1:])
    entries = record_reader.entry_values(
        location, spec, type(spec).model_fields.keys() - {*COLLISION_KEYS}
    )
    record_reader.check_ranges(location, spec)
    if not COMPARED_KEYS.isdisjoint(type(spec).model_fields):
        sizes = spec.model_dump(include=COMPARED_KEYS | SIZE_KEYS)
        warn_of_suspect_units(document, location, sizes, units.length)
    stated_values = spec.model_dump(exclude_unset=True, by_alias=True)
    warn_of_forces(document, location, stated_values, units.length, shape_volume)
    warn_of_rotations(document, location, stated_values)
    warn_of_agents_and_atoms(document, location, stated_values, units.length)
    if units.angle == 1.0:
        warn_of_radians(document, location, stated_values)
    record, faults = spec.build_record(entries)
    for fault in faults:
        key_location = (*location, *parse_location(fault.where or ""))
        if fault.where and document.has_placeholder_below(key_location):
            continue  # a value of it is faulty
        document.add(fault.code, key_location, fault.message, fault.hint)
    if record_reader.is_valid:
        record_reader.record_entry_faults(location, spec, spec.faults(entries))
    resume = None
    if spec.resume is not None:
        resume = record_reader.input((*location, "resume"), spec.resume)
    if spec.save is not None:
        record_reader.output((*location, "save"), spec.save)
    if record is None and (
        faults or not (are_colliders_valid and record_reader.is_valid)
    ):
        return None
    surroundings = Surroundings(
        **{key: tuple(values) for key, values in parsed_colliders.items()},
        carrier_ties=tuple(getattr(record, "carrier_bodies", ())),
        followed_files=(*collider_reader.files, *record_reader.files),
        location=location,
    )
    carriers = tuple(record_reader.carriers)
    return SystemSetup(spec, surroundings, entries, record, location, carriers, resume)
