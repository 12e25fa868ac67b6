"""Evaluates the local transforms of joints from FBX nodes.

A node is a joint. If it ignores a non-uniform scale of its parent, or applies it along
its own axes, one rotation and scale cannot represent its transform: an extra joint
above it has the translation and the inverse scale, and the joint itself the rotation
and scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum, auto

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.formats.characters.nodes import SCALE_TOLERANCE, is_uniform_scale
from animtool.formats.fbx.layers import SCALING
from animtool.formats.fbx.models import (
    COMPONENTWISE_SCALE,
    IGNORE_SCALE,
    INHERIT_SCALE,
    Model,
    find_animated_components,
    has_pivots,
)
from animtool.formats.fbx.scene import FbxScene
from animtool.formats.fbx.settings import TICKS_PER_SECOND
from animtool.formats.fbx.takes import AnimTake
from animtool.maths import so3

# Smallest scale to divide by; smaller ones are replaced by it.
MIN_SCALE = 1e-9
_REST_TICKS = np.zeros(1, np.int64)


class TransformPart(Enum):
    """The part of a node's transform that a joint has; a node may need two joints."""

    FULL = auto()
    OUTER = auto()  # translation, and the inverse scale of the parent
    INNER = auto()  # rotation and scale


@dataclass(frozen=True, slots=True)
class JointSource:
    """The node of a joint, and which part of its transform the joint has."""

    model: int  # index of the node
    part: TransformPart


class NodeTransforms:
    """Evaluates node transforms at given times of a take, each node once."""

    def __init__(self, scene: FbxScene, take: AnimTake | None, ticks: IntArray) -> None:
        """Evaluate at times ``(F,)`` [ticks]; the saved scene if there is no take."""
        self.models, self.take, self.ticks = scene.models, take, ticks
        self.basis = scene.settings.basis
        self._axes_rotation = so3.from_matrix(self.basis)
        self._parents_with_ignored_scale = {
            model.parent
            for model in self.models
            if model.scale_inheritance != INHERIT_SCALE
        }
        self._local_cache: dict[int, tuple[FloatArray, FloatArray, FloatArray]] = {}

    def local_transforms(self, i: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return local translations, rotations and scales of a node."""
        if i not in self._local_cache:
            translations, rotations, scales = self.models[i].local_transforms(
                self.take, self.ticks
            )
            # Children that ignore this scale divide by it.
            if i in self._parents_with_ignored_scale:
                scales = _replace_zeros(scales)
            self._local_cache[i] = translations, rotations, scales
        return self._local_cache[i]

    def local_scale(self, i: int) -> FloatArray:
        """Return a node's scale along its axes, including inherited scale ``(F, 3)``.

        Children may ignore this scale.
        """
        nodes = scale_chain(self.models, i)
        scales = [self.local_transforms(node)[2] for node in nodes]
        return np.asarray(np.prod(scales, axis=0))

    def world_matrices(self, i: int) -> FloatArray:
        """Return world transforms of a node in file axes ``(F, 4, 4)``."""
        world, ancestors = np.tile(np.eye(4), (len(self.ticks), 1, 1)), [i]
        while self.models[ancestors[-1]].parent >= 0:
            ancestors.append(self.models[ancestors[-1]].parent)
        for node in reversed(ancestors):
            model = self.models[node]
            translations, rotations, _ = self.local_transforms(node)
            local = np.tile(np.eye(4), (len(self.ticks), 1, 1))
            local[:, :3, :3] = so3.to_matrix(rotations)
            local[:, :3, :3] *= self.local_scale(node)[:, None, :]
            if model.parent >= 0 and model.scale_inheritance != INHERIT_SCALE:
                inverse_parent_scale = _inverse_scales(self.local_scale(model.parent))
                local[:, :3, :3] = inverse_parent_scale[:, :, None] * local[:, :3, :3]
            local[:, :3, 3] = translations
            world = world @ local
        return np.asarray(world)

    def joint_transforms(
        self, source: JointSource
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return translations, rotations and scales of a joint, in file units."""
        model = self.models[source.model]
        translations, rotations, scales = self.local_transforms(source.model)
        if model.parent < 0:
            if not np.array_equal(self.basis, np.eye(3)):
                translations = translations @ self.basis.T
                rotations = so3.multiply(self._axes_rotation, rotations)
            return translations, rotations, scales
        if source.part is TransformPart.FULL:
            if model.scale_inheritance == IGNORE_SCALE:
                scales = self.local_scale(source.model) * _inverse_scales(
                    self.local_scale(model.parent)
                )
            return translations, rotations, scales
        parent_scale = self.local_scale(model.parent)
        if source.part is TransformPart.OUTER:
            identities = np.zeros_like(rotations)
            identities[:, 3] = 1.0
            return translations, identities, _inverse_scales(parent_scale)
        return np.zeros_like(translations), rotations, self.local_scale(source.model)


def _inverse_scales(scales: FloatArray) -> FloatArray:
    return np.asarray(1.0 / _replace_zeros(scales))


def _replace_zeros(scales: FloatArray) -> FloatArray:
    signed_minimum = np.where(scales < 0, -MIN_SCALE, MIN_SCALE)
    return np.asarray(np.where(np.abs(scales) < MIN_SCALE, signed_minimum, scales))


class AnimatedComponents:
    """Finds which joint transforms a take animates."""

    def __init__(self, models: Sequence[Model], take: AnimTake | None) -> None:
        self.models, self.take = models, take
        self.components_by_node = [
            find_animated_components(model, take) for model in models
        ]

    def has_animated_scale(self, i: int) -> bool:
        """Return whether a node's scale, including inherited scale, is animated."""
        return any(
            self.components_by_node[node][2] for node in scale_chain(self.models, i)
        )

    def animated_components(self, source: JointSource) -> tuple[bool, bool, bool]:
        """Return whether translation, rotation and scale of a joint change."""
        model = self.models[source.model]
        has_translation, has_rotation, has_scale = self.components_by_node[source.model]
        if (has_rotation or has_scale) and has_pivots(model, self.take):
            has_translation = True
        has_parent = model.parent >= 0
        has_animated_parent_scale = has_parent and self.has_animated_scale(model.parent)
        if source.part is TransformPart.OUTER:
            return has_translation, False, has_animated_parent_scale
        if source.part is TransformPart.INNER:
            return False, has_rotation, self.has_animated_scale(source.model)
        has_relative_scale = model.scale_inheritance == IGNORE_SCALE and (
            has_animated_parent_scale or self.has_animated_scale(source.model)
        )
        return has_translation, has_rotation, has_scale or has_relative_scale


def list_joint_sources(scene: FbxScene, nodes: Sequence[int]) -> list[JointSource]:
    """Return the sources of the joints that represent nodes, in node order."""
    is_non_uniform: dict[int, bool] = {}
    sources = []
    for i in nodes:
        model = scene.models[i]
        parent = model.parent
        if parent >= 0 and model.scale_inheritance in {
            IGNORE_SCALE,
            COMPONENTWISE_SCALE,
        }:
            if parent not in is_non_uniform:
                is_non_uniform[parent] = _has_non_uniform_scale(scene, parent)
            if is_non_uniform[parent]:
                parts = TransformPart.OUTER, TransformPart.INNER
                sources += [JointSource(i, part) for part in parts]
                continue
        sources.append(JointSource(i, TransformPart.FULL))
    return sources


def _has_non_uniform_scale(scene: FbxScene, i: int) -> bool:
    """Return whether a node's scale is non-uniform at any time of any take."""
    nodes = scale_chain(scene.models, i)
    track_keys = [(scene.models[node].object.id, SCALING) for node in nodes]
    for take in (None, *scene.takes):
        ticks = _REST_TICKS
        if take is not None:
            tracks = [take.tracks[key] for key in track_keys if key in take.tracks]
            if not tracks:
                continue
            curves = [curve for track in tracks for curve in track.curves()]
            times = np.unique(np.concatenate([_REST_TICKS, *(c.times for c in curves)]))
            # Between equal keys, curves may differ by tangents; outside, by
            # extrapolation.
            ticks = np.unique(np.concatenate([times, (times[1:] + times[:-1]) // 2]))
            if any({curve.pre.mode, curve.post.mode} != {"C"} for curve in curves):
                duration = int(times[-1] - times[0]) or TICKS_PER_SECOND
                ticks = np.concatenate([ticks - duration, ticks, ticks + duration])
        local_scale = NodeTransforms(scene, take, ticks).local_scale(nodes[0])
        scale_range = local_scale.max(axis=1) - local_scale.min(axis=1)
        if (scale_range > SCALE_TOLERANCE * np.abs(local_scale).max(axis=1)).any():
            return True
    return False


def find_uniform_scales(
    scene: FbxScene, sources: Sequence[JointSource]
) -> tuple[FloatArray, BoolArray]:
    """Return saved scales ``(J, 3)``, and whether each is uniform and static."""
    rest_transforms = NodeTransforms(scene, None, _REST_TICKS)
    scales = np.array(
        [rest_transforms.joint_transforms(source)[2][0] for source in sources]
    ).reshape(-1, 3)
    is_uniform = is_uniform_scale(scales)
    for take in scene.takes:
        finder = AnimatedComponents(scene.models, take)
        start_time = np.array([take.start_ticks], np.int64)
        take_transforms = NodeTransforms(scene, take, start_time)
        for j, source in enumerate(sources):
            if not is_uniform[j] or not _has_scale_tracks(scene.models, source, take):
                continue
            start_scale = take_transforms.joint_transforms(source)[2][0]
            deviation = np.abs(start_scale - scales[j]).max()
            is_static = not finder.animated_components(source)[2]
            is_uniform[j] = is_static and deviation <= SCALE_TOLERANCE * scales[j].max()
    return scales, is_uniform


def _has_scale_tracks(
    models: Sequence[Model], source: JointSource, take: AnimTake
) -> bool:
    """Return whether a take animates a joint's scale."""
    nodes, model = scale_chain(models, source.model), models[source.model]
    if model.parent >= 0 and model.scale_inheritance != INHERIT_SCALE:
        nodes += scale_chain(models, model.parent)
    return any((models[i].object.id, SCALING) in take.tracks for i in nodes)


def scale_chain(models: Sequence[Model], i: int) -> list[int]:
    """Return a node and the ancestors whose scales multiply its own."""
    nodes = [i]
    while (i := models[i].scale_source) >= 0:
        nodes.append(i)
    return nodes
