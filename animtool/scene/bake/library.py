"""The takes of a clip library: names, and a check that one skeleton fits all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool.core.errors import Fault, FormatError, Severity
from animtool.core.quantities import length_text
from animtool.core.rates import rate_label
from animtool.maths import so3
from animtool.motion.take import TakeStream
from animtool.rig.skeleton import Rig
from animtool.scene.bake.options import BakeOptions
from animtool.scene.sources.open import source_stem
from animtool.usd.layers.names import distinct_names, joint_names, legal_name

# Rest poses that differ by less are equal, written with other digits.
REST_LENGTH_TOLERANCE = 1e-5
REST_ANGLE_TOLERANCE = 1e-5


def take_names(
    sources: Sequence[Path], notices: list[Fault], stated_names: Sequence[str] = ()
) -> list[str]:
    """Return legal and distinct take names, from stated names or file names.

    Names that had to be changed are added to the notices.
    """
    stems = list(stated_names) or [source_stem(path) for path in sources]
    names = distinct_names([path.name for path in sources], stems, stems)
    renamed_sources = [
        str(path)
        for path, stem, name in zip(sources, stems, names.names, strict=True)
        if name != legal_name(stem)
    ]
    for notice, path in zip(names.notices, renamed_sources, strict=True):
        notices.append(replace(notice, path=path))
    return names.names


def rate_notice(
    names: Sequence[str], streams: Sequence[TakeStream], fps: Fraction
) -> list[Fault]:
    """Return a warning if takes of a library have different rates."""
    rates = [stream.fps / stream.step for stream in streams]
    if len(set(rates)) < 2:
        return []
    labels = map(rate_label, rates)
    rate_text = ", ".join(
        f"{n} {label}" for n, label in zip(names, labels, strict=True)
    )
    message = f"the takes have different rates: {rate_text}"
    hint = f"all are written at {rate_label(fps)}"
    return [Fault("USD131", message, None, (), hint, Severity.NOTE)]


def in_joint_order(
    sources: Sequence[Path],
    streams: Sequence[TakeStream],
    options: BakeOptions,
    notices: list[Fault],
) -> list[TakeStream]:
    """Return the takes with joints in the order of the first take's joints."""
    parents_by_take = [_parents_by_name(stream.rig, options) for stream in streams]
    first_joints, *other_joints = parents_by_take
    faults = [
        Fault("USD030", difference, str(path), (), "a library has one skeleton")
        for path, joints in zip(sources[1:], other_joints, strict=True)
        if (difference := _joint_difference(first_joints, joints, str(sources[0])))
    ]
    if faults:
        raise FormatError(faults)
    reordered_streams = [streams[0]]
    reordered_streams += [
        _reorder_joints(stream, list(joints), list(first_joints), streams[0].rig)
        for stream, joints in zip(streams[1:], other_joints, strict=True)
    ]
    if options.rest_frame is None:
        rig, source = streams[0].rig, str(sources[0])
        for path, stream in zip(sources[1:], reordered_streams[1:], strict=True):
            notices += _rest_notice(rig, stream.rig, str(path), source)
    return reordered_streams


def _parents_by_name(rig: Rig, options: BakeOptions) -> dict[str, str]:
    """Return the parent of every joint by USD name, in joint order.

    USD names are used so that a BVH file and its conversion to USD have equal joints.
    The parent of a root is "".
    """
    names = joint_names(rig.joints, options.strip_namespace).names
    return {
        name: names[joint.parent] if joint.parent >= 0 else ""
        for name, joint in zip(names, rig.joints, strict=True)
    }


def _joint_difference(
    first_parents: dict[str, str], other_parents: dict[str, str], source: str
) -> str:
    """Return the first difference between two joint hierarchies as text, or ""."""
    for name, parent in first_parents.items():
        if name not in other_parents:
            return f"there is no joint {name!r}, which {source} has"
        if other_parents[name] != parent:
            other_parent, first_parent = (
                f"below {parent_name!r}" if parent_name else "a root"
                for parent_name in (other_parents[name], parent)
            )
            return f"joint {name!r} is {other_parent}, but in {source} {first_parent}"
    for name in other_parents:
        if name not in first_parents:
            return f"joint {name!r} is not in {source}"
    return ""


def _reorder_joints(
    stream: TakeStream, names: list[str], joint_order: list[str], first_rig: Rig
) -> TakeStream:
    """Return a take with its joints in the order of another take's rig."""
    if names == joint_order:
        return stream
    from animtool.usd.rigs.joint_map import RigJointMap

    rig = stream.rig
    source_indices = np.array([names.index(name) for name in joint_order], np.int64)
    joints = tuple(
        replace(rig.joints[i], parent=joint.parent)
        for i, joint in zip(source_indices.tolist(), first_rig.joints, strict=True)
    )
    reordered_rig = replace(rig, joints=joints)
    rest_scales = np.ones((len(joints), 3))
    joint_map = RigJointMap(reordered_rig, source_indices, rest_scales, [])
    curve, blocks = stream.curve, map(joint_map.map_motion, stream.blocks)
    reordered_stream = replace(stream, rig=reordered_rig, blocks=blocks)
    if curve is not None:
        reordered_stream.curve = lambda times: joint_map.map_motion(curve(times))
    return reordered_stream


def _rest_notice(first_rig: Rig, other_rig: Rig, path: str, source: str) -> list[Fault]:
    """Return a warning if a take's rest pose differs from the rest pose written."""
    distances = np.linalg.norm(
        first_rig.rest_translations - other_rig.rest_translations, axis=1
    )
    rig_size = float(np.abs(first_rig.rest_translations).max(initial=0.0)) or 1.0
    angles = so3.angle_between(first_rig.rest_rotations, other_rig.rest_rotations)
    relative_errors = np.maximum(
        distances / (REST_LENGTH_TOLERANCE * rig_size), angles / REST_ANGLE_TOLERANCE
    )
    if relative_errors.max(initial=0.0) <= 1.0:
        return []
    i = int(relative_errors.argmax())
    message = (
        f"the rest pose differs from that of {source}: joint {first_rig.names[i]!r} by "
        f"{length_text(distances[i])} and {np.degrees(angles[i]):.3g} degrees"
    )
    hint = f"the library uses the rest pose of {source}"
    return [Fault("USD130", message, path, (), hint, Severity.WARNING)]
