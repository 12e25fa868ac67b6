"""Readers of entries that several system kinds share; faults are recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import numpy.typing as npt

from animtool.core.errors import AnimtoolError, Fault, value_excerpt
from animtool.core.names import name_hint
from animtool.core.options import ENTRY_RANGE_MESSAGE, CheckedRecord, range_faults
from animtool.documents.arrays import load_array
from animtool.documents.check import (
    FileModel,
    record_from_options,
    unknown_option_faults,
)
from animtool.documents.document import Document, Location, parse_location
from animtool.documents.fields import MAX_NUMBER, record_from_model
from animtool.documents.model_faults import LocatedFaults
from animtool.documents.references import (
    resolve_input,
    resolve_reference,
    split_reference,
)
from animtool.maths import so3
from animtool.scene.systems.carriers import PrimCarrier, keyed_poses
from animtool.scene.systems.surroundings import animated_surface
from animtool.sim.colliders import SHAPES, Collider, HeightField, Mesh, Poses
from animtool.systems.framework.conversion import DEFAULT_UNITS, SceneUnits
from animtool.systems.framework.fields import (
    CarryingJointModel,
    CarryingVertexModel,
    CharacterModel,
    MovingMeshModel,
    NamedOptions,
    PlacedModel,
    SystemColliderModel,
    SystemSurfaceModel,
)

if TYPE_CHECKING:
    from animtool.systems.particles.forces.base import Force

# Keys of the poses of an entry.
POSE_KEYS = {"at", "rotate", "moves", "turns", "prim"}
ResultT = TypeVar("ResultT")
RecordT = TypeVar("RecordT", bound=CheckedRecord)
# Shapes as other tools call them.
_OTHER_SHAPES = {"ball": "sphere", "cube": "box", "cylinder": "capsule"}


class EntryReader:
    """Reads records from the keys of an entry.

    Attributes:
        document: Document that records faults.
        roots: Folders that may contain files.
        is_valid: Whether no fault was recorded.
        files: USD files that entries follow.
        units: Units of arrays of numbers; numbers of entries are in metres already.
    """

    def __init__(
        self,
        document: Document,
        roots: Sequence[Path],
        units: SceneUnits = DEFAULT_UNITS,
    ) -> None:
        self.document, self.roots, self.units = document, tuple(roots), units
        self.is_valid = True
        self.files: list[Path] = []

    def record_fault(self, location: Location, fault: Fault) -> None:
        """Record a fault at a location; the entry is invalid from then on."""
        self.is_valid, is_at_key = False, fault.code == "SCN001"
        message_and_hint = (fault.message, fault.hint)
        self.document.add(fault.code, location, *message_and_hint, is_at_key=is_at_key)

    def record_faults(self, location: Location, faults: LocatedFaults) -> None:
        """Record faults, each at a key below a location."""
        for key, fault in faults:
            self.record_fault((*location, *key), fault)

    def check_ranges(self, location: Location, model: FileModel) -> None:
        """Record a fault for each number of an entry that is out of range."""
        for fault in range_faults(model, ENTRY_RANGE_MESSAGE):
            self.record_fault((*location, fault.where or ""), fault)

    def try_read(
        self,
        location: Location,
        read: Callable[[], ResultT],
        code: str | None = None,
        error_type: type[AnimtoolError] = AnimtoolError,
    ) -> ResultT | None:
        """Return the result of a function; None if it raises, with its faults recorded.

        With a code, only the first fault is recorded, with that code.
        """
        try:
            return read()
        except error_type as error:
            faults: Sequence[Fault] = error.faults
            if code is not None:
                faults = [replace(faults[0], code=code)]
            for fault in faults:
                self.record_fault(location, fault)
            return None

    def check_record(
        self, location: Location, record: RecordT | None, model: FileModel
    ) -> RecordT | None:
        """Check a record, record its faults at their keys, and return it."""
        if record is None:
            self.is_valid = False
            return None
        problems, code = record.problems(), record.code
        faults = [Fault(code, reason, where=key) for key, reason in problems]
        self.record_entry_faults(location, model, faults)
        return record

    def record_entry_faults(
        self, location: Location, model: FileModel, faults: Sequence[Fault]
    ) -> None:
        """Record faults in an entry, each at its key or the nearest one present."""
        for fault in faults:
            key_location = _present_location(model, parse_location(fault.where or ""))
            self.record_fault((*location, *key_location), fault)

    def read_each(
        self,
        location: Location,
        models: Iterable[Any],
        read: Callable[[Location, Any], Any],
    ) -> list[Any]:
        """Return the parsed entries of a list, without faulty ones."""
        read_entries = [read((*location, i), model) for i, model in enumerate(models)]
        return [entry for entry in read_entries if entry is not None]

    def collision_entries(
        self, location: Location, key: str, models: Iterable[Any]
    ) -> tuple[Any, ...]:
        """Return the parsed colliders of a key in `COLLISION_KEYS`."""
        readers: Mapping[str, Callable[[Location, Any], Any]] = {
            "colliders": self.collider,
            "characters": self.character_collider,
            "systems": self.surface,
            "meshes": self.mesh,
        }
        converted_models = map(self.units.convert, models)
        return tuple(self.read_each((*location, key), converted_models, readers[key]))

    def collider(
        self, location: Location, model: SystemColliderModel
    ) -> Collider | None:
        """Return the collider of an entry; None if it is faulty."""
        shape = self.shape((*location, "shape"), model.shape)
        poses = None if shape is None else self.poses(location, model, "SIM020")
        collider = None
        if poses is not None:
            collider = record_from_model(Collider, model, shape=shape, poses=poses)
        return self.check_record(location, collider, model)

    def shape(self, location: Location, entry: NamedOptions) -> Any:
        """Return the collider shape of an entry such as ``{sphere: {radius: 1}}``."""
        return self.named_record(location, entry, SHAPES, "shape", "SIM020")

    def force(self, location: Location, entry: NamedOptions) -> Force | None:
        """Return a force, after checking the ranges of its numbers."""
        from animtool.systems.particles.forces.table import find_force

        ((name, options),) = entry.items()
        force_type = self.try_read((*location, name), lambda: find_force(name))
        if force_type is None:
            return None
        force = self.record((*location, name), force_type, options or {}, name)
        for option, reason in [] if force is None else force.faults():
            key = [option] if option in (options or {}) else []
            fault = Fault("SIM022", f"its {option} {reason}")
            self.record_fault((*location, name, *key), fault)
        return force

    def emitter_shape(self, location: Location, entry: NamedOptions) -> Any:
        """Return an emitter shape, which may be the surface of a mesh."""
        from animtool.systems.particles.emitter_shapes import (
            EMITTER_SHAPES,
            MeshSurface,
        )

        shape = self.named_record(location, entry, EMITTER_SHAPES, "place", "SIM021")
        return MeshSurface(shape) if isinstance(shape, Mesh) else shape

    def mesh(
        self, location: Location, model: MovingMeshModel
    ) -> MovingMeshModel | None:
        """Return a mesh of a USD file, animated or static, with its absolute path."""
        path = self.find_followed((*location, "file"), model.file)
        if path is None:
            return None
        mesh = model.model_copy(update={"file": str(path)})
        if self.try_read((*location, "prim"), lambda: animated_surface(mesh), "SIM051"):
            self.check_ranges(location, model)
        return mesh

    def poses(self, location: Location, model: PlacedModel, code: str) -> Poses | None:
        """Return the poses of an entry over time; None if it is faulty."""
        w, x, y, z = model.rotate
        entry_poses = Poses.fixed(model.at, (x, y, z, w))
        has_keys = model.moves or model.turns or model.prim is not None
        if not has_keys or entry_poses.faults():
            return entry_poses
        if model.prim is not None:
            return self._prim_poses(location, model, entry_poses, code)
        messages: dict[str, str] = {}
        for pose_key, row_length in (("moves", 4), ("turns", 5)):
            rows = np.array(getattr(model, pose_key)).reshape(-1, row_length)
            if (np.diff(rows[:, 0]) <= 0).any():
                messages[pose_key] = "its times must ascend"
            elif pose_key == "turns" and not rows[:, 1:].any(axis=1).all():
                messages[pose_key] = "a quaternion must not be all 0"
        for pose_key, message in messages.items():
            if self.document.has_placeholder_below((*location, pose_key)):
                self.is_valid = False
                continue  # its rows are faulty
            self.record_fault((*location, pose_key), Fault(code, message))
        return None if messages else keyed_poses(model, entry_poses)

    def _prim_poses(
        self, location: Location, model: PlacedModel, entry_poses: Poses, code: str
    ) -> Poses | None:
        """Return the poses of an entry that follows a prim; None if it is faulty."""
        assert model.prim is not None
        for key in ("moves", "turns"):
            if getattr(model, key):
                message = f"{key} does not apply to something that follows a prim"
                self.record_fault((*location, key), Fault(code, message))
        path = self.find_followed((*location, "prim", "file"), model.prim.file)
        if path is None:
            return None
        prim = PrimCarrier(path, model.prim.prim, model.prim.frame)
        key_location = (*location, "prim", "prim")
        carrier = self.try_read(key_location, prim.sample_poses, "SIM053")
        if carrier is None:
            return None
        offset = entry_poses.rows[0]
        rotations = carrier.rows[:, 3:]
        return Poses(
            carrier.sample_times,
            carrier.rows[:, :3] + so3.rotate(rotations, offset[:3]),
            so3.multiply(rotations, offset[3:]),
        )

    def character_collider(
        self, location: Location, model: CharacterModel
    ) -> CharacterModel | None:
        """Return a character collider, with the absolute path of its file."""
        path = self.character(location, model)
        if path is None:
            return None
        self.check_ranges(location, model)
        if model.mesh is not None and model.margin <= 0:
            reason = "its margin must be above 0: it is half the thickness of the mesh"
            self.record_fault((*location, "margin"), Fault("SIM020", reason))
        return model.model_copy(update={"file": str(path)})

    def surface(
        self, location: Location, model: SystemSurfaceModel
    ) -> SystemSurfaceModel:
        """Return the collision surface of a scene's system that an entry names."""
        self.check_ranges(location, model)
        return model

    def character(
        self,
        location: Location,
        model: CharacterModel | CarryingJointModel | CarryingVertexModel,
    ) -> Path | None:
        """Return the file of a character; the scene file for the scene's own."""
        if model.source is (model.file is not None):
            message = "write either a file, or the character of this scene"
            hint = "write file: walk.clip.yaml, or source: true"
            self.record_fault(location, Fault("SCN066", message, hint=hint))
            return None
        if model.file is not None:
            return self.input((*location, "file"), model.file)
        if not self.document.value.get("source"):
            message = "the scene has no character, as it has no source"
            hint = "name a file, or give the scene a source"
            self.record_fault(
                (*location, "source"), Fault("SCN066", message, hint=hint)
            )
            return None
        return self.document.path

    def named_record(
        self,
        location: Location,
        entry: NamedOptions,
        table: Mapping[str, type[Any]],
        noun: str,
        code: str,
    ) -> Any:
        """Return the record of an entry that names a type of a table."""
        ((name, values),) = entry.items()
        if name not in table:
            hint = name_hint(_OTHER_SHAPES.get(name, name), list(table))
            fault = Fault(code, f"unknown {noun} {name!r}", hint=hint)
            self.record_fault((*location, name), fault)
            return None
        location, record_type, values = (*location, name), table[name], values or {}
        if record_type is Mesh:
            return self._mesh(location, values)
        if record_type is HeightField:
            return self._height_field(location, values)
        return self.record(location, record_type, values, name)

    def record(
        self,
        location: Location,
        record_type: type[ResultT],
        values: dict[str, Any],
        name: str,
    ) -> ResultT | None:
        """Check all options and return their record; None if any is faulty."""
        record, faults = record_from_options(record_type, values, name)
        self.record_faults(location, faults)
        return None if faults else record

    def _mesh(self, location: Location, values: dict[str, Any]) -> Mesh | None:
        """Return the mesh of a file's arrays; None if they are faulty."""
        keys = ["points", "triangles", "closed"]
        key_faults = unknown_option_faults(values, keys, "mesh")
        self.record_faults(location, key_faults)
        is_closed = values.get("closed", False)
        if not isinstance(is_closed, bool):
            message = f"must be true or false, not {value_excerpt(is_closed)}"
            self.record_fault((*location, "closed"), Fault("SCN002", message))
            return None
        points, triangles = (
            self._named_array(
                location, values, key, f"a mesh needs {key}, such as stairs"
            )
            for key in ("points", "triangles")
        )
        if key_faults or points is None or triangles is None:
            return None
        indices = np.asarray(triangles, np.int64)
        return Mesh(points * self.units.length, indices, is_closed)

    def _height_field(self, location: Location, values: dict[str, Any]) -> Mesh | None:
        """Return the mesh of a height field from a file; None if it is faulty."""
        message = "a height field needs heights, such as hill"
        heights = self._named_array(location, values, "heights", message)
        if heights is not None:
            heights = heights * self.units.length
        options = {key: value for key, value in values.items() if key != "heights"}
        field = self.record(location, HeightField, options, "height_field")
        if heights is None or field is None:
            return None
        faults = [("size", reason) for reason in field.faults()]
        faults += [("heights", reason) for reason in field.height_faults(heights)]
        for key, reason in faults:
            self.record_fault((*location, key), Fault("SIM020", reason))
        return None if faults else field.mesh(heights)

    def _named_array(
        self, location: Location, values: dict[str, Any], key: str, missing_message: str
    ) -> npt.NDArray[np.float64] | None:
        """Return the array that a required option names; None if it is faulty.

        ``missing_message`` ends in the stem of an example file.
        """
        text = values.get(key)
        if isinstance(text, str):
            return self.array((*location, key), text, key)
        key_location = (*location, key) if key in values else location
        self.record_fault(key_location, Fault("SCN002", f"{missing_message}.npz#{key}"))
        return None

    def array(
        self, location: Location, text: str, default_name: str | None = None
    ) -> npt.NDArray[np.float64] | None:
        """Return the array that a reference names; record a fault if it is unreadable.

        ``default`` is the array's name if the text has none; None uses the key.
        """
        default_name = str(location[-1]) if default_name is None else default_name
        name, key = split_reference(text, default_name)
        path = self.input(location, name)
        if path is None:
            return None
        try:
            values = load_array(path, key)
        except ValueError as error:
            self.record_fault(location, Fault("RIG018", str(error)))
            return None
        reason = _array_fault(values)
        if reason is not None:
            self.record_fault(location, Fault("RIG018", f"{path.name}#{key} {reason}"))
        return values if reason is None else None

    def input(self, location: Location, name: str) -> Path | None:
        """Return a file to read, or None after recording that it is missing."""
        path = resolve_input(self.document, location, name, self.roots)
        self.is_valid &= path is not None
        return path

    def find_followed(self, location: Location, name: str) -> Path | None:
        """Return a USD file that the system depends on; None if it is missing."""
        path = self.input(location, name)
        self.files += [] if path is None else [path]
        return path

    def output(self, location: Location, name: str) -> None:
        """Record a fault if a file to write is outside the allowed folders."""
        reference = (self.document, location, name, self.roots)
        self.is_valid &= resolve_reference(*reference, is_output=True) is not None


def _array_fault(values: npt.NDArray[np.float64]) -> str | None:
    """Return why a system cannot use an array; None if it can."""
    if not values.ndim:
        return "is a single number, not a list"
    if np.abs(values).max(initial=0.0) > MAX_NUMBER:
        return f"contains a value beyond {MAX_NUMBER:g}"
    return None


def _present_location(model: FileModel, location: Location) -> Location:
    """Return the longest beginning of a location that is present in a model."""
    value: Any = model
    for i, step in enumerate(location):
        if isinstance(value, FileModel) and step in value.model_fields_set:
            value = getattr(value, str(step))
        elif isinstance(value, list) and isinstance(step, int) and step < len(value):
            value = value[step]
        else:
            return location[:i]
    return location
