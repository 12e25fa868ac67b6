"""The values of a targets file: constants, keys, arrays and prims, checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import cast

import numpy as np

from animtool._types import FloatArray
from animtool.clip.channel_entries import ChannelReader, file_quaternions
from animtool.clip.channels import ClipUnits
from animtool.clip.schema import CurveModel
from animtool.documents.arrays import Archives
from animtool.documents.document import Document, Location
from animtool.documents.references import missing_hint, referred, split_reference
from animtool.errors import AnimtoolError, counted
from animtool.files import is_there
from animtool.ik.schema import ValueModel
from animtool.ik.values import (
    Keyed,
    PrimMotion,
    PrimPlace,
    PrimTurn,
    Rows,
    Still,
    Value,
)
from animtool.readers import find_reader
from animtool.rig.skeleton import Rig

# Of a value that follows a prim only, and of one that has keys only.
_OF_PRIM = ("file", "space", "offset", "rotate")
_OF_KEYS = ("interp", "tangents", "parametrization", "euler", "pre", "post")


@dataclass(frozen=True, slots=True)
class ValueReader:
    """Makes values of what stands in a document; what is wrong is noted there."""

    document: Document  # the file
    rig: Rig | None  # in whose world prims are; None reads none
    units: ClipUnits  # of the file
    roots: Sequence[Path]  # folders that references may lead into
    archives: Archives  # opens arrays, for as long as values are read
    first: Fraction | None  # frame of the first row of arrays; None where no range says
    count: int | None  # how many rows they must have; None where no range says

    def curve(self, at: Location, model: CurveModel, key: str) -> Keyed | None:
        """Return a curve of keys; ``weight`` is a key too."""
        reader = ChannelReader(self.document)
        reader.check(at, model)
        kind = {"orientation": "rotation", "weight": "control"}.get(key, "translation")
        target = {"rotation": "joint/x.rotation", "control": "control/x"}
        named = target.get(kind, "joint/x.translation")
        unit = self.units.of(named, model.euler or "")
        made = reader.channel(at, model, key, kind, unit)
        return None if made is None else Keyed(made)

    def value(
        self, at: Location, given: list[float] | str | ValueModel | None, key: str
    ) -> Value | None:
        """Return a value; None where there is none, or a faulty one."""
        if given is None or self.document.doubtful(at):
            return None
        if isinstance(given, str):
            return self._rows(at, given, key)
        if isinstance(given, ValueModel):
            return self._moving(at, given, key)
        if key == "orientation":
            return self._turn(at, given)
        return Still(tuple(value * self.units.length for value in given))

    def _turn(self, at: Location, given: list[float]) -> Still | None:
        rotations, wrong = file_quaternions(np.array([given], np.float64))
        if wrong:
            message = f"quaternion {given} has no length"
            self.document.add("TGT007", at, message)
            return None
        return Still(tuple(rotations[0].tolist()))

    def _moving(self, at: Location, model: ValueModel, key: str) -> Value | None:
        if (model.keys is None) == (model.prim is None):
            has = "both keys and a prim" if model.prim else "neither keys nor a prim"
            self.document.add("TGT009", at, f"has {has}", "one of them says where")
            return None
        names = _OF_PRIM if model.keys is not None else _OF_KEYS
        idle = [name for name in names if name in model.model_fields_set]
        if model.prim is not None and key != "orientation" and model.rotate:
            idle.append("rotate")
        if key == "orientation" and model.offset:
            idle.append("offset")
        for name in dict.fromkeys(idle):
            what = "keys have" if model.keys is not None else "a prim has here"
            self.document.add("TGT009", (*at, name), f"{what} no {name}")
        if model.keys is not None:
            given = {
                name: getattr(model, name)
                for name in CurveModel.model_fields
                if name in model.model_fields_set
            }
            return self.curve(at, CurveModel.model_construct(**given), key)
        return self._prim(at, model, key)

    def _prim(self, at: Location, model: ValueModel, key: str) -> Value | None:
        motion = self._motion(at, model)
        if motion is None:
            return None
        if key != "orientation":
            x, y, z = (v * self.units.length for v in model.offset or (0.0, 0.0, 0.0))
            return PrimPlace(motion, (x, y, z))
        turn = self._turn((*at, "rotate"), model.rotate or [1.0, 0.0, 0.0, 0.0])
        return None if turn is None else PrimTurn(motion, turn.value)

    def _motion(self, at: Location, model: ValueModel) -> PrimMotion | None:
        """Return what a prim does; None where it cannot be read, or needs a rig."""
        path = self._stage(at, model)
        if path is None or self.rig is None:
            return None
        try:
            opener = find_reader(path).prim_opener(path)
            return cast(PrimMotion, opener(path, model.prim, self.rig, model.space))
        except AnimtoolError as error:
            for fault in error.faults:
                key = "space" if fault.where == "space" else "prim"
                message = f"{model.file!r}: {fault.message}"
                self.document.add("TGT011", (*at, key), message, fault.hint)
            return None

    def _stage(self, at: Location, model: ValueModel) -> Path | None:
        """Return the file of a prim; None where it is not there."""
        if model.file is None:
            message = f"prim {model.prim!r} is of no file"
            self.document.add("TGT009", at, message, "add file: shot.usda")
            return None
        place = (*at, "file")
        path = referred(self.document, place, model.file, self.roots, "TGT010")
        there = path is not None and is_there(path)
        if path is not None and not (there and path.is_file()):
            wrong = "is a folder" if there else "does not exist"
            hint = missing_hint(self.document, model.file)
            self.document.add("TGT010", place, f"{model.file!r} {wrong}", hint)
            return None
        return path

    def _rows(self, at: Location, text: str, key: str) -> Rows | None:
        name, array = split_reference(text, key)
        path = referred(self.document, at, name, self.roots, "TGT010")
        if path is None:
            return None
        try:
            values = np.asarray(self.archives.stored(path, array), np.float64)
        except ValueError as error:
            self.document.add("TGT006", at, str(error))
            return None
        width = 4 if key == "orientation" else 3
        first, count = self.first, self.count
        if values.ndim != 2 or values.shape[1] != width or not len(values):
            wanted = "F" if count is None else count
            message = f"{text!r} has shape {values.shape}, not ({wanted}, {width})"
            self.document.add("TGT006", at, message)
            return None
        if count is not None and len(values) != count:
            message = f"{text!r} has {counted(len(values), 'row')}, and the range "
            message += counted(count, "frame")
            self.document.add("TGT006", at, message, "a row for each frame")
            return None
        return self._finite_rows(at, text, values, first)

    def _finite_rows(
        self, at: Location, text: str, values: FloatArray, first: Fraction | None
    ) -> Rows | None:
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if bad.size:
            row = int(bad[0])
            message = f"{text!r} holds {values[row].tolist()} in row {row}, not finite "
            message += "numbers"
            self.document.add("TGT007", at, message)
            return None
        place = self.document.place(at)
        if values.shape[1] == 3:
            return Rows(text, values * self.units.length, first, place)
        rotations, wrong = file_quaternions(values)
        if wrong:
            message = f"{text!r} holds a quaternion without length in row {wrong[0]}"
            self.document.add("TGT007", at, message)
            return None
        return Rows(text, rotations, first, place)
