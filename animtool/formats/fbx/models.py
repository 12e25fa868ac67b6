"""FBX nodes (models) and the evaluation of their transforms.

``local = T · Roff · Rp · Rpre · R · Rpost⁻¹ · Rp⁻¹ · Soff · Sp · S · Sp⁻¹``; the
linear part is a rotation times a scale. A child may ignore its parent's own scale
(Rrs) or apply it along its own axes (RrSs).

References: Autodesk, *FBX SDK documentation*, "Computing transformation matrices".
"""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.formats.fbx.angles import XYZ, rotations_of
from animtool.formats.fbx.layers import (
    OUTER_ROTATIONS,
    PIVOT_PROPERTIES,
    ROTATION,
    SCALING,
    TRANSLATION,
    PropertyTrack,
)
from animtool.formats.fbx.objects import (
    ROOT_IDS,
    FbxFile,
    Object,
    ObjectId,
    scalar,
    vector,
)
from animtool.formats.fbx.takes import AnimTake
from animtool.maths import so3

# Factor order by RotationOrder: in XYZ, X rotates first, so its factor is last.
_ROTATION_ORDERS = ("ZYX", "YZX", "XZY", "ZXY", "YXZ", "XYZ")
COMPONENTWISE, INHERIT, IGNORE = range(3)
MAX_MODELS = 100_000
_ZERO_VECTOR = (0.0, 0.0, 0.0)
_TRANSFORM_PROPERTIES = (TRANSLATION, ROTATION, SCALING)


@dataclass(slots=True, eq=False)
class Model:
    """A node.

    Attributes:
        object: Its object in the file.
        parent: Index of the parent node; -1 for a root.
        base: Translation, rotation [deg] and scale without animation ``(3, 3)``.
        order: Rotation order, as in `euler.to_quaternion`.
        pre: Pre-rotation ``(4,)``.
        post: Inverse of the post-rotation ``(4,)``.
        pivots: Offset and pivot of rotation, then of scaling ``(4, 3)``.
        inherit: How it inherits the scale of its parent.
        geometric: Transform of its own mesh only ``(4, 4)``.
        active: Whether rotation order, pre- and post-rotation apply.
        outer_angles: Angles of pre- and post-rotation ``(2, 3)`` [deg].
        scale_from: Node whose scale, including inherited scale, it applies along its
            own axes; -1 for none.
    """

    object: Object
    parent: int
    base: FloatArray
    order: str
    pre: FloatArray
    post: FloatArray
    pivots: FloatArray
    inherit: int
    geometric: FloatArray
    active: bool
    outer_angles: FloatArray
    scale_from: int = -1

    @property
    def name(self) -> str:
        """The node name, namespace included."""
        return self.object.name

    def local(
        self, take: AnimTake | None, ticks: IntArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return translations, rotations and scales at times ``(F,)`` [ticks]."""
        values = _transform_state(self, take, ticks)
        pre, post = self.pre, self.post
        if take is not None and self.active:
            pre_track, post_track = (
                _property_track(self, take, name) for name in OUTER_ROTATIONS
            )
            if pre_track is not None:
                pre = rotations_of(pre_track.at(self.outer_angles[0], ticks), XYZ)
            if post_track is not None:
                post = so3.conjugate(
                    rotations_of(post_track.at(self.outer_angles[1], ticks), XYZ)
                )
        rotations = rotations_of(values[:, 1], self.order)
        rotations = so3.multiply(so3.multiply(pre, rotations), post)
        scales = values[:, 2]
        offset, pivot, stretch, centre = _pivot_offsets(self, take, ticks)
        pivot_offset = stretch + centre - pivot - scales * centre
        translations = values[:, 0] + offset + pivot
        if pivot_offset.any():
            translations = translations + so3.rotate(rotations, pivot_offset)
        return translations, rotations, scales


def read_models(file: FbxFile) -> list[Model]:
    """Return the nodes, parents first."""
    objects = [
        element
        for element in file.of_kind("Model")
        if not _is_default_camera(file, element)
    ]
    objects = [element for element in objects if element.id not in ROOT_IDS]
    if len(objects) > MAX_MODELS:
        message = f"{len(objects)} nodes; the limit is {MAX_MODELS}"
        file.notes.fail("FBX013", file.root.where, message)
    parents = {element.id: _parent_model(file, element) for element in objects}
    children: dict[ObjectId | None, list[Object]] = {}
    for element in objects:
        children.setdefault(parents[element.id], []).append(element)
    models: list[Model] = []
    stack = [(element, -1) for element in reversed(children.get(None, []))]
    while stack:
        element, parent = stack.pop()
        node, index = _read_model(file, element, parent), len(models)
        if parent >= 0 and node.inherit == COMPONENTWISE:
            node.scale_from = parent
        elif parent >= 0 and node.inherit == IGNORE:
            node.scale_from = models[parent].scale_from
        models.append(node)
        stack += [(child, index) for child in reversed(children.get(element.id, []))]
    if len(models) < len(objects):
        reachable_ids = {model.object.id for model in models}
        cyclic_node = next(
            element for element in objects if element.id not in reachable_ids
        )
        message = f"the node {cyclic_node.name!r} is its own ancestor"
        file.notes.fail("FBX009", cyclic_node.element.where, message)
    return models


def _is_default_camera(file: FbxFile, node: Object) -> bool:
    """Return whether a node is a default camera that old exporters add."""
    return node.subtype.startswith("Camera") and node.id not in file.outgoing


def _parent_model(file: FbxFile, node: Object) -> ObjectId | None:
    parents = [model.id for model in file.targets(node.id, "Model")]
    parents = [id_ for id_ in parents if id_ not in ROOT_IDS]
    if len(set(parents)) > 1:
        message = f"the node {node.name!r} has {len(set(parents))} parents"
        file.notes.fail("FBX009", node.element.where, message)
    return parents[0] if parents else None


def _read_model(file: FbxFile, node: Object, parent: int) -> Model:
    notes = file.notes

    def triple(name: str, default: tuple[float, ...] = _ZERO_VECTOR) -> FloatArray:
        return np.array(vector(node, name, default, notes))

    base = np.stack(
        [triple(TRANSLATION), triple(ROTATION), triple(SCALING, (1.0,) * 3)]
    )
    active = bool(scalar(node, "RotationActive", 0, notes))
    order, pre, post = 0, _ZERO_VECTOR, _ZERO_VECTOR
    if active:
        order = int(scalar(node, "RotationOrder", 0, notes))
        pre, post = (tuple(triple(f"{name}Rotation")) for name in ("Pre", "Post"))
    if not 0 <= order < len(_ROTATION_ORDERS):
        message = (
            f"the node {node.name!r} has rotation order {order}, which is not supported"
        )
        hint = "spherical XYZ is specific to MotionBuilder; export with an Euler order"
        notes.fail("FBX004", node.element.where, message, hint)
    angles = np.array([pre, post])
    pre_and_post = rotations_of(angles, XYZ)
    inherit = int(scalar(node, "InheritType", INHERIT, notes))
    if inherit not in {COMPONENTWISE, INHERIT, IGNORE}:
        message = (
            f"the node {node.name!r} has inherit type {inherit}, which is not supported"
        )
        notes.fail("FBX004", node.element.where, message)
    geometric = np.eye(4)
    rotation = rotations_of(triple("GeometricRotation")[None], XYZ)[0]
    geometric[:3, :3] = so3.to_matrix(rotation) * triple("GeometricScaling", (1.0,) * 3)
    geometric[:3, 3] = triple("GeometricTranslation")
    return Model(
        node,
        parent,
        base,
        _ROTATION_ORDERS[order],
        pre_and_post[0],
        so3.conjugate(pre_and_post[1]),
        np.stack([triple(name) for name in PIVOT_PROPERTIES]),
        inherit,
        geometric,
        active,
        angles,
    )


def _property_track(
    model: Model, take: AnimTake | None, name: str
) -> PropertyTrack | None:
    return None if take is None else take.tracks.get((model.object.id, name))


def _transform_state(
    model: Model, take: AnimTake | None, ticks: IntArray
) -> FloatArray:
    """Return translation, rotation [deg] and scale at times ``(F, 3, 3)``."""
    states = np.repeat(model.base[None], len(ticks), axis=0)
    for k, name in enumerate(_TRANSFORM_PROPERTIES):
        track = _property_track(model, take, name)
        if track is not None:
            states[:, k] = track.at(model.base[k], ticks)
    return states


def _pivot_offsets(
    model: Model, take: AnimTake | None, ticks: IntArray
) -> list[FloatArray]:
    """Return rotation offset and pivot, scaling offset and pivot."""
    pivots = list(model.pivots)
    for k, name in enumerate(PIVOT_PROPERTIES):
        track = _property_track(model, take, name)
        if track is not None:
            pivots[k] = track.at(model.pivots[k], ticks)
    return pivots


def has_pivots(model: Model, take: AnimTake | None) -> bool:
    """Return whether a node has an offset or a pivot, saved or in a take."""
    if model.pivots.any():
        return True
    return any(
        _property_track(model, take, name) is not None for name in PIVOT_PROPERTIES
    )


def animated_components(model: Model, take: AnimTake | None) -> tuple[bool, bool, bool]:
    """Return whether translation, rotation and scale change in a take."""

    def varies(name: str, base: FloatArray) -> bool:
        track = _property_track(model, take, name)
        return track is not None and track.constant(base) is None

    changes = [
        varies(name, model.base[k]) for k, name in enumerate(_TRANSFORM_PROPERTIES)
    ]
    changes[0] |= any(
        varies(name, model.pivots[k]) for k, name in enumerate(PIVOT_PROPERTIES)
    )
    if model.active:
        changes[1] |= any(
            varies(name, model.outer_angles[k])
            for k, name in enumerate(OUTER_ROTATIONS)
        )
    return changes[0], changes[1], changes[2]
