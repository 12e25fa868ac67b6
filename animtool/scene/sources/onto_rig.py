"""Mapping of a motion to another rig by names of joints, shapes and controls."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, OptionError, Severity, listed, names_fault
from animtool.core.readers import USD, find_reader
from animtool.core.record import dataclass
from animtool.motion.driving import combine_missing_weights
from animtool.motion.motion import Channel, Motion
from animtool.motion.reorient import reorient
from animtool.motion.take import TakeStream
from animtool.rig.controls import Control
from animtool.rig.fit import check_fit
from animtool.rig.parts import Shape
from animtool.rig.placed import at_origin
from animtool.rig.skeleton import Rig


def open_rig(path: Path, prim_path: str | None = None) -> tuple[Rig, list[Fault]]:
    """Return the rig of a file of any format, with warnings of its reader."""
    if path.is_file() and find_reader(path) is USD:
        from animtool.usd.rigs.stored import read_rig_with_data

        return read_rig_with_data(path, prim_path)
    if prim_path is None:
        rig = Rig.load(path)
    elif path.is_file() and "prim_path" in find_reader(path).options:
        opener: Callable[..., Rig] = find_reader(path).rig_opener(path)
        rig = opener(path, prim_path)
    else:
        message = argument("source.prim_path")
        message += " is for USD, glTF and FBX files, but this is none"
        raise OptionError(Fault("CLI004", message, str(path)))
    return rig, list(rig.notices)


MAX_LISTED_NAMES = 6
MOTION_IGNORED = "their motion is ignored"
STAY_AT_REST = "they stay at rest"


class Notify(Protocol):
    """Creates faults of a source, located where it is named."""

    def __call__(
        self,
        code: str,
        message: str,
        hint: str | None = None,
        severity: Severity = Severity.ERROR,
    ) -> Fault:
        """Return the fault."""


@dataclass(frozen=True, slots=True)
class NameMap:
    """Index of each joint, shape and control of a rig in another rig; -1 if absent."""

    rig: Rig
    # Index in the other rig of each joint of this one; -1 if it lacks it ``(J,)``.
    joints: IntArray
    shapes: IntArray
    controls: IntArray
    unmatched_joints: tuple[int, ...]  # joints of the other rig that this one lacks

    def apply(self, motion: Motion) -> Motion:
        """Return the other rig's motion on this rig, with unmapped tracks at rest."""
        rig, unit_scales = self.rig, np.ones((len(self.rig.joints), 3))
        zero_weights = np.zeros((len(rig.shapes), 1))
        defaults = np.array([[control.default] for control in rig.controls])
        return Motion(
            motion.translations.reorder(self.joints, rig.rest_translations),
            motion.rotations.reorder(self.joints, rig.rest_rotations),
            _gather_or_rest(motion.scales, self.joints, unit_scales),
            self._with_combined_weights(
                _gather_or_rest(motion.weights, self.shapes, zero_weights)
            ),
            _gather_or_rest(motion.controls, self.controls, defaults),
        )

    def _with_combined_weights(self, weights: Channel | None) -> Channel | None:
        """Return weights with those of unmapped combination shapes computed."""
        if weights is None:
            return None
        missing_indices = np.flatnonzero(self.shapes < 0)
        return combine_missing_weights(weights, self.rig.shapes, missing_indices)


def map_names(rig: Rig, other_rig: Rig) -> NameMap:
    """Return the index of each track of a rig in another rig, matched by name.

    A joint that was renamed on reading is found by either name. If several joints have
    the same name, the joint below the mapped parent is used.
    """
    indices_by_name: dict[str, list[int]] = {}
    for index, joint in enumerate(other_rig.joints):
        for name in dict.fromkeys((joint.source_name or joint.name, joint.name)):
            indices_by_name.setdefault(name, []).append(index)
    joints: list[int] = []
    for joint in rig.joints:
        candidates = [
            *indices_by_name.get(joint.name, ()),
            *indices_by_name.get(joint.source_name, ()),
        ]
        parent = joints[joint.parent] if joint.parent >= 0 else -1
        children_of_mapped_parent = [
            index for index in candidates if other_rig.joints[index].parent == parent
        ]
        joints.append(next(iter(children_of_mapped_parent or candidates), -1))
    return NameMap(
        rig,
        np.array(joints, np.int64),
        _indices_by_name(rig.shapes, other_rig.shapes),
        _indices_by_name(rig.controls, other_rig.controls),
        tuple(sorted(set(range(len(other_rig.joints))) - set(joints))),
    )


def map_to_rig(
    stream: TakeStream, rig: Rig, note: Notify
) -> tuple[TakeStream, NameMap]:
    """Return a source mapped to a rig by name, and the name map.

    Tracks that the rig lacks are dropped; tracks that only the rig has stay at rest.
    """
    stream = reorient(stream, rig.up)
    name_map = map_names(rig, stream.rig)
    indices = np.concatenate([name_map.joints, name_map.shapes, name_map.controls])
    if (indices < 0).all():
        message = f"has no joint, shape or control of {rig.name!r}"
        hint = f"its joints are {listed(stream.rig.names, MAX_LISTED_NAMES)}; "
        hint += "animtool retarget moves a take to another rig"
        raise OptionError(note("SCN036", message, hint))
    source_blocks, curve = stream.blocks, stream.curve
    control_names = {control.name for control in rig.controls}
    mapped_stream = replace(
        stream,
        rig=rig,
        blocks=(name_map.apply(block) for block in source_blocks),
        unread_meshes=None,
        control_curves={
            name: curves
            for name, curves in stream.control_curves.items()
            if name in control_names
        },
    )
    if curve is not None:
        mapped_stream.curve = lambda times: name_map.apply(curve(times))
    return mapped_stream, name_map


def unmapped_notices(name_map: NameMap, other_rig: Rig, path: str) -> list[Fault]:
    """Return notices about tracks that only one of two rigs has."""
    shapes = set(name_map.shapes.tolist())
    joints = [other_rig.names[index] for index in name_map.unmatched_joints]
    other_shapes = enumerate(other_rig.shapes)
    extra_shapes = [shape.name for i, shape in other_shapes if i not in shapes]
    missing_indices = np.flatnonzero(name_map.joints < 0).tolist()
    missing_joints = [name_map.rig.names[index] for index in missing_indices]
    warning, note = Severity.WARNING, Severity.NOTE
    groups = (
        ("RIG042", joints, "joints are not in the rig", MOTION_IGNORED, warning),
        ("RIG042", extra_shapes, "shapes are not in the rig", MOTION_IGNORED, warning),
        ("RIG043", missing_joints, "joints only the rig has", STAY_AT_REST, note),
    )
    return [
        names_fault(code, f"{len(group)} {description}: ", group, path, hint, severity)
        for code, group, description, hint, severity in groups
        if group
    ]


def map_to_rig_file(
    path: Path, stream: TakeStream, rig_path: Path, *, force_fit: bool
) -> TakeStream:
    """Return a source mapped to a rig of another file."""

    def note(
        code: str,
        message: str,
        hint: str | None = None,
        severity: Severity = Severity.ERROR,
    ) -> Fault:
        return Fault(code, message, str(path), (), hint, severity)

    rig, notices = open_rig(rig_path)
    # Placement of the take, not of the rig's stage.
    rig = at_origin(rig)
    reoriented_stream = reorient(stream, rig.up)
    mapped_stream, name_map = map_to_rig(reoriented_stream, rig, note)
    unmatched_notices = unmapped_notices(name_map, reoriented_stream.rig, str(path))
    differences: list[Fault] = []
    # A file fits itself, however its stage places the character.
    is_other_file = not (path.exists() and path.samefile(rig_path))
    if is_other_file and reoriented_stream.rig.joints and rig.joints:
        _, differences = check_fit(
            reoriented_stream.rig,
            rig,
            name_map.joints,
            str(rig_path),
            is_forced=force_fit,
            unmatched_faults=unmatched_notices,
        )
    mapped_stream.notices += [*notices, *unmatched_notices, *differences]
    mapped_stream.details["rig"] = str(rig_path)
    return mapped_stream


def _indices_by_name(
    elements: Sequence[Shape | Control], other_elements: Sequence[Shape | Control]
) -> IntArray:
    """Return the index of the other element with each element's name; -1 for none."""
    index_by_name = {element.name: i for i, element in enumerate(other_elements)}
    return np.array(
        [index_by_name.get(element.name, -1) for element in elements], np.int64
    )


def _gather_or_rest(
    channel: Channel | None, indices: IntArray, rest_values: FloatArray
) -> Channel | None:
    if channel is None or not len(indices):
        return None
    return channel.reorder(indices, rest_values)
