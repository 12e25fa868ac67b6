"""FBX nodes (models) and the evaluation of their transforms.

``local = T · Roff · Rp · Rpre · R · Rpost⁻¹ · Rp⁻¹ · Soff · Sp · S · Sp⁻¹``; the
linear part is a rotation times a scale. A child may leave out its parent's own scale
(Rrs) or take it along its own axes (RrSs).

References: Autodesk, *FBX SDK documentation*, "Computing transformation matrices".
"""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.formats.fbx.angles import XYZ, rotations_of
from animtool.formats.fbx.layers import (
    OUTER_ROTATIONS,
    PIVOTS,
    ROTATION,
    SCALING,
    TRANSLATION,
    PropertyTrack,
)
from animtool.formats.fbx.objects import ROOTS, FbxFile, Id, Object, scalar, vector
from animtool.formats.fbx.takes import AnimTake
from animtool.maths import so3

# By RotationOrder: X turns first in XYZ, so its factor is the last.
_ORDERS = ("ZYX", "YZX", "XZY", "ZXY", "YXZ", "XYZ")
COMPONENTWISE, INHERIT, IGNORE = range(3)
MAX_MODELS = 100_000
_ZERO = (0.0, 0.0, 0.0)
_PROPERTIES = (TRANSLATION, ROTATION, SCALING)


@dataclass(slots=True, eq=False)
class Model:
    """A node.

    Attributes:
        object: What it is of.
        parent: Index of the node above; -1 for a root.
        base: Translation, rotation [deg] and scale without animation ``(3, 3)``.
        order: Of its angles, as `euler.to_quaternion` has it.
        pre: Rotation before ``(4,)``.
        post: Inverse of the rotation after ``(4,)``.
        pivots: Offset and pivot of rotations, then of scales ``(4, 3)``.
        inherit: How it takes the scale of its parent.
        geometric: What its own mesh is transformed by ``(4, 4)``.
        active: Whether order and the rotations before and after count.
        outer_angles: Angles of these two ``(2, 3)`` [deg].
        scale_from: Node whose scale, and what that has of others, it takes along its
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
        values = _state(self, take, ticks)
        pre, post = self.pre, self.post
        if take is not None and self.active:
            first, last = (_track(self, take, name) for name in OUTER_ROTATIONS)
            if first is not None:
                pre = rotations_of(first.at(self.outer_angles[0], ticks), XYZ)
            if last is not None:
                post = so3.conjugate(
                    rotations_of(last.at(self.outer_angles[1], ticks), XYZ)
                )
        rotations = rotations_of(values[:, 1], self.order)
        rotations = so3.multiply(so3.multiply(pre, rotations), post)
        scales = values[:, 2]
        offset, pivot, stretch, centre = _pivots(self, take, ticks)
        inner = stretch + centre - pivot - scales * centre
        moved = values[:, 0] + offset + pivot
        if inner.any():
            moved = moved + so3.rotate(rotations, inner)
        return moved, rotations, scales


def read_models(file: FbxFile) -> list[Model]:
    """Return the nodes, parents first.

    Raises:
        FormatError: A node is below itself (FBX009), has a rotation order that is not
            read (FBX004), or there are too many (FBX013).
    """
    objects = [
        one for one in file.of_kind("Model") if not _is_default_camera(file, one)
    ]
    objects = [one for one in objects if one.id not in ROOTS]
    if len(objects) > MAX_MODELS:
        message = f"{len(objects)} nodes; the limit is {MAX_MODELS}"
        file.notes.fail("FBX013", file.root.where, message)
    parents = {one.id: _parent(file, one) for one in objects}
    below: dict[Id | None, list[Object]] = {}
    for one in objects:
        below.setdefault(parents[one.id], []).append(one)
    models: list[Model] = []
    stack = [(one, -1) for one in reversed(below.get(None, []))]
    while stack:
        one, parent = stack.pop()
        node, index = _model(file, one, parent), len(models)
        if parent >= 0 and node.inherit == COMPONENTWISE:
            node.scale_from = parent
        elif parent >= 0 and node.inherit == IGNORE:
            node.scale_from = models[parent].scale_from
        models.append(node)
        stack += [(child, index) for child in reversed(below.get(one.id, []))]
    if len(models) < len(objects):
        done = {model.object.id for model in models}
        lost = next(one for one in objects if one.id not in done)
        message = f"the node {lost.name!r} is its own ancestor"
        file.notes.fail("FBX009", lost.element.where, message)
    return models


def _is_default_camera(file: FbxFile, one: Object) -> bool:
    """Return whether a node is a default camera that old exporters add."""
    return one.subtype.startswith("Camera") and one.id not in file.above


def _parent(file: FbxFile, one: Object) -> Id | None:
    above = [model.id for model in file.targets(one.id, "Model")]
    above = [id_ for id_ in above if id_ not in ROOTS]
    if len(set(above)) > 1:
        message = f"the node {one.name!r} has {len(set(above))} parents"
        file.notes.fail("FBX009", one.element.where, message)
    return above[0] if above else None


def _model(file: FbxFile, one: Object, parent: int) -> Model:
    notes = file.notes

    def triple(name: str, default: tuple[float, ...] = _ZERO) -> FloatArray:
        return np.array(vector(one, name, default, notes))

    base = np.stack(
        [triple(TRANSLATION), triple(ROTATION), triple(SCALING, (1.0,) * 3)]
    )
    active = bool(scalar(one, "RotationActive", 0, notes))
    order, pre, post = 0, _ZERO, _ZERO
    if active:
        order = int(scalar(one, "RotationOrder", 0, notes))
        pre, post = (tuple(triple(f"{name}Rotation")) for name in ("Pre", "Post"))
    if not 0 <= order < len(_ORDERS):
        message = (
            f"the node {one.name!r} has rotation order {order}, which is not supported"
        )
        hint = "spherical XYZ is specific to MotionBuilder; export with an Euler order"
        notes.fail("FBX004", one.element.where, message, hint)
    angles = np.array([pre, post])
    outer = rotations_of(angles, XYZ)
    inherit = int(scalar(one, "InheritType", INHERIT, notes))
    if inherit not in {COMPONENTWISE, INHERIT, IGNORE}:
        message = (
            f"the node {one.name!r} has inherit type {inherit}, which is not supported"
        )
        notes.fail("FBX004", one.element.where, message)
    geometric = np.eye(4)
    rotation = rotations_of(triple("GeometricRotation")[None], XYZ)[0]
    geometric[:3, :3] = so3.to_matrix(rotation) * triple("GeometricScaling", (1.0,) * 3)
    geometric[:3, 3] = triple("GeometricTranslation")
    return Model(
        one,
        parent,
        base,
        _ORDERS[order],
        outer[0],
        so3.conjugate(outer[1]),
        np.stack([triple(name) for name in PIVOTS]),
        inherit,
        geometric,
        active,
        angles,
    )


def _track(model: Model, take: AnimTake | None, name: str) -> PropertyTrack | None:
    return None if take is None else take.tracks.get((model.object.id, name))


def _state(model: Model, take: AnimTake | None, ticks: IntArray) -> FloatArray:
    """Return translation, rotation [deg] and scale at times ``(F, 3, 3)``."""
    states = np.repeat(model.base[None], len(ticks), axis=0)
    for k, name in enumerate(_PROPERTIES):
        track = _track(model, take, name)
        if track is not None:
            states[:, k] = track.at(model.base[k], ticks)
    return states


def _pivots(model: Model, take: AnimTake | None, ticks: IntArray) -> list[FloatArray]:
    """Return rotation offset and pivot, scaling offset and pivot."""
    pivots = list(model.pivots)
    for k, name in enumerate(PIVOTS):
        track = _track(model, take, name)
        if track is not None:
            pivots[k] = track.at(model.pivots[k], ticks)
    return pivots


def has_pivots(model: Model, take: AnimTake | None) -> bool:
    """Return whether a node has an offset or a pivot, saved or in a take."""
    if model.pivots.any():
        return True
    return any(_track(model, take, name) is not None for name in PIVOTS)


def moving(model: Model, take: AnimTake | None) -> tuple[bool, bool, bool]:
    """Return whether translation, rotation and scale change in a take."""

    def moves(name: str, base: FloatArray) -> bool:
        track = _track(model, take, name)
        return track is not None and track.constant(base) is None

    changes = [moves(name, model.base[k]) for k, name in enumerate(_PROPERTIES)]
    changes[0] |= any(moves(name, model.pivots[k]) for k, name in enumerate(PIVOTS))
    if model.active:
        changes[1] |= any(
            moves(name, model.outer_angles[k]) for k, name in enumerate(OUTER_ROTATIONS)
        )
    return changes[0], changes[1], changes[2]
