"""Reads the scene of an FBX file: nodes, meshes, skins and takes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import listed
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.formats.characters.nodes import NO_TRANSFORM, FileSkin, Node
from animtool.formats.fbx.geometry import (
    FbxGeometry,
    has_unweighted_points,
    read_geometry,
)
from animtool.formats.fbx.models import Model, read_models
from animtool.formats.fbx.objects import FbxFile, ObjectId, open_objects
from animtool.formats.fbx.settings import FbxSettings, read_settings
from animtool.formats.fbx.takes import AnimTake, find_default_take, read_takes

MAX_LISTED_OBJECTS = 6


@dataclass(slots=True, eq=False)
class FbxScene:
    """Nodes, meshes, skins and takes of an FBX file."""

    file: FbxFile  # objects of the file
    settings: FbxSettings  # unit, axes and rate
    models: list[Model]  # nodes, parents first
    meshes: dict[int, FbxGeometry]  # meshes by index of the node that shows them
    takes: list[AnimTake]  # takes in file order
    default_take: int  # index of the take read by default; -1 for none
    nodes: tuple[Node, ...]  # the node tree, one node per model
    skins: tuple[FileSkin, ...]  # one per skinned mesh that a node shows
    # World transform of each skin's mesh at bind time.
    mesh_bind_worlds: list[FloatArray]
    scenes: list[list[int]]
    ignored_contents: tuple[str, ...] = ()  # labels of contents that are not read
    default_scene: int = -1

    def bind_worlds(self) -> list[FloatArray]:
        """Return the world transform of each skin's mesh at bind time, in rig axes."""
        file_to_rig = np.eye(4)
        file_to_rig[:3, :3] = self.settings.basis
        return [file_to_rig @ world for world in self.mesh_bind_worlds]

    @property
    def path(self) -> Path:
        """Path of the file."""
        return self.file.path


def open_fbx(path: Path | str, up: UpAxis | None = None) -> FbxScene:
    """Open an FBX file, and validate all numbers that affect motion.

    ``up`` is the up axis of the file; None is the stated axis.
    """
    file = open_objects(path)
    settings = read_settings(file, up)
    models = read_models(file)
    node_indices = {model.object.id: i for i, model in enumerate(models)}
    geometry = read_geometry(file)
    meshes = {node_indices[i]: m for i, m in geometry.items() if i in node_indices}
    takes = read_takes(file)
    skins, mesh_bind_worlds = _build_skins(meshes, node_indices)
    _warn_of_constraints(file)
    return FbxScene(
        file,
        settings,
        models,
        meshes,
        takes,
        find_default_take(file, takes),
        _build_nodes(models, meshes),
        tuple(skins),
        mesh_bind_worlds,
        [],
        _ignored_labels(file),
    )


def _build_skins(
    meshes: dict[int, FbxGeometry], node_indices: dict[ObjectId, int]
) -> tuple[list[FileSkin], list[FloatArray]]:
    """Return skins, and the world transforms of their meshes at bind time."""
    skins, mesh_bind_worlds = [], []
    for node, mesh in meshes.items():
        if not mesh.clusters:
            continue
        joints = [node_indices[cluster.bone] for cluster in mesh.clusters]
        matrices = [cluster.bone_from_mesh for cluster in mesh.clusters]
        if has_unweighted_points(mesh):
            joints.append(node)
            matrices.append(np.eye(4))
        location, inverse_bind = mesh.clusters[0].location, np.stack(matrices)
        skins.append(FileSkin(None, tuple(joints), -1, inverse_bind, location))
        mesh_bind_worlds.append(mesh.clusters[0].world_from_bone @ matrices[0])
    return skins, mesh_bind_worlds


def _build_nodes(
    models: list[Model], meshes: dict[int, FbxGeometry]
) -> tuple[Node, ...]:
    skinned_nodes = [i for i, mesh in meshes.items() if mesh.clusters]
    skin_of_node = {node: skin for skin, node in enumerate(skinned_nodes)}
    children: list[list[int]] = [[] for _ in models]
    for i, model in enumerate(models):
        if model.parent >= 0:
            children[model.parent].append(i)
    return tuple(
        Node(
            model.name,
            model.parent,
            tuple(children[i]),
            *NO_TRANSFORM,
            mesh=i if i in meshes else -1,
            skin=skin_of_node.get(i, -1),
        )
        for i, model in enumerate(models)
    )


# Labels of object kinds for appearance or unsupported surfaces.
_IGNORED_LABELS = {
    "Material": "materials",
    "Texture": "textures",
    "Video": "images",
    "NurbsSurface": "NURBS surfaces",
    "NurbsCurve": "NURBS curves",
    "Nurb": "NURBS surfaces",
    "TrimNurbsSurface": "NURBS surfaces",
    "Patch": "patches",
    "Line": "lines",
    "Camera": "cameras",
    "Light": "lights",
}


def _ignored_labels(file: FbxFile) -> tuple[str, ...]:
    """Return labels of contents that neither rigs nor takes can store."""
    element_kinds = ("Material", "Texture", "Video")
    labels = {
        _IGNORED_LABELS[kind]: None
        for fbx_object in file.objects.values()
        for kind in (
            fbx_object.kind if fbx_object.kind in element_kinds else fbx_object.subtype,
        )
        if kind in _IGNORED_LABELS
    }
    return tuple(sorted(labels))


def _warn_of_constraints(file: FbxFile) -> None:
    """Warn that the file's constraints are not evaluated (FBX107)."""
    constraints = file.objects_of_kind("Constraint")
    if constraints:
        names = [repr(constraint.name) for constraint in constraints]
        message = "constraints are not evaluated: "
        message += listed(names, MAX_LISTED_OBJECTS)
        hint = "driven nodes follow their curves only; bake them before exporting"
        file.diagnostics.warn("FBX107", constraints[0].element.location, message, hint)
