"""Compares two takes: joints, shapes, controls, and where they differ most."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, counted, listed
from animtool.core.record import dataclass
from animtool.core.units import UpAxis, unit_name
from animtool.edit.resample import resampled
from animtool.maths import so3
from animtool.motion.reorient import reorient
from animtool.motion.take import Take, TakeStream
from animtool.rig.kinematics import forward
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
    """Largest difference of weights."""

    value: float = 0.0  # how large [1]
    shape: str = ""  # of which shape, as the first take has it
    code: float = 0.0  # time code in the first take
    skeleton: str = ""  # of which skeleton of the first file, where it has several


def compare_weights(
    first: Take, second: Take, frames: int
) -> tuple[ShapeDifference, int, list[str]]:
    """Compare the weights of two takes of equal rate, shapes by name.

    Shapes of ARKit's are the same however they are spelled. A shape that only one take
    has is a mismatch where its weight is ever other than 0.

    Returns the largest difference, how many shapes were compared, and which only one
    has.
    """
    a, b = (_weights(take) for take in (first, second))
    names = [[shape.name for shape in take.rig.shapes] for take in (first, second)]
    pairs = _pairs(*names)
    mismatches = []
    for column, (weights, other) in enumerate(((a, "second"), (b, "first"))):
        alone = set(range(weights.shape[1])) - {pair[column] for pair in pairs}
        lost = [names[column][s] for s in sorted(alone) if weights[:, s].any()]
        if lost:
            mismatches.append(lost_text("shape", lost, other))
    mine, theirs = [s for s, _ in pairs], [s for _, s in pairs]
    difference = np.abs(a[:frames, mine] - b[:frames, theirs])
    if not difference.size:
        return ShapeDifference(), 0, mismatches
    frame, pair = np.unravel_index(np.argmax(difference), difference.shape)
    largest = ShapeDifference(
        float(difference[frame, pair]),
        names[0][mine[int(pair)]],
        float(first.clock.times[frame]),
    )
    return largest, len(pairs), mismatches


def lost_text(noun: str, lost: Sequence[str], other: str) -> str:
    """Return text that lists what only one of two has."""
    are = "is" if len(lost) == 1 else "are"
    return f"{counted(len(lost), noun)} {are} not in the {other}: {listed(lost)}"


def _weights(take: Take) -> FloatArray:
    """Return the weights of every shape ``(F, S)``; missing ones are 0."""
    if take.motion.weights is None:
        return np.zeros((take.clock.count, len(take.rig.shapes)))
    return take.motion.weights.dense()[..., 0]


def _pairs(first: Sequence[str], second: Sequence[str]) -> list[tuple[int, int]]:
    """Match shapes by name, then by ARKit name, in order."""
    pairs = [(i, second.index(name)) for i, name in enumerate(first) if name in second]
    mine, theirs = {i for i, _ in pairs}, {k for _, k in pairs}
    spelled = {
        arkit: k
        for k, name in enumerate(second)
        if k not in theirs and (arkit := arkit_name(name)) is not None
    }
    for i, name in enumerate(first):
        match = None if i in mine else spelled.pop(arkit_name(name) or "", None)
        if match is not None:
            pairs.append((i, match))
    return sorted(pairs)


# USD holds scales as 16-bit floats, which are 5e-4 apart near one.
SCALE_TOLERANCE = 1e-3
# Of what a weight of one moves by centimetres, less than a micrometre.
WEIGHT_TOLERANCE = 1e-5


@dataclass(frozen=True, slots=True)
class Difference:
    """Largest difference of one kind."""

    value: float  # how large [m] or [deg]
    joint: str  # where
    code: float  # time code in the first take
    skeleton: str = ""  # of which skeleton of the first file, where it has several


@dataclass(frozen=True, slots=True)
class TakeDifference:
    """Differences of two takes over their common joints, shapes and frames."""

    world: Difference  # world position [m]
    translation: Difference  # local translation [m]
    rotation: Difference  # local rotation [deg]
    scale: Difference  # local scale [1]
    weight: ShapeDifference  # weight of a blend shape [1]
    frames: int  # frames compared
    joints: int  # joints compared
    shapes: int  # shapes compared
    mismatches: list[str]  # what one has and the other has not, in words
    # Differences that do not affect the takes, as text.
    notes: list[str] = field(default_factory=list)
    notices: list[Fault] = field(default_factory=list)  # warnings and notes
    skeletons: int = (
        1  # skeletons compared, whose joints and shapes are counted together
    )

    def within(
        self, meters: float, degrees: float, weights: float = WEIGHT_TOLERANCE
    ) -> bool:
        """Return whether the takes agree within tolerances."""
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

    Of USD files with several skeletons each is compared with that of its path, unless
    options name one. The second is turned to the up axis of the first, and lengths are
    compared in metres. Other units, up axes and first time codes are noted.

    Args:
        first: A file.
        second: Another.
        options: What the first is; without ``second_options`` both, each as far as
            such files take it: units and up axis are stated by USD files themselves.
        second_options: What the second is.

    Raises:
        FormatError: A file cannot be read or is malformed.
        OptionError: An option does not apply to its file, or to neither.
    """
    paths = [Path(first), Path(second)]
    mine = options or SourceOptions()
    each_options = [mine, second_options]
    if second_options is None:
        each_options = [fitting_options(mine, path, paths) for path in paths]
    if all(is_usd(path) for path in paths) and each_options == 2 * [SourceOptions()]:
        characters = [open_characters(path) for path in paths]
        if max(map(len, characters)) > 1:
            return _character_difference(*characters)
    return _stream_difference(
        *(
            open_source(path, chosen)
            for path, chosen in zip(paths, each_options, strict=True)
        )
    )


def _stream_difference(one: TakeStream, two: TakeStream) -> TakeDifference:
    """Compare two open takes, the second in the axes of the first."""
    difference = compare_takes(one.collect(), reorient(two, one.rig.up).collect())
    difference.notices.extend([*one.notices, *two.notices])
    meters = one.rig.meters_per_unit, two.rig.meters_per_unit
    difference.notes.extend(space_notes((one.rig.up, two.rig.up), meters))
    if None not in {one.start, two.start} and one.start != two.start:
        codes = f"{float(one.start or 0):g} instead of {float(two.start or 0):g}"
        difference.notes.append(f"first time code {codes}; compared from there")
    return difference


_TakeReaders: TypeAlias = Mapping[str, Callable[[], TakeStream]]


def _character_difference(first: _TakeReaders, second: _TakeReaders) -> TakeDifference:
    """Compare the skeletons of two stages, by their paths."""
    pairs = _skeleton_pairs(list(first), list(second))
    mismatches = [
        lost_text("skeleton", lost, other)
        for names, column, other in ((first, 0, "second"), (second, 1, "first"))
        if (lost := [name for name in names if name not in {p[column] for p in pairs}])
    ]
    none = Difference(0.0, "", 0.0)
    merged = TakeDifference(
        *(none, none, none, none, ShapeDifference()),
        frames=0,
        joints=0,
        shapes=0,
        mismatches=mismatches,
        skeletons=len(pairs),
    )
    for mine, theirs in pairs:
        difference = _stream_difference(first[mine](), second[theirs]())
        merged = _merged(merged, difference, mine)
    return merged


def _skeleton_pairs(
    first: Sequence[str], second: Sequence[str]
) -> list[tuple[str, str]]:
    """Match skeletons by path, then by path below the root prim, then in order.

    >>> _skeleton_pairs(["/a/x/s", "/a/y/s"], ["/b/y/s", "/b/z/s"])
    [('/a/y/s', '/b/y/s')]
    >>> _skeleton_pairs(["/hero/s"], ["/b/y/s", "/b/z/s"])
    [('/hero/s', '/b/y/s')]
    """
    pairs: list[tuple[str, str]] = []
    mine, theirs = list(first), list(second)
    keys: tuple[Callable[[str], str], ...] = (str, lambda p: p.split("/", 2)[-1])
    for key in keys:
        index = {key(path): path for path in reversed(theirs)}
        for path in list(mine):
            match = index.pop(key(path), None)
            if match is not None:
                pairs.append((path, match))
                mine.remove(path)
                theirs.remove(match)
    return pairs or list(zip(mine, theirs, strict=False))


def _merged(
    total: TakeDifference, part: TakeDifference, skeleton: str
) -> TakeDifference:
    """Return the differences of several skeletons merged with one more."""
    kinds = ("world", "translation", "rotation", "scale", "weight")
    larger = {
        kind: replace(difference, skeleton=skeleton)
        for kind in kinds
        if (difference := getattr(part, kind)).value > getattr(total, kind).value
    }
    named = {
        name: [f"{skeleton}: {line}" for line in getattr(part, name)]
        for name in ("mismatches", "notes")
    }
    return replace(
        total,
        **larger,
        frames=max(total.frames, part.frames),
        joints=total.joints + part.joints,
        shapes=total.shapes + part.shapes,
        mismatches=total.mismatches + named["mismatches"],
        notes=total.notes + named["notes"],
        notices=total.notices + [n for n in part.notices if n not in total.notices],
    )


def space_notes(ups: tuple[UpAxis, UpAxis], meters: tuple[float, float]) -> list[str]:
    """Return a note if up axes or units [m] of two files differ."""
    notes = []
    if ups[0] is not ups[1]:
        notes.append(f"{ups[0]} up instead of {ups[1]} up; compared with {ups[0]} up")
    if not math.isclose(*meters, rel_tol=1e-6):
        first, second = map(unit_name, meters)
        notes.append(f"lengths in {first} instead of {second}; compared in metres")
    return notes


def compare_takes(first: Take, second: Take) -> TakeDifference:
    """Compare two takes over their common joints and frames."""
    pairs = _joint_pairs(first.rig, second.rig)
    mismatches = _mismatches(first, second, pairs)
    if first.clock.rate != second.clock.rate:
        second = resampled(second, first.clock.rate)
    frames = min(first.clock.count, second.clock.count)
    mine = [a for a, _ in pairs]
    theirs = [b for _, b in pairs]
    codes = first.clock.times

    weight, shapes, lost = compare_weights(first, second, frames)

    def largest(values: FloatArray) -> Difference:
        if not values.size:
            return Difference(0.0, "", 0.0)
        frame, joint = np.unravel_index(np.argmax(values), values.shape)
        name = first.rig.names[mine[int(joint)]]
        return Difference(float(values[frame, joint]), name, float(codes[frame]))

    a, b = (take.motion.select(slice(0, frames)).dense() for take in (first, second))
    world_a, world_b = forward(first.rig, *a), forward(second.rig, *b)
    difference = world_a.positions[:, mine] - world_b.positions[:, theirs]
    moved = a[0][:, mine] - b[0][:, theirs]
    turned = so3.angle_between(a[1][:, mine], b[1][:, theirs])
    return TakeDifference(
        largest(np.linalg.norm(difference, axis=-1)),
        largest(np.linalg.norm(moved, axis=-1)),
        largest(np.degrees(turned)),
        largest(np.abs(_scales(a)[:, mine] - _scales(b)[:, theirs]).max(axis=-1)),
        weight,
        frames,
        len(pairs),
        shapes,
        mismatches + lost,
    )


def _scales(
    dense: tuple[FloatArray, FloatArray, FloatArray | None],
) -> FloatArray:
    translations, _, scales = dense
    return np.ones(translations.shape) if scales is None else scales


def _joint_pairs(first: Rig, second: Rig) -> list[tuple[int, int]]:
    """Match joints by source name, then by name, in order."""
    index: dict[str, list[int]] = {}
    for i, joint in enumerate(second.joints):
        for key in {joint.source_name or joint.name, joint.name}:
            index.setdefault(key, []).append(i)
    pairs: list[tuple[int, int]] = []
    used: set[int] = set()
    for i, joint in enumerate(first.joints):
        keys = (joint.source_name or joint.name, joint.name)
        candidates = [k for key in keys for k in index.get(key, []) if k not in used]
        if candidates:
            used.add(candidates[0])
            pairs.append((i, candidates[0]))
    return pairs


def _mismatches(first: Take, second: Take, pairs: list[tuple[int, int]]) -> list[str]:
    names = []
    for take, other, column in ((first, "second", 0), (second, "first", 1)):
        matched = {pair[column] for pair in pairs}
        missing = [n for i, n in enumerate(take.rig.names) if i not in matched]
        if missing:
            names.append(lost_text("joint", missing, other))
    if first.clock.count != second.clock.count:
        frames = counted(first.clock.count, "frame")
        names.append(f"{frames} instead of {second.clock.count}")
    if first.clock.rate != second.clock.rate:
        names.append(f"{first.clock.rate} fps instead of {second.clock.rate}")
    return names
