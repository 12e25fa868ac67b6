"""Compares two takes: joints, shapes, controls, and where the takes differ most."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock, frame_label, span_label
from animtool.core.errors import Fault, counted, listed
from animtool.core.record import dataclass
from animtool.core.units import UpAxis, unit_name
from animtool.edit.resample import resampled
from animtool.maths import so3
from animtool.motion.reorient import reorient
from animtool.motion.take import Take, TakeStream
from animtool.report.tolerances import (
    WEIGHT_TOLERANCE,
    angle_warnings,
    length_warnings,
    weight_warnings,
)
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.shapes import arkit_name
from animtool.rig.skeleton import Rig
from animtool.scene.sources.open import (
    SourceOptions,
    fitting_options,
    is_usd,
    open_characters,
    open_source,
)


@dataclass(frozen=True, slots=True)
class ShapeDifference:
    """Largest difference between shape weights, and where it occurs."""

    value: float = 0.0  # difference [1]
    shape: str = ""  # name of the shape in the first take
    code: float = 0.0  # time code in the first take
    skeleton: str = ""  # path of the skeleton if the first file has several


def compare_weights(
    first: Take, second: Take, frame_count: int
) -> tuple[ShapeDifference, int, list[str]]:
    """Compare the shape weights of two takes of equal rate; match shapes by name.

    Different spellings of an ARKit shape are the same shape. A shape that only one take
    has is a mismatch if its weight is ever nonzero.

    Returns the largest difference, the number of shapes compared, and the mismatches.
    """
    first_weights, second_weights = (_dense_weights(take) for take in (first, second))
    shape_names = [
        [shape.name for shape in take.rig.shapes] for take in (first, second)
    ]
    pairs = _shape_pairs(*shape_names)
    unmatched_names = []
    for side, weights in enumerate((first_weights, second_weights)):
        matched_shapes = {pair[side] for pair in pairs}
        moving_shapes = np.flatnonzero(weights.any(axis=0)).tolist()
        unmatched_shapes = [
            shape_names[side][s] for s in moving_shapes if s not in matched_shapes
        ]
        unmatched_names.append(unmatched_shapes)
    mismatches = unmatched_texts("shape", *unmatched_names)
    first_columns, second_columns = [s for s, _ in pairs], [s for _, s in pairs]
    difference = np.abs(
        first_weights[:frame_count, first_columns]
        - second_weights[:frame_count, second_columns]
    )
    if not difference.size:
        return ShapeDifference(), 0, mismatches
    frame, pair_index = np.unravel_index(np.argmax(difference), difference.shape)
    largest_difference = ShapeDifference(
        float(difference[frame, pair_index]),
        shape_names[0][first_columns[int(pair_index)]],
        float(first.clock.times[frame]),
    )
    return largest_difference, len(pairs), mismatches


def unmatched_texts(
    noun: str, only_first: Sequence[str], only_second: Sequence[str]
) -> list[str]:
    """Return texts that list the names found in only one of two files or takes."""
    messages = []
    for names, other_label in ((only_first, "second"), (only_second, "first")):
        if names:
            verb = "is" if len(names) == 1 else "are"
            count = counted(len(names), noun)
            messages.append(f"{count} {verb} not in the {other_label}: {listed(names)}")
    return messages


def _dense_weights(take: Take) -> FloatArray:
    """Return the weight of every shape ``(F, S)``; 0 for shapes without weights."""
    if take.motion.weights is None:
        return np.zeros((take.clock.count, len(take.rig.shapes)))
    return take.motion.weights.dense()[..., 0]


def _shape_pairs(first: Sequence[str], second: Sequence[str]) -> list[tuple[int, int]]:
    """Match shapes by name, then by ARKit name; return index pairs, ascending."""
    pairs = [(i, second.index(name)) for i, name in enumerate(first) if name in second]
    used_first, used_second = dict(pairs), {second_index for _, second_index in pairs}
    by_arkit_name = {
        arkit: second_index
        for second_index, name in enumerate(second)
        if second_index not in used_second and (arkit := arkit_name(name)) is not None
    }
    for i, name in enumerate(first):
        if i not in used_first:
            match = by_arkit_name.pop(arkit_name(name) or "", None)
            if match is not None:
                pairs.append((i, match))
    return sorted(pairs)


# USD stores scales as 16-bit floats, whose spacing near 1 is 5e-4.
SCALE_TOLERANCE = 1e-3
# A take is part of a longer one if its joints are within this fraction of its size, and
# of the difference of the first frames [1].
FIT_FRACTION = 0.01
# Fewer frames may fit by chance. At most so many frames of the longer take are tried.
MIN_FITTED_FRAMES, MAX_TRIED_OFFSETS = 3, 8


@dataclass(frozen=True, slots=True)
class Difference:
    """Largest difference of one quantity between joints, and where it occurs."""

    value: float = 0.0  # difference [m] or [deg]
    joint: str = ""  # name of the joint
    code: float = 0.0  # time code in the first take
    skeleton: str = ""  # path of the skeleton if the first file has several


@dataclass(frozen=True, slots=True)
class TakeDifference:
    """Differences of two takes over their common joints, shapes and frames."""

    world: Difference = Difference()  # world position [m]
    translation: Difference = Difference()  # local translation [m]
    rotation: Difference = Difference()  # local rotation [deg]
    scale: Difference = Difference()  # local scale [1]
    weight: ShapeDifference = ShapeDifference()  # weight of a blend shape [1]
    frames: int = 0  # frames compared
    joints: int = 0  # joints compared
    shapes: int = 0  # shapes compared
    # Joints and shapes that only one take has, as text.
    mismatches: list[str] = field(default_factory=list)
    # Differences that do not affect the takes, as text.
    notes: list[str] = field(default_factory=list)
    notices: list[Fault] = field(default_factory=list)  # warnings and notes
    # Skeletons compared, whose joints and shapes are counted together.
    skeletons: int = 1
    size: float = 0.0  # largest extent of the joints in a frame [m]

    def tolerance_warnings(
        self, meters: float, degrees: float, weights: float
    ) -> list[Fault]:
        """Return warnings about tolerances that hide every difference (CLI107)."""
        largest = max(self.world.value, self.translation.value)
        return [
            *length_warnings(meters, largest, self.size),
            *angle_warnings(degrees, self.rotation.value),
            *weight_warnings(weights, self.weight.value),
        ]

    def within(
        self, meters: float, degrees: float, weights: float = WEIGHT_TOLERANCE
    ) -> bool:
        """Return whether nothing is missing, and no difference exceeds a tolerance."""
        return (
            not self.mismatches
            and self.world.value <= meters
            and self.translation.value <= meters
            and self.rotation.value <= degrees
            and self.scale.value <= SCALE_TOLERANCE
            and self.weight.value <= weights
        )


def compare(
    first: Path | str,
    second: Path | str,
    options: SourceOptions | None = None,
    second_options: SourceOptions | None = None,
) -> TakeDifference:
    """Compare the takes of two files by time from the first frame, joints by name.

    In USD files with several skeletons, each is compared with the one of the same path,
    unless options select one. The second take is rotated to the up axis of the first,
    and lengths are compared in metres. Different units, up axes and first time codes
    are reported as notes.

    Args:
        first: First file.
        second: Second file.
        options: Options of the first file. Without ``second_options`` they apply to
            both, as far as each format supports them.
        second_options: Options of the second file.

    Raises:
        FormatError: A file cannot be read or is malformed.
        OptionError: An option applies to neither file, or not to the file it is for.
    """
    paths = [Path(first), Path(second)]
    first_options = options or SourceOptions()
    options_by_file = [first_options, second_options]
    if second_options is None:
        options_by_file = [fitting_options(first_options, p, paths) for p in paths]
    if all(is_usd(path) for path in paths) and options_by_file == 2 * [SourceOptions()]:
        characters = [open_characters(path) for path in paths]
        if max(map(len, characters)) > 1:
            return _character_difference(*characters)
    return _stream_difference(*map(open_source, paths, options_by_file))


def _stream_difference(first: TakeStream, second: TakeStream) -> TakeDifference:
    """Compare two open takes; the second is rotated to the axes of the first."""
    difference = compare_takes(
        first.collect(), reorient(second, first.rig.up).collect()
    )
    difference.notices.extend([*first.notices, *second.notices])
    units = first.rig.meters_per_unit, second.rig.meters_per_unit
    difference.notes.extend(space_notes((first.rig.up, second.rig.up), units))
    if None not in {first.start, second.start} and first.start != second.start:
        codes = f"{float(first.start or 0):g} instead of {float(second.start or 0):g}"
        difference.notes.append(f"first time code {codes}; compared from there")
    return difference


_TakeOpeners: TypeAlias = Mapping[str, Callable[[], TakeStream]]


def _character_difference(first: _TakeOpeners, second: _TakeOpeners) -> TakeDifference:
    """Compare the skeletons of two stages, matched in pairs."""
    pairs = _skeleton_pairs(list(first), list(second))
    first_matches, second_matches = dict(pairs), {path for _, path in pairs}
    mismatches = unmatched_texts(
        "skeleton",
        [path for path in first if path not in first_matches],
        [path for path in second if path not in second_matches],
    )
    total = TakeDifference(mismatches=mismatches, skeletons=len(pairs))
    for first_path, second_path in pairs:
        difference = _stream_difference(first[first_path](), second[second_path]())
        total = _add_difference(total, difference, first_path)
    return total


def _skeleton_pairs(
    first: Sequence[str], second: Sequence[str]
) -> list[tuple[str, str]]:
    """Match skeletons by path, by path below the root prim, or else by order.

    >>> _skeleton_pairs(["/a/x/s", "/a/y/s"], ["/b/y/s", "/b/z/s"])
    [('/a/y/s', '/b/y/s')]
    >>> _skeleton_pairs(["/hero/s"], ["/b/y/s", "/b/z/s"])
    [('/hero/s', '/b/y/s')]
    """
    pairs: list[tuple[str, str]] = []
    unmatched_first, unmatched_second = list(first), list(second)
    key_functions: tuple[Callable[[str], str], ...] = (
        str,
        lambda path: path.split("/", 2)[-1],
    )
    for key in key_functions:
        path_by_key = {key(path): path for path in reversed(unmatched_second)}
        for path in list(unmatched_first):
            match = path_by_key.pop(key(path), None)
            if match is not None:
                pairs.append((path, match))
                unmatched_first.remove(path)
                unmatched_second.remove(match)
    return pairs or list(zip(unmatched_first, unmatched_second, strict=False))


def _add_difference(
    total: TakeDifference, skeleton_difference: TakeDifference, skeleton_path: str
) -> TakeDifference:
    """Return the total with a skeleton's difference: largest values, summed counts."""
    larger_differences = {}
    for quantity in ("world", "translation", "rotation", "scale", "weight"):
        difference = getattr(skeleton_difference, quantity)
        if difference.value > getattr(total, quantity).value:
            larger_differences[quantity] = replace(difference, skeleton=skeleton_path)
    new_notices = [
        notice for notice in skeleton_difference.notices if notice not in total.notices
    ]
    return replace(
        total,
        **larger_differences,
        frames=max(total.frames, skeleton_difference.frames),
        size=max(total.size, skeleton_difference.size),
        joints=total.joints + skeleton_difference.joints,
        shapes=total.shapes + skeleton_difference.shapes,
        mismatches=total.mismatches
        + [f"{skeleton_path}: {m}" for m in skeleton_difference.mismatches],
        notes=total.notes
        + [f"{skeleton_path}: {note}" for note in skeleton_difference.notes],
        notices=total.notices + new_notices,
    )


def space_notes(
    up_axes: tuple[UpAxis, UpAxis], units: tuple[float, float]
) -> list[str]:
    """Return a note if up axes or units [m] of two files differ."""
    notes = []
    if up_axes[0] is not up_axes[1]:
        notes.append(
            f"{up_axes[0]} up instead of {up_axes[1]} up; compared with {up_axes[0]} up"
        )
    if not math.isclose(*units, rel_tol=1e-6):
        first, second = map(unit_name, units)
        notes.append(f"lengths in {first} instead of {second}; compared in metres")
    return notes


def compare_takes(first: Take, second: Take) -> TakeDifference:
    """Compare two takes over their common joints and frames."""
    pairs = _joint_pairs(first.rig, second.rig)
    mismatches = _mismatches(first, second, pairs)
    if first.clock.rate != second.clock.rate:
        second = resampled(second, first.clock.rate)
    frame_count = min(first.clock.count, second.clock.count)
    first_joints, second_joints = ([pair[side] for pair in pairs] for side in (0, 1))
    time_codes = first.clock.times

    weight, shape_count, missing_shapes = compare_weights(first, second, frame_count)

    def find_largest(differences: FloatArray) -> Difference:
        if not differences.size:
            return Difference()
        frame, pair_index = np.unravel_index(np.argmax(differences), differences.shape)
        name = first.rig.names[first_joints[int(pair_index)]]
        return Difference(
            float(differences[frame, pair_index]), name, float(time_codes[frame])
        )

    first_channels, second_channels = (
        take.motion.select(slice(0, frame_count)).dense() for take in (first, second)
    )
    first_world = forward_kinematics(first.rig, *first_channels).positions
    second_world = forward_kinematics(second.rig, *second_channels).positions
    position_offsets = first_world[:, first_joints] - second_world[:, second_joints]
    translation_offsets = (
        first_channels[0][:, first_joints] - second_channels[0][:, second_joints]
    )
    rotation_angles = so3.angle_between(
        first_channels[1][:, first_joints], second_channels[1][:, second_joints]
    )
    first_scales, second_scales = map(_dense_scales, (first_channels, second_channels))
    scale_differences = first_scales[:, first_joints] - second_scales[:, second_joints]
    return TakeDifference(
        find_largest(np.linalg.norm(position_offsets, axis=-1)),
        find_largest(np.linalg.norm(translation_offsets, axis=-1)),
        find_largest(np.degrees(rotation_angles)),
        find_largest(np.abs(scale_differences).max(axis=-1)),
        weight,
        frame_count,
        len(pairs),
        shape_count,
        mismatches + missing_shapes,
        notes=[]
        if first.clock.count == second.clock.count
        else _fit_note(first, second, pairs),
        size=max(_largest_extent(first_world), _largest_extent(second_world)),
    )


def _largest_extent(positions: FloatArray) -> float:
    """Return the largest extent of any frame, or of the path of a single joint [m]."""
    if not positions.size:
        return 0.0
    extents = np.ptp(positions, axis=1)
    if not extents.any():
        extents = np.ptp(positions[:, 0], axis=0, keepdims=True)
    return float(np.linalg.norm(extents, axis=1).max())


def _dense_scales(
    dense: tuple[FloatArray, FloatArray, FloatArray | None],
) -> FloatArray:
    translations, _, scales = dense
    return np.ones(translations.shape) if scales is None else scales


def _joint_pairs(first: Rig, second: Rig) -> list[tuple[int, int]]:
    """Match joints by source name, then by name; return pairs of indices."""
    indices_by_name: dict[str, list[int]] = {}
    for i, joint in enumerate(second.joints):
        for key in {joint.source_name or joint.name, joint.name}:
            indices_by_name.setdefault(key, []).append(i)
    pairs: list[tuple[int, int]] = []
    used_indices: set[int] = set()
    for i, joint in enumerate(first.joints):
        for key in (joint.source_name or joint.name, joint.name):
            candidate_indices = indices_by_name.get(key, [])
            match = next((j for j in candidate_indices if j not in used_indices), None)
            if match is not None:
                used_indices.add(match)
                pairs.append((i, match))
                break
    return pairs


def _mismatches(first: Take, second: Take, pairs: list[tuple[int, int]]) -> list[str]:
    """Return texts that describe unmatched joints, and unequal lengths and rates."""
    matched_joints = dict(pairs), {joint for _, joint in pairs}
    unmatched_names = [
        [name for i, name in enumerate(take.rig.names) if i not in matched]
        for take, matched in zip((first, second), matched_joints, strict=True)
    ]
    mismatches = unmatched_texts("joint", *unmatched_names)
    if first.clock.count != second.clock.count:
        frames = counted(first.clock.count, "frame")
        text = f"the first has {frames} ({_range_text(first.clock)}), the second "
        text += f"{second.clock.count} ({_range_text(second.clock)})"
        if first.clock.start != second.clock.start:
            text += "; compared from the first frame of each"
        mismatches.append(text)
    if first.clock.rate != second.clock.rate:
        rates_text = f"{first.clock.rate} fps instead of {second.clock.rate}"
        mismatches.append(f"{rates_text}; frames are compared by time from the first")
    return mismatches


def _range_text(clock: Clock) -> str:
    """Return the first and last time code of a take as text."""
    return span_label(*(clock.times[i] for i in (0, -1)))


def _fit_note(first: Take, second: Take, pairs: list[tuple[int, int]]) -> list[str]:
    """Return a note if the shorter take matches later frames of the longer one.

    Of the frames of the longer take, those nearest to the first frame of the shorter
    are tried.
    """
    if first.clock.rate != second.clock.rate or not pairs:
        return []
    is_first_longer = first.clock.count > second.clock.count
    longer, shorter = (first, second) if is_first_longer else (second, first)
    joints_by_take = [[pair[side] for pair in pairs] for side in (0, 1)]
    longer_joints, shorter_joints = (
        joints_by_take if is_first_longer else joints_by_take[::-1]
    )
    long_positions = _world_positions(longer)[:, longer_joints]
    short_positions = _world_positions(shorter)[:, shorter_joints]
    short_count = len(short_positions)
    offset_count = len(long_positions) - short_count + 1
    if short_count < MIN_FITTED_FRAMES or offset_count < 2:
        return []

    def largest_distance(offset: int) -> float:
        offsets = long_positions[offset : offset + short_count] - short_positions
        return float(np.linalg.norm(offsets, axis=-1).max())

    start_offsets = long_positions[:offset_count] - short_positions[0]
    start_distances = np.linalg.norm(start_offsets, axis=-1).max(axis=1)
    nearest_offsets = np.argsort(start_distances, kind="stable")[:MAX_TRIED_OFFSETS]
    distances = {int(i): largest_distance(int(i)) for i in nearest_offsets}
    best_offset = min(distances, key=lambda offset: distances[offset])
    size = _largest_extent(short_positions)
    max_distance = min(FIT_FRACTION * size, FIT_FRACTION * largest_distance(0))
    if best_offset == 0 or distances[best_offset] > max_distance:
        return []
    time_codes = longer.clock.times
    first_code, last_code = (
        time_codes[best_offset],
        time_codes[best_offset + short_count - 1],
    )
    take_labels = ("second", "first") if is_first_longer else ("first", "second")
    frames = f"{frame_label(first_code)}-{frame_label(last_code)}"
    note = f"the {take_labels[0]} fits frames {frames} of the {take_labels[1]}; "
    setting = f"{argument('frame_range', frames)} on the {take_labels[1]}"
    return [f"{note}to compare these, use {setting}"]


def _world_positions(take: Take) -> FloatArray:
    """Return the joint positions of all frames ``(F, J, 3)`` [m]."""
    return forward_kinematics(take.rig, *take.motion.dense()).positions
