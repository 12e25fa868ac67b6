"""Landmarks files, ``*.landmarks.yaml``: landmark positions on a rig's meshes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Len

from animtool.capture.face.model import FaceModel, NonlinearShapes
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.names import name_hint
from animtool.core.options import key
from animtool.core.record import dataclass
from animtool.documents.check import FileModel, validate_file
from animtool.documents.document import Document, Location, read_document
from animtool.documents.fields import IgnoreModel, Name, Real
from animtool.documents.references import resolve_named_rig
from animtool.rig.parts import Shape
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import Surface, SurfaceInbetween, SurfaceShape, surfaces_of
from animtool.skin.shapes import prepare_shapes

# Tolerance for the sum of a landmark's weights, since text is rounded.
WEIGHT_SUM_TOLERANCE = 1e-3

Vertex = Annotated[int, Ge(0)]


class LandmarkModel(FileModel):
    """An entry of ``points``: a landmark at one vertex, or between several."""

    name: Name = key("Name of the landmark, unique in the file.", "nose_tip")
    mesh: Name | None = key(
        "The mesh it is on. Default: that of the file.", "face", default=None
    )
    vertex: Vertex | None = key("The vertex it is at.", 1042, default=None)
    vertices: Annotated[list[Vertex], Len(1)] | None = key(
        "The vertices it lies between, such as those of a triangle.",
        [7, 12, 13],
        default=None,
    )
    weights: Annotated[list[Real], Len(1)] | None = key(
        "Barycentric coordinates: the weight of each vertex, with a sum of 1. "
        "Default: equal.",
        [0.5, 0.3, 0.2],
        default=None,
    )


class LandmarksModel(FileModel):
    """Schema of a landmarks file, ``*.landmarks.yaml``."""

    landmarks: Literal["animtool/1"] = key(
        "File type and format version.", "animtool/1"
    )
    rig: Name | None = key(
        "The rig of the landmarks. `mocap face` names the rig itself.",
        "head.rig.yaml",
        default=None,
    )
    mesh: Name | None = key(
        "The mesh of landmarks that name none. Default: the only mesh with shapes.",
        "face",
        default=None,
    )
    points: Annotated[list[LandmarkModel], Len(1)] = key(
        "The landmarks, in the order of captures without names.",
        [{"name": "nose_tip", "vertex": 1042}],
    )
    ignore: list[IgnoreModel] = key(
        "Findings of `animtool validate` that are accepted.",
        [{"code": "FAC008", "why": "this is intended"}],
        default=[],
    )


@dataclass(frozen=True, slots=True)
class LandmarksFile:
    """A landmarks file that was read and checked, but not yet matched to a rig."""

    document: Document
    model: LandmarksModel
    rig: Path | None  # the rig file it names, resolved

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the landmarks."""
        return tuple(point.name for point in self.model.points)


def load_landmarks(path: Path | str, rig: Rig | None = None) -> LandmarksFile:
    """Read a landmarks file; its meshes and vertices are checked by `face_model`.

    Args:
        path: The file.
        rig: Rig to use in place of the one it names, which may then be missing.

    Raises:
        FormatError: The file cannot be read or is malformed; lists every fault.
    """
    document = read_document(Path(path), "landmarks")
    return parse_landmarks(document, has_other_rig=rig is not None)


def parse_landmarks(
    document: Document, *, has_other_rig: bool = False
) -> LandmarksFile:
    """Check a landmarks document: unique names, and vertices with weights (FAC008)."""
    model = validate_file(document, "landmarks", LandmarksModel)
    index_of_name: dict[str, int] = {}
    for i, point in enumerate(model.points):
        location: Location = ("points", i)
        if point.name in index_of_name:
            message = f"two landmarks are called {point.name!r}"
            hint = f"the other is points[{index_of_name[point.name]}]"
            document.add("FAC008", (*location, "name"), message, hint)
        index_of_name.setdefault(point.name, i)
        if (point.vertex is None) == (point.vertices is None):
            message = "a landmark is either at one vertex or between several"
            hint = "write vertex: 12, or vertices: [12, 13, 14]"
            document.add("FAC008", location, message, hint)
        if point.weights is not None:
            count = len(point.vertices or ())
            if len(point.weights) != count:
                message = f"has {len(point.weights)} weights for {count} vertices"
                document.add("FAC008", (*location, "weights"), message)
            elif abs(sum(point.weights) - 1) > WEIGHT_SUM_TOLERANCE:
                message = f"the weights have a sum of {sum(point.weights):g}, not 1"
                document.add("FAC008", (*location, "weights"), message)
    rig = resolve_named_rig(document, model.rig, is_replaced=has_other_rig)
    document.check()
    return LandmarksFile(document, model, rig)


def face_model(file: LandmarksFile, rig: Rig) -> FaceModel:
    """Build a face model: a rig's landmarks at rest, and each shape's offsets there.

    Shapes with a weight are solved for; combined shapes depend on them.
    """
    surfaces = {surface.name: surface for surface in surfaces_of(rig)}
    anchors = _landmark_anchors(file, surfaces)
    neutral = np.stack(
        [
            weights @ surfaces[mesh].points[vertices]
            for mesh, vertices, weights in anchors
        ]
    )
    shapes: list[SurfaceShape] = []
    deltas: list[FloatArray] = []
    solved_indices: list[int] = []
    is_nonlinear = False
    for i, shape in enumerate(rig.shapes):
        displacement = _displacement(shape, surfaces, anchors)
        if displacement is None:
            continue
        offsets, inbetweens = displacement
        shapes.append(SurfaceShape(shape.name, offsets, inbetweens=inbetweens))
        is_nonlinear = is_nonlinear or bool(shape.combine or inbetweens)
        if not shape.combine:
            solved_indices.append(i)
            deltas.append(offsets)
    nonlinear_shapes = None
    if is_nonlinear:
        # A combined shape may combine others that move no landmark: keep all.
        nonlinear_shapes = NonlinearShapes(
            tuple(rig.shapes),
            prepare_shapes(shapes, neutral),
            tuple(solved_indices),
        )
    return FaceModel(
        file.names,
        tuple(rig.shapes[i].name for i in solved_indices),
        neutral,
        np.stack(deltas) if deltas else np.zeros((0, *neutral.shape)),
        nonlinear_shapes,
    )


_LandmarkAnchor = tuple[str, IntArray, FloatArray]


def _landmark_anchors(
    file: LandmarksFile, surfaces: dict[str, Surface]
) -> list[_LandmarkAnchor]:
    """Return mesh, vertices and weights of each landmark; check them (FAC008)."""
    document, model = file.document, file.model
    meshes_with_shapes = [name for name, surface in surfaces.items() if surface.shapes]
    default_mesh = model.mesh or (
        meshes_with_shapes[0] if len(meshes_with_shapes) == 1 else None
    )
    anchors: list[_LandmarkAnchor] = []
    if model.mesh and model.mesh not in surfaces:
        message = f"the rig has no mesh {model.mesh!r}"
        document.add("FAC008", ("mesh",), message, name_hint(model.mesh, surfaces))
    for i, point in enumerate(model.points):
        location: Location = ("points", i)
        mesh = point.mesh or default_mesh
        if mesh is None:
            message = "no mesh is named, and several have shapes"
            hint = f"allowed: {', '.join(meshes_with_shapes)}"
            document.add("FAC008", location, message, hint)
            continue
        if mesh not in surfaces:
            if point.mesh:
                message = f"the rig has no mesh {mesh!r}"
                hint = name_hint(mesh, surfaces)
                document.add("FAC008", (*location, "mesh"), message, hint)
            continue
        vertices = [point.vertex] if point.vertex is not None else point.vertices or []
        vertex_count = len(surfaces[mesh].points)
        for k, vertex in enumerate(vertices):
            if vertex >= vertex_count:
                vertex_key = (
                    ("vertex",) if point.vertex is not None else ("vertices", k)
                )
                message = (
                    f"mesh {mesh!r} has no vertex {vertex}; its vertices are 0 to "
                )
                message += f"{vertex_count - 1}"
                hint = "was the file made for another mesh?"
                document.add("FAC008", (*location, *vertex_key), message, hint)
        equal_weights = [1.0 / max(len(vertices), 1)] * len(vertices)
        anchors.append(
            (mesh, np.array(vertices), np.array(point.weights or equal_weights))
        )
    document.check()
    return anchors


_Displacement = tuple[FloatArray, tuple[SurfaceInbetween, ...]]


def _displacement(
    shape: Shape, surfaces: dict[str, Surface], anchors: list[_LandmarkAnchor]
) -> _Displacement | None:
    """Return a shape's offsets ``(N, 3)`` and in-betweens; None if it moves no mesh."""
    surface = surfaces.get(shape.mesh)
    if surface is None:
        return None
    surface_shape = next((s for s in surface.shapes if s.name == shape.name), None)
    if surface_shape is None:
        return None

    def at_landmarks(values: FloatArray) -> FloatArray:
        """Interpolate vertex offsets at the landmarks ``(N, 3)``; 0 on other meshes."""
        offsets = np.zeros((len(surface.points), 3))
        if surface_shape.vertices is None:
            offsets[:] = values
        else:
            offsets[surface_shape.vertices] = values
        landmark_offsets = [
            weights @ offsets[vertices] if mesh == shape.mesh else np.zeros(3)
            for mesh, vertices, weights in anchors
        ]
        return np.stack(landmark_offsets)

    inbetweens = tuple(
        SurfaceInbetween(inbetween.at, at_landmarks(inbetween.deltas))
        for inbetween in surface_shape.inbetweens
    )
    return at_landmarks(surface_shape.deltas), inbetweens
