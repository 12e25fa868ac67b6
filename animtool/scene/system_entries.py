"""Reading what entries of systems have in common, all faults noted."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, Protocol, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import TypeAdapter, ValidationError

from animtool.documents.arrays import load_array
from animtool.documents.check import wrong_values
from animtool.documents.document import Document, Location
from animtool.documents.names import nearest
from animtool.documents.references import referred_input, split_reference
from animtool.errors import Fault
from animtool.scene.particle_schema import (
    CharacterModel,
    EmitterModel,
    Named,
    SystemColliderModel,
)
from animtool.sim.colliders import Box, Capsule, Collider, Mesh, Plane, Poses, Sphere

__all__ = ["Characters", "EntryReader", "poses_of"]

SHAPES: dict[str, type[Any]] = {
    "box": Box,
    "capsule": Capsule,
    "mesh": Mesh,
    "plane": Plane,
    "sphere": Sphere,
}
Record = TypeVar("Record")
# Files, and what touching the colliders in them does: restitution, friction, margin.
Characters: TypeAlias = tuple[tuple[Path, tuple[float, float, float]], ...]


class NamedCharacter(Protocol):
    """What names a character.

    Attributes:
        file: A clip or a scene.
        source: Whether it is that of the scene, in place of a file.
    """

    file: str | None
    source: bool


class EntryReader:
    """Makes records of the keys of an entry.

    Attributes:
        document: Where faults are noted.
        roots: Folders that files may be in.
        sound: Whether nothing was noted.
    """

    def __init__(self, document: Document, roots: Sequence[Path]) -> None:
        self.document, self.roots = document, tuple(roots)
        self.sound = True

    def note(self, at: Location, fault: Fault) -> None:
        """Note a fault at a place."""
        self.sound = False
        self.document.add(fault.code, at, fault.message, fault.hint)

    def checked(
        self, at: Location, make: Callable[[Location, Any], Record | None], model: Any
    ) -> Record | None:
        """Return what is made of an entry, its own faults noted at the entry."""
        made: Any = make(at, model)
        if made is None:
            self.sound = False
            return None
        for fault in made.faults(""):
            self.note(at, fault)
        return made  # type: ignore[no-any-return]

    def colliders(
        self, at: Location, models: Sequence[SystemColliderModel]
    ) -> list[Collider]:
        """Return the colliders of entries that make sense."""
        made = [
            self.checked((*at, i), self._collider, model)
            for i, model in enumerate(models)
        ]
        return [collider for collider in made if collider is not None]

    def _collider(self, at: Location, model: SystemColliderModel) -> Collider | None:
        shape = self.named((*at, "shape"), model.shape, SHAPES, "shape", "SIM020")
        if shape is None:
            return None
        given = model.model_dump(exclude={"at", "rotate", "moves", "shape"})
        return Collider(shape, poses_of(model), **given)

    def characters(self, at: Location, models: Sequence[CharacterModel]) -> Characters:
        """Return files of characters, and what touching one does."""
        found = []
        for i, model in enumerate(models):
            path = self.character((*at, i), model)
            if path is not None:
                found.append((path, (model.restitution, model.friction, model.margin)))
        return tuple(found)

    def character(self, at: Location, model: NamedCharacter) -> Path | None:
        """Return the file of a character; the scene's own has that of the scene."""
        if model.source is (model.file is not None):
            message = "it is a file, or the character of this scene"
            hint = "write file: walk.clip.yaml, or source: true"
            self.note(at, Fault("SCN066", message, hint=hint))
            return None
        if model.file is not None:
            return self.input((*at, "file"), model.file)
        if not self.document.value.get("source"):
            message = "the scene has no character: it has no source"
            hint = "name a file, or give the scene a source"
            self.note((*at, "source"), Fault("SCN066", message, hint=hint))
            return None
        return self.document.path

    def named(
        self,
        at: Location,
        entry: Named,
        table: Mapping[str, type[Any]],
        what: str,
        code: str,
    ) -> Any:
        """Return the record of an entry that names one of a table."""
        ((name, given),) = entry.items()
        if name not in table:
            hint = nearest(name, list(table))
            self.note((*at, name), Fault(code, f"no {what} is {name!r}", hint=hint))
            return None
        if table[name] is Mesh:
            return self._mesh((*at, name), given or {})
        return self.record((*at, name), table[name], given or {}, name)

    def record(
        self, at: Location, kind: type[Record], given: dict[str, Any], name: str
    ) -> Record | None:
        """Return a record of options, all of which are checked."""
        names = [field.name for field in fields(kind)]  # type: ignore[arg-type]
        unknown = [key for key in given if key not in names]
        for key in unknown:
            message = f"unknown option {key!r} of {name}"
            self.note((*at, key), Fault("SCN001", message, hint=nearest(key, names)))
        known = {key: value for key, value in given.items() if key in names}
        try:
            made = TypeAdapter(kind).validate_python(known)
        except ValidationError as error:
            for place, message in wrong_values(known, error):
                self.note((*at, *place), Fault("SCN002", message))
            return None
        return None if unknown else made

    def _mesh(self, at: Location, given: dict[str, Any]) -> Mesh | None:
        """Return the mesh whose arrays a file has."""
        arrays = []
        for key in ("points", "triangles"):
            text = given.get(key)
            if not isinstance(text, str):
                message = f"a mesh has {key}, such as stairs.npz#{key}"
                self.note((*at, key) if key in given else at, Fault("SCN002", message))
                continue
            arrays.append(self.array((*at, key), text, key))
        if len(arrays) < 2 or arrays[0] is None or arrays[1] is None:
            return None
        return Mesh(arrays[0], np.asarray(arrays[1], np.int64))

    def array(
        self, at: Location, text: str, default: str
    ) -> npt.NDArray[np.float64] | None:
        """Return the array that a reference names; None, and a fault, where none is.

        Args:
            at: Place of the reference.
            text: Such as ``hair.npz#points``.
            default: Name of the array where the reference says none.
        """
        name, key = split_reference(text, default)
        path = self.input(at, name)
        if path is None:
            return None
        try:
            return load_array(path, key)
        except ValueError as error:
            self.note(at, Fault("SCN005", str(error)))
            return None

    def input(self, at: Location, name: str) -> Path | None:
        """Return a file to read; None, and a fault, where there is none."""
        codes = "SCN004", "SCN005"
        path = referred_input(self.document, at, name, self.roots, codes)
        self.sound &= path is not None
        return path


def poses_of(model: EmitterModel | SystemColliderModel) -> Poses:
    """Return where an entry stands over time."""
    w, x, y, z = model.rotate
    if not model.moves:
        return Poses.fixed(model.at, (x, y, z, w))
    rows = np.array(model.moves)
    turns = np.tile([x, y, z, w], (len(rows), 1))
    return Poses(rows[:, 0], rows[:, 1:] + model.at, turns)
