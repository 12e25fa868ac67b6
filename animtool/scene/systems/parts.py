"""Reading the keys of a spec as their types say: forces, places, arrays and poses."""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence
from typing import Annotated, Any, TypeAlias, get_args, get_origin

from animtool.documents.check import FileModel
from animtool.documents.document import Location
from animtool.errors import Fault
from animtool.scene.systems.entries import PLACING, EntryReader
from animtool.systems.fields import Part, PlacedModel, SystemColliderModel

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
        for key, field in type(model).model_fields.items():
            value = getattr(model, key)
            placing = isinstance(model, PlacedModel) and key in PLACING
            read = self._reader(field.annotation, field.metadata)
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
            collides = issubclass(annotation, SystemColliderModel)
            return self.collider if collides else self.parts
        inner = (self._reader(one) for one in get_args(annotation))
        return next((read for read in inner if read is not None), None)

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
