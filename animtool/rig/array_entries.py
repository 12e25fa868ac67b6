"""Array references and attachments of a rig file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from animtool.core.errors import counted
from animtool.core.names import most_similar, name_hint
from animtool.core.record import dataclass
from animtool.documents.arrays import Archives
from animtool.documents.document import Document, Location
from animtool.documents.references import resolve_reference, split_reference
from animtool.rig.parts import (
    ArrayRef,
    ArraySource,
    AttachKind,
    Attachment,
    LoadedArray,
)
from animtool.rig.schema import AttachModel

ArrayShape = tuple[int | None, ...]

# Array roles that count something and contain whole numbers.
_INTEGER_ROLES = frozenset({"faces", "indices", "pins", "vertices"})
# What indices count in, with its noun, by role.
_COUNTED_PARTS = {"indices": ("skin.joints", "joint")}
_MESH_POINTS = ("the mesh", "point")
# Keys of the file that differ from the role of their array.
_ROLE_KEYS = {"strands": "points"}
# Fills the missing corner of a triangle among quadrangles, and so on.
MISSING_CORNER = -1
# Placeholder of a refused array.
NO_ARRAY = LoadedArray(np.zeros(0))


@dataclass(frozen=True, slots=True)
class ArrayReader:
    """Checks array references; records faults in the document."""

    document: Document  # the file
    reference_roots: Sequence[Path]  # folders that references may lead into
    archives: Archives  # opens the files, while arrays are checked
    # Resolved paths of the file names seen so far.
    paths_by_name: dict[str, Path] = field(default_factory=dict)

    def read_array(
        self,
        location: Location,
        reference_text: str,
        role: str,
        shape: ArrayShape,
        part_count: int | None = None,
    ) -> ArraySource:
        """Return the array of an entry at a location, and record the array's faults."""
        key = _ROLE_KEYS.get(role, role)
        location = (*location, key)
        file_name, array_key = split_reference(reference_text, key)
        array_path = self.paths_by_name.get(file_name)
        array_path = array_path or resolve_reference(
            self.document, location, file_name, self.reference_roots
        )
        if array_path is None:
            return NO_ARRAY
        self.paths_by_name[file_name] = array_path
        array_reference = ArrayRef(reference_text, array_path, array_key)
        try:
            message = self._header_fault(array_reference, role, shape)
            if message is not None:
                self.document.add("RIG019", location, f"{reference_text!r} {message}")
                return array_reference
            values = self.archives.load_stored(array_path, array_key)
            message = _value_fault(role, values, part_count)
            if message is not None:
                hint = _index_hint(role, values, part_count)
                self.document.add(
                    "RIG027", location, f"{reference_text!r} {message}", hint
                )
        except ValueError as error:
            code = "RIG020" if "pickled" in str(error) else "RIG018"
            self.document.add(code, location, str(error))
        return array_reference

    def read_optional_array(
        self,
        location: Location,
        reference_text: str | None,
        role: str,
        shape: ArrayShape,
        part_count: int | None = None,
    ) -> ArraySource | None:
        """Read an array as `read_array` does; None if the entry has no array."""
        if reference_text is None:
            return None
        return self.read_array(location, reference_text, role, shape, part_count)

    def row_count(self, source: ArraySource) -> int | None:
        """Return the length of an array; None if it cannot be read."""
        shape = self.array_shape(source)
        return shape[0] if shape else None

    def array_shape(self, source: ArraySource) -> tuple[int, ...] | None:
        """Return the shape of the array of a reference; None if it cannot be read."""
        if isinstance(source, LoadedArray):
            return None if source is NO_ARRAY else source.values.shape
        try:
            return self.archives.header(source.path, source.key).shape
        except ValueError:
            return None

    def _header_fault(self, ref: ArrayRef, role: str, shape: ArrayShape) -> str | None:
        """Return what is wrong with an array's shape or type; None if it is valid."""
        header = self.archives.header(ref.path, ref.key)
        is_match = len(header.shape) == len(shape) and all(
            expected_size is None or expected_size == size
            for expected_size, size in zip(shape, header.shape, strict=True)
        )
        if not is_match:
            expected_shape = ", ".join("any" if n is None else str(n) for n in shape)
            return f"has shape {header.shape}, not ({expected_shape})"
        if role in _INTEGER_ROLES and header.kind not in "iu":
            return "contains floats, not whole numbers"
        if role in {"faces", "strands"} and not header.shape[0]:
            return f"has no {role.removesuffix('s')}"
        if role == "strands" and header.shape[1] < 2:
            return f"has strands of {header.shape[1]} points, fewer than 2"
        if role == "faces" and header.shape[1] < 3:
            return f"has faces of {header.shape[1]} corners, fewer than 3"
        return None


def _value_fault(
    role: str, values: npt.NDArray[Any], part_count: int | None
) -> str | None:
    """Return what is wrong with the first invalid value of an array; None if valid."""
    if role in _INTEGER_ROLES:
        is_optional = np.zeros(values.shape, bool)
        if role == "faces":
            is_optional[:, 3:] = values[:, 3:] == MISSING_CORNER
        is_wrong = (
            (values < 0)
            if part_count is None
            else (values < 0) | (values >= part_count)
        )
        index = _first_index(is_wrong & ~is_optional)
        if index is None:
            return None
        message = f"contains {values[index]} at {list(index)}"
        if part_count is None:
            return f"{message}, not 0 or more"
        owner, noun = _COUNTED_PARTS.get(role, _MESH_POINTS)
        range_text = {0: "none", 1: "only 0"}.get(part_count, f"0 to {part_count - 1}")
        return f"{message}, but {owner} has {counted(part_count, noun)}: {range_text}"
    index = _first_index(~np.isfinite(values))
    if index is not None:
        return f"contains {values[index]} at {list(index)}, not a finite number"
    if role == "strands":
        return _strand_fault(values)
    return _weight_fault(values) if role == "weights" else None


def _index_hint(
    role: str, values: npt.NDArray[Any], part_count: int | None
) -> str | None:
    """Return a hint how to correct indices out of range; None if that is unclear."""
    if part_count is None or role not in _INTEGER_ROLES:
        return None
    if role == "faces":
        values = values[values != MISSING_CORNER]
    lowest, highest = (int(values.min()), int(values.max())) if values.size else (0, 0)
    if highest == part_count and lowest == 1:
        return f"{role} count from 0, but these from 1, as in an OBJ: subtract 1"
    if highest == part_count and lowest > 1:
        return f"{role} count from 0; if these count from 1, as in an OBJ, subtract 1"
    if highest < part_count:
        return f"{role} count from 0"
    if role == "indices":
        hint = f"the largest is {highest}: list {highest + 1} joints in skin.joints, "
        return f"{hint}or correct the indices"
    return f"the largest is {highest}: use the array exported with these points"


def _strand_fault(values: npt.NDArray[Any]) -> str | None:
    """Return a fault if a strand has two equal consecutive points, else None."""
    index = _first_index((values[:, 1:] == values[:, :-1]).all(axis=-1))
    if index is None:
        return None
    strand, point = index
    return f"has points {point} and {point + 1} of strand {strand} at the same position"


def _weight_fault(values: npt.NDArray[Any]) -> str | None:
    """Return a fault if weights are negative or all zero, else None."""
    index = _first_index(values < 0)
    if index is not None:
        return f"contains {values[index]} at {list(index)}, a negative weight"
    index = _first_index(np.asarray(~values.any(axis=1)))
    return None if index is None else f"gives vertex {index[0]} no weight"


def _first_index(is_wrong: npt.NDArray[np.bool_]) -> tuple[int, ...] | None:
    """Return the index of the first true value of a mask; None if there is none."""
    if not is_wrong.any():
        return None
    return tuple(map(int, np.unravel_index(int(is_wrong.argmax()), is_wrong.shape)))


LocatedCheck = Callable[[Location, str], object]

# Required and optional keys of each kind of attachment.
_ATTACH_KEYS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    AttachKind.SPRING_CHAIN: (("joints",), ()),
    AttachKind.CLOTH: (("mesh",), ("pins",)),
    AttachKind.STRANDS: (("joint", "points"), ()),
}
# A kind this similar to a known one is a misspelling, not a custom kind.
MISSPELLING_SIMILARITY = 0.8


@dataclass(frozen=True, slots=True)
class AttachmentReader:
    """Builds attachments; records faults in the document."""

    document: Document  # the file
    array_reader: ArrayReader  # checks the arrays that the file refers to
    # Number of points of each mesh; None if unknown.
    point_counts: Mapping[str, int | None]
    check_joint: LocatedCheck  # records an unknown joint
    check_mesh: LocatedCheck  # records an unknown mesh

    def read_attachment(self, location: Location, entry: AttachModel) -> Attachment:
        """Return an attachment; record its faults in the document."""
        self._check_keys(location, entry)
        joint_names = tuple(entry.joints or ())
        for k, name in enumerate(joint_names):
            self.check_joint((*location, "joints", k), name)
        if entry.joint is not None:
            self.check_joint((*location, "joint"), entry.joint)
            joint_names = (entry.joint,)
        if entry.mesh is not None:
            self.check_mesh((*location, "mesh"), entry.mesh)
        point_count = self.point_counts.get(entry.mesh or "")
        pins = self.array_reader.read_optional_array(
            location, entry.pins, "pins", (None,), point_count
        )
        points = self.array_reader.read_optional_array(
            location, entry.points, "strands", (None, None, 3)
        )
        return Attachment(
            entry.name, entry.kind, joint_names, entry.mesh or "", pins, points
        )

    def _check_keys(self, location: Location, entry: AttachModel) -> None:
        """Record the missing and unsupported keys of an attachment's kind."""
        if self.document.is_placeholder((*location, "kind")):
            return
        required_keys, optional_keys = _ATTACH_KEYS.get(
            entry.kind, _ATTACH_KEYS[AttachKind.SPRING_CHAIN]
        )
        all_keys = ("joints", "joint", "mesh", "pins", "points")
        present_keys = [key for key in all_keys if getattr(entry, key) is not None]
        hint = f"its keys are {', '.join((*required_keys, *optional_keys))}"
        if entry.kind not in _ATTACH_KEYS:
            known_kinds = [str(kind) for kind in AttachKind]
            hint = name_hint(entry.kind, known_kinds)
            if most_similar(entry.kind, known_kinds, MISSPELLING_SIMILARITY):
                message = f"unknown kind of attachment {entry.kind!r}"
                self.document.warn("RIG102", (*location, "kind"), message, hint)
        for key in required_keys:
            is_certain = not self.document.is_placeholder((*location, key))
            if (
                key not in present_keys
                and is_certain
                and "attach" not in self.document.partial_lists
            ):
                message = f"an attachment of kind {entry.kind!r} has no {key}"
                self.document.add("RIG031", location, message, hint)
        for key in present_keys:
            if key not in (*required_keys, *optional_keys):
                message = f"an attachment of kind {entry.kind!r} does not use {key}"
                self.document.add("RIG031", (*location, key), message, hint)
