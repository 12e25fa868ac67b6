"""Arrays of a rig that no file of its own holds yet, on their way to one."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import overload

import numpy as np
import numpy.typing as npt

from animtool._types import FloatArray
from animtool.errors import Fault, FormatError
from animtool.rig.parts import (
    ArrayRef,
    ArraySource,
    Attachment,
    Inbetween,
    Mesh,
    Shape,
    Skin,
)
from animtool.rig.skeleton import Rig

StoredArrays = dict[str, npt.NDArray[np.generic]]


def with_file(rig: Rig, path: Path, *, moved: bool = False) -> tuple[Rig, StoredArrays]:
    """Return the rig with references to an npz file for its arrays, and the arrays.

    With ``moved`` what it refers to is stored as well: its file goes to another folder.
    """
    store = _Store(path, moved)
    meshes = tuple(store.mesh(mesh) for mesh in rig.meshes)
    shapes = tuple(store.shape(shape) for shape in rig.shapes)
    attach = tuple(store.attachment(entry) for entry in rig.attach)
    return replace(rig, meshes=meshes, shapes=shapes, attach=attach), store.arrays


@dataclass(slots=True)
class _Store:
    path: Path
    moved: bool
    arrays: StoredArrays = field(default_factory=dict)

    @overload
    def ref(
        self, source: ArraySource, name: str, *, whole: bool = False
    ) -> ArraySource: ...
    @overload
    def ref(
        self, source: ArraySource | None, name: str, *, whole: bool = False
    ) -> ArraySource | None: ...
    def ref(
        self, source: ArraySource | None, name: str, *, whole: bool = False
    ) -> ArraySource | None:
        """Return a reference to an array, which is stored if no file has it."""
        if source is None or (isinstance(source, ArrayRef) and not self.moved):
            return source
        try:
            values = source.load()
        except ValueError as error:
            raise FormatError(Fault("RIG018", str(error))) from error
        key = plain = re.sub(r"\W", "_", name)
        number = 2
        while key in self.arrays:
            key, number = f"{plain}_{number}", number + 1
        self.arrays[key] = _smallest(values, whole=whole)
        return ArrayRef(f"{self.path.name}#{key}", self.path, key)

    def mesh(self, mesh: Mesh) -> Mesh:
        """Return a mesh with references."""
        skin = mesh.skin
        return replace(
            mesh,
            points=self.ref(mesh.points, f"{mesh.name}_points"),
            faces=self.ref(mesh.faces, f"{mesh.name}_faces", whole=True),
            normals=self.ref(mesh.normals, f"{mesh.name}_normals"),
            skin=None if skin is None else self.skin(skin, mesh.name),
        )

    def skin(self, skin: Skin, mesh: str) -> Skin:
        """Return a skin with references."""
        return replace(
            skin,
            indices=self.ref(skin.indices, f"{mesh}_joints", whole=True),
            weights=self.ref(skin.weights, f"{mesh}_weights"),
        )

    def shape(self, shape: Shape) -> Shape:
        """Return a shape with references."""
        name = shape.name
        return replace(
            shape,
            deltas=self.ref(shape.deltas, name),
            normals=self.ref(shape.normals, f"{name}_normals"),
            vertices=self.ref(shape.vertices, f"{name}_vertices", whole=True),
            inbetweens=tuple(self.step(step, name) for step in shape.inbetweens),
        )

    def step(self, step: Inbetween, shape: str) -> Inbetween:
        """Return an inbetween with references."""
        name = f"{shape}_{step.at:g}"
        return replace(
            step,
            deltas=self.ref(step.deltas, name),
            normals=self.ref(step.normals, f"{name}_normals"),
        )

    def attachment(self, entry: Attachment) -> Attachment:
        """Return an attachment with references."""
        return replace(
            entry,
            pins=self.ref(entry.pins, f"{entry.name}_pins", whole=True),
            points=self.ref(entry.points, f"{entry.name}_points"),
        )


def _smallest(values: FloatArray, *, whole: bool) -> npt.NDArray[np.generic]:
    """Return the numbers in 32 bits where these hold them exactly."""
    kind = np.int32 if whole else np.float32
    with np.errstate(over="ignore", invalid="ignore"):
        small = values.astype(kind)
    return small if (small == values).all() else values
