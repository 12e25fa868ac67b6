"""Reads FBX nodes (models) and evaluates their transforms.

``local = T · Roff · Rp · Rpre · R · Rpost⁻¹ · Rp⁻¹ · Soff · Sp · S · Sp⁻¹``; the
linear part is a rotation times a scale. A child may ignore its parent's own scale
(Rrs) or apply it along its own axes (RrSs).

References: Autodesk, *FBX SDK documentation*, "Computing transformation matrices".
"""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.formats.fbx.layers import (
    OUTER_ROTATIONS,
    PIVOT_PROPERTIES,
    ROTATION,
    SCALING,
    TRANSLATION,
    XYZ_PRODUCT,
    rotations_from_angles,
)
from animtool.formats.fbx.objects import (
    ROOT_IDS,
    FbxFile,
    FbxObject,
    ObjectId,
    read_scalar,
    read_vector,
)
from animtool.formats.fbx.takes import AnimTake, find_track
from animtool.maths import so3

# Factor order by RotationOrder: in XYZ, X rotates first, so its factor is last.
_ROTATION_ORDERS = ("ZYX", "YZX", "XZY", "ZXY", "YXZ", "XYZ")
# How a node inherits its parent's scale: along its own axes, fully, or not at all.
COMPONENTWISE_SCALE, INHERIT_SCALE, IGNORE_SCALE = range(3)
MAX_MODELS = 100_000
_ZERO_VECTOR = (0.0, 0.0, 0.0)
TRANSFORM_PROPERTIES = (TRANSLATION, ROTATION, SCALING)


@dataclass(slots=True, eq=False)
class Model:
    """A node of the scene and the properties that make its local transform."""

    object: FbxObject  # object of the node in the file
    parent: int  # index of the parent node; -1 for a root
    # Translation, rotation [deg] and scale without animation ``(3, 3)``.
    base_values: FloatArray
    rotation_order: str  # rotation order, as in `euler.to_quaternion`
    pre_rotation: FloatArray  # pre-rotation ``(4,)``
    inverse_post_rotation: FloatArray  # inverse of the post-rotation ``(4,)``
    pivots: FloatArray  # offset and pivot of rotation, then of scaling ``(4, 3)``
    scale_inheritance: int  # how the node inherits the scale of its parent
    geometric_transform: FloatArray  # transform of the node's own mesh only ``(4, 4)``
    has_outer_rotations: bool  # whether rotation order, pre- and post-rotation apply
    outer_angles: FloatArray  # angles of pre- and post-rotation ``(2, 3)`` [deg]
    # Node whose scale, including inherited scale, it applies along its own axes; -1 for
    # none.
    scale_source: int = -1

    @property
    def name(self) -> str:
        """Name of the node, including its namespace."""
        return self.object.name

    def local_transforms(
        self, take: AnimTake | None, ticks: IntArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return translations, rotations and scales at times ``(F,)`` [ticks]."""
        values = _transform_values(self, take, ticks)
        pre, inverse_post = self.pre_rotation, self.inverse_post_rotation
        if take is not None and self.has_outer_rotations:
            pre_track, post_track = (
                find_track(take, self.object.id, name) for name in OUTER_ROTATIONS
            )
            if pre_track is not None:
                angles = pre_track.evaluate(self.outer_angles[0], ticks)
                pre = rotations_from_angles(angles, XYZ_PRODUCT)
            if post_track is not None:
                angles = post_track.evaluate(self.outer_angles[1], ticks)
                inverse_post = so3.conjugate(rotations_from_angles(angles, XYZ_PRODUCT))
        rotations = rotations_from_angles(values[:, 1], self.rotation_order)
        rotations = so3.multiply(so3.multiply(pre, rotations), inverse_post)
        scales = values[:, 2]
        pivots = _pivot_values(self, take, ticks)
        rotation_offset, rotation_pivot, scaling_offset, scaling_pivot = pivots
        pivot_offset = scaling_offset + scaling_pivot - rotation_pivot
        pivot_offset = pivot_offset - scales * scaling_pivot
        translations = values[:, 0] + rotation_offset + rotation_pivot
        if pivot_offset.any():
            translations = translations + so3.rotate(rotations, pivot_offset)
        return translations, rotations, scales


def read_models(file: FbxFile) -> list[Model]:
    """Return the nodes of a file, parents before children."""
    objects = [
        node_object
        for node_object in file.objects_of_kind("Model")
        if node_object.id not in ROOT_IDS and not _is_default_camera(file, node_object)
    ]
    if len(objects) > MAX_MODELS:
        message = f"{len(objects)} nodes; the limit is {MAX_MODELS}"
        file.diagnostics.fail("FBX013", file.root.location, message)
    parent_ids = {n.id: _parent_model(file, n) for n in objects}
    children: dict[ObjectId | None, list[FbxObject]] = {}
    for node_object in objects:
        children.setdefault(parent_ids[node_object.id], []).append(node_object)
    models: list[Model] = []
    pending = [(node_object, -1) for node_object in reversed(children.get(None, []))]
    while pending:
        node_object, parent = pending.pop()
        model, index = _read_model(file, node_object, parent), len(models)
        if parent >= 0 and model.scale_inheritance == COMPONENTWISE_SCALE:
            model.scale_source = parent
        elif parent >= 0 and model.scale_inheritance == IGNORE_SCALE:
            model.scale_source = models[parent].scale_source
        models.append(model)
        pending += [(c, index) for c in reversed(children.get(node_object.id, []))]
    if len(models) < len(objects):
        reachable_ids = {model.object.id for model in models}
        cyclic_object = next(n for n in objects if n.id not in reachable_ids)
        message = f"the node {cyclic_object.name!r} is its own ancestor"
        file.diagnostics.fail("FBX009", cyclic_object.element.location, message)
    return models


def _is_default_camera(file: FbxFile, node: FbxObject) -> bool:
    """Return whether a node is one of the unconnected cameras of old exporters."""
    return (
        node.subtype.startswith("Camera") and node.id not in file.outgoing_connections
    )


def _parent_model(file: FbxFile, node: FbxObject) -> ObjectId | None:
    targets = file.targets(node.id, "Model")
    parent_ids = [model.id for model in targets if model.id not in ROOT_IDS]
    if len(set(parent_ids)) > 1:
        message = f"the node {node.name!r} has {len(set(parent_ids))} parents"
        file.diagnostics.fail("FBX009", node.element.location, message)
    return parent_ids[0] if parent_ids else None


def _read_model(file: FbxFile, node: FbxObject, parent: int) -> Model:
    diagnostics = file.diagnostics

    def read_triple(name: str, default: tuple[float, ...] = _ZERO_VECTOR) -> FloatArray:
        return np.array(read_vector(node, name, default, diagnostics))

    unit_scale = (1.0, 1.0, 1.0)
    translation, base_rotation = read_triple(TRANSLATION), read_triple(ROTATION)
    base_values = np.stack(
        [translation, base_rotation, read_triple(SCALING, unit_scale)]
    )
    has_outer_rotations = bool(read_scalar(node, "RotationActive", 0, diagnostics))
    order_index, pre_angles, post_angles = 0, _ZERO_VECTOR, _ZERO_VECTOR
    if has_outer_rotations:
        order_index = int(read_scalar(node, "RotationOrder", 0, diagnostics))
        pre_angles, post_angles = (
            tuple(read_triple(f"{name}Rotation")) for name in ("Pre", "Post")
        )
    if not 0 <= order_index < len(_ROTATION_ORDERS):
        message = f"the node {node.name!r} has rotation order {order_index}, which is "
        message += "not supported"
        hint = "spherical XYZ is specific to MotionBuilder; export with an Euler order"
        diagnostics.fail("FBX004", node.element.location, message, hint)
    outer_angles = np.array([pre_angles, post_angles])
    outer_rotations = rotations_from_angles(outer_angles, XYZ_PRODUCT)
    scale_inheritance = int(
        read_scalar(node, "InheritType", INHERIT_SCALE, diagnostics)
    )
    if scale_inheritance not in {COMPONENTWISE_SCALE, INHERIT_SCALE, IGNORE_SCALE}:
        message = f"the node {node.name!r} has inherit type {scale_inheritance}, which "
        message += "is not supported"
        diagnostics.fail("FBX004", node.element.location, message)
    geometric_transform = np.eye(4)
    base_rotation = rotations_from_angles(
        read_triple("GeometricRotation")[None], XYZ_PRODUCT
    )[0]
    scale = read_triple("GeometricScaling", unit_scale)
    geometric_transform[:3, :3] = so3.to_matrix(base_rotation) * scale
    geometric_transform[:3, 3] = read_triple("GeometricTranslation")
    return Model(
        node,
        parent,
        base_values,
        _ROTATION_ORDERS[order_index],
        outer_rotations[0],
        so3.conjugate(outer_rotations[1]),
        np.stack([read_triple(name) for name in PIVOT_PROPERTIES]),
        scale_inheritance,
        geometric_transform,
        has_outer_rotations,
        outer_angles,
    )


def _transform_values(
    model: Model, take: AnimTake | None, ticks: IntArray
) -> FloatArray:
    """Return translation, rotation [deg] and scale at times ``(F, 3, 3)``."""
    values = np.repeat(model.base_values[None], len(ticks), axis=0)
    for k, name in enumerate(TRANSFORM_PROPERTIES):
        track = find_track(take, model.object.id, name)
        if track is not None:
            values[:, k] = track.evaluate(model.base_values[k], ticks)
    return values


def _pivot_values(
    model: Model, take: AnimTake | None, ticks: IntArray
) -> list[FloatArray]:
    """Return offset and pivot of rotation, then of scaling, at times ``(F,)``."""
    pivots = list(model.pivots)
    for k, name in enumerate(PIVOT_PROPERTIES):
        track = find_track(take, model.object.id, name)
        if track is not None:
            pivots[k] = track.evaluate(model.pivots[k], ticks)
    return pivots


def has_pivots(model: Model, take: AnimTake | None) -> bool:
    """Return whether a node has a pivot or pivot offset, static or in a take."""
    tracks = (find_track(take, model.object.id, name) for name in PIVOT_PROPERTIES)
    return bool(model.pivots.any()) or any(track is not None for track in tracks)


def find_animated_components(
    model: Model, take: AnimTake | None
) -> tuple[bool, bool, bool]:
    """Return whether translation, rotation and scale change in a take."""

    def is_animated(name: str) -> bool:
        track = find_track(take, model.object.id, name)
        return track is not None and not track.is_static()

    translation, rotation, scale = map(is_animated, TRANSFORM_PROPERTIES)
    translation |= any(map(is_animated, PIVOT_PROPERTIES))
    if model.has_outer_rotations:
        rotation |= any(map(is_animated, OUTER_ROTATIONS))
    return translation, rotation, scale
