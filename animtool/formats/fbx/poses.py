"""Local transforms of joints, evaluated from FBX nodes.

A node is a joint. Where it leaves out an uneven scale of its parent, or takes it along
its own axes, no rotation and scale hold its transform: a joint above it carries the
translation and the inverse scale, and the joint itself turns and scales.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum, auto

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.formats.characters.nodes import SAME_SCALE
from animtool.formats.fbx.layers import SCALING
from animtool.formats.fbx.models import (
    COMPONENTWISE,
    IGNORE,
    INHERIT,
    Model,
    has_pivots,
    moving,
)
from animtool.formats.fbx.scene import FbxScene
from animtool.formats.fbx.settings import TICKS
from animtool.formats.fbx.takes import AnimTake
from animtool.maths import so3

# A scale that is nearer to 0 is taken as this where it is divided by.
MIN_SCALE = 1e-9
_REST = np.zeros(1, np.int64)


class RowKind(Enum):
    """Which part of a node's transform a joint takes."""

    FULL = auto()
    OUTER = auto()  # translation, and the inverse scale of the parent
    INNER = auto()  # rotation and scale


@dataclass(frozen=True, slots=True)
class Row:
    """A joint: a node and the part of its transform."""

    model: int
    kind: RowKind


class NodeTransforms:
    """Node transforms at given times of a take, each evaluated once."""

    def __init__(self, scene: FbxScene, take: AnimTake | None, ticks: IntArray) -> None:
        """Evaluate at times ``(F,)`` [ticks]; None is the saved scene."""
        self.models, self.take, self.ticks = scene.models, take, ticks
        self.basis = scene.settings.basis
        self._axes_rotation = so3.from_matrix(self.basis)
        self._left = {one.parent for one in self.models if one.inherit != INHERIT}
        self._locals: dict[int, tuple[FloatArray, FloatArray, FloatArray]] = {}

    def local(self, i: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return local translations, rotations and scales of a node."""
        if i not in self._locals:
            moved, turned, scales = self.models[i].local(self.take, self.ticks)
            # What a child leaves out is divided by.
            scales = _no_zeros(scales) if i in self._left else scales
            self._locals[i] = moved, turned, scales
        return self._locals[i]

    def local_scale(self, i: int) -> FloatArray:
        """Return a node's scale along its local axes, inheritance included.

        It is what its children may leave out ``(F, 3)``.
        """
        scale = self.local(i)[2]
        while (i := self.models[i].scale_from) >= 0:
            scale = scale * self.local(i)[2]
        return scale

    def world(self, i: int) -> FloatArray:
        """Return world transforms of a node in file axes ``(F, 4, 4)``."""
        world, chain = np.tile(np.eye(4), (len(self.ticks), 1, 1)), [i]
        while self.models[chain[-1]].parent >= 0:
            chain.append(self.models[chain[-1]].parent)
        for node in reversed(chain):
            model = self.models[node]
            moved, turned, _ = self.local(node)
            scaled, leaves = self.local_scale(node), model.inherit != INHERIT
            local = np.tile(np.eye(4), (len(self.ticks), 1, 1))
            local[:, :3, :3] = so3.to_matrix(turned) * scaled[:, None, :]
            if leaves and model.parent >= 0:
                above = _inverse(self.local_scale(model.parent))
                local[:, :3, :3] = above[:, :, None] * local[:, :3, :3]
            local[:, :3, 3] = moved
            world = world @ local
        return np.asarray(world)

    def row(self, row: Row) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return translations, rotations and scales of a joint, in the file's unit."""
        model = self.models[row.model]
        translations, rotations, scales = self.local(row.model)
        if model.parent < 0:
            if not np.array_equal(self.basis, np.eye(3)):
                translations = translations @ self.basis.T
                rotations = so3.multiply(self._axes_rotation, rotations)
            return translations, rotations, scales
        if row.kind is RowKind.FULL:
            if model.inherit == IGNORE:
                scales = self.local_scale(row.model) * _inverse(
                    self.local_scale(model.parent)
                )
            return translations, rotations, scales
        above = self.local_scale(model.parent)
        if row.kind is RowKind.OUTER:
            identities = np.zeros_like(rotations)
            identities[:, 3] = 1.0
            return translations, identities, _inverse(above)
        return np.zeros_like(translations), rotations, self.local_scale(row.model)


def _inverse(scales: FloatArray) -> FloatArray:
    return np.asarray(1.0 / _no_zeros(scales))


def _no_zeros(scales: FloatArray) -> FloatArray:
    least = np.where(scales < 0, -MIN_SCALE, MIN_SCALE)
    return np.asarray(np.where(np.abs(scales) < MIN_SCALE, least, scales))


class Changes:
    """Which joint transforms a take changes."""

    def __init__(self, models: Sequence[Model], take: AnimTake | None) -> None:
        """Take the nodes of a file and a take of it."""
        self.models, self.take = models, take
        self.moving = [moving(model, take) for model in models]

    def local_scale(self, i: int) -> bool:
        """Return whether a node's local scale is animated; children may ignore it."""
        return any(self.moving[one][2] for one in scale_chain(self.models, i))

    def row(self, row: Row) -> tuple[bool, bool, bool]:
        """Return whether translation, rotation and scale of a joint change."""
        model = self.models[row.model]
        moves, rotates, scales = self.moving[row.model]
        if (rotates or scales) and has_pivots(model, self.take):
            moves = True
        above = model.parent >= 0 and self.local_scale(model.parent)
        if row.kind is RowKind.OUTER:
            return moves, False, above
        if row.kind is RowKind.INNER:
            return False, rotates, self.local_scale(row.model)
        leaves = model.inherit == IGNORE and (above or self.local_scale(row.model))
        return moves, rotates, scales or leaves


def rows_of(scene: FbxScene, kept: Sequence[int]) -> list[Row]:
    """Return the joints of nodes, in node order."""
    uneven: dict[int, bool] = {}
    rows = []
    for i in kept:
        model = scene.models[i]
        parent = model.parent
        if parent >= 0 and model.inherit in {IGNORE, COMPONENTWISE}:
            if parent not in uneven:
                uneven[parent] = _is_uneven(scene, parent)
            if uneven[parent]:
                rows += [Row(i, RowKind.OUTER), Row(i, RowKind.INNER)]
                continue
        rows.append(Row(i, RowKind.FULL))
    return rows


def _is_uneven(scene: FbxScene, i: int) -> bool:
    """Return whether a node's scale ever differs between axes."""
    chain = scale_chain(scene.models, i)
    keys = [(scene.models[one].object.id, SCALING) for one in chain]
    for take in (None, *scene.takes):
        ticks = _REST
        if take is not None:
            tracks = [take.tracks[key] for key in keys if key in take.tracks]
            if not tracks:
                continue
            curves = [c for t in tracks for v in t.layers for c in v.curves if c]
            times = np.unique(np.concatenate([_REST, *(c.times for c in curves)]))
            # Between keys curves of the same keys may differ by their tangents, and
            # before and after them by how they go on.
            ticks = np.unique(np.concatenate([times, (times[1:] + times[:-1]) // 2]))
            if any({c.pre.mode, c.post.mode} != {"C"} for c in curves):
                span = int(times[-1] - times[0]) or TICKS
                ticks = np.concatenate([ticks - span, ticks, ticks + span])
        local_scale = NodeTransforms(scene, take, ticks).local_scale(chain[0])
        spread = local_scale.max(axis=1) - local_scale.min(axis=1)
        if (spread > SAME_SCALE * np.abs(local_scale).max(axis=1)).any():
            return True
    return False


def even_rows(scene: FbxScene, rows: Sequence[Row]) -> tuple[FloatArray, BoolArray]:
    """Return saved scales ``(J, 3)``, and which are uniform and static."""
    rest = NodeTransforms(scene, None, _REST)
    scales = np.array([rest.row(row)[2][0] for row in rows]).reshape(-1, 3)
    low, high = scales.min(axis=1), scales.max(axis=1)
    even = (low > 0) & (high - low <= SAME_SCALE * np.abs(high))
    for take in scene.takes:
        changes = Changes(scene.models, take)
        of_take = NodeTransforms(scene, take, np.array([take.begin], np.int64))
        for j, row in enumerate(rows):
            if not even[j] or not _is_touched(scene.models, row, take):
                continue
            off = np.abs(of_take.row(row)[2][0] - scales[j]).max()
            even[j] = not changes.row(row)[2] and off <= SAME_SCALE * high[j]
    return scales, np.asarray(even)


def _is_touched(models: Sequence[Model], row: Row, take: AnimTake) -> bool:
    """Return whether a take animates a joint's scale."""
    chain, model = scale_chain(models, row.model), models[row.model]
    if model.parent >= 0 and model.inherit != INHERIT:
        chain += scale_chain(models, model.parent)
    return any((models[i].object.id, SCALING) in take.tracks for i in chain)


def scale_chain(models: Sequence[Model], i: int) -> list[int]:
    """Return a node and the ancestors whose scale it inherits."""
    chain = [i]
    while (i := models[i].scale_from) >= 0:
        chain.append(i)
    return chain
