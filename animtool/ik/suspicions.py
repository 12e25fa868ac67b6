"""Warnings about targets files whose numbers suggest another unit or order."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from animtool.clip.channels import ClipUnits
from animtool.clip.suspicions import AngleCurve, warn_of_angle_keys
from animtool.clip.suspicious_times import seconds_texts
from animtool.core.quantities import length_text
from animtool.core.units import LengthUnit, unit_name
from animtool.documents.document import Document, Location
from animtool.ik.schema import GoalModel
from animtool.ik.tracks import GoalTrack
from animtool.ik.values import KeyedValue
from animtool.rig.kinematics import rest_size
from animtool.rig.skeleton import Rig
from animtool.rig.suspicions import (
    HALF_REVOLUTION_ABOUT_Z,
    warn_of_quaternion,
    warn_of_stretch_percent,
)

# Lengths of offsets that are too long for a tool in a hand, and plausible ones in
# another unit, relative to the rig's size.
MAX_OFFSET, PLAUSIBLE_OFFSET = 2.0, 1.0


def warn_of_quaternion_order(document: Document) -> None:
    """Warn of [0, 0, 0, 1], which is the identity only if w is last (TGT108)."""
    located_quaternions: list[tuple[Location, list[float]]] = []
    for i, goal in enumerate(document.value["goals"]):
        value = goal.get("orientation")
        location: Location = ("goals", i, "orientation")
        if isinstance(value, list):
            located_quaternions.append((location, value))
        elif isinstance(value, dict) and isinstance(value.get("keys"), list):
            for k, key in enumerate(value["keys"]):
                located_quaternions.append(((*location, "keys", k, "v"), key["v"]))
    located_quaternions = [
        (location, quaternion)
        for location, quaternion in located_quaternions
        if isinstance(quaternion, list) and len(quaternion) == 4
    ]
    if any(abs(first) > abs(last) for _, (first, *_, last) in located_quaternions):
        return
    for location, quaternion in located_quaternions:
        if quaternion == HALF_REVOLUTION_ABOUT_Z:
            warn_of_quaternion(document, "TGT108", location)
            return


def warn_of_seconds(
    document: Document,
    fps: Fraction,
    frames: tuple[float, float] | None,
    goals: Sequence[GoalTrack],
) -> None:
    """Warn of key times and spans that look like seconds (CLIP110).

    Args:
        document: The targets file.
        fps: Frames per second.
        frames: First and last frame of its range; None if it has none.
        goals: Goals of the file.
    """
    key_times = [
        value.channel.times
        for track in goals
        for value in (*track.values.values(), *track.weights.values())
        if isinstance(value, KeyedValue)
    ]
    key_times += [
        np.array(span) for track in goals for span in (*track.spans, *track.during)
    ]
    message_and_hint = seconds_texts(key_times, fps, frames)
    if message_and_hint is not None:
        message = f"key times and spans from {message_and_hint[0]}"
        document.warn("CLIP110", ("goals",), message, message_and_hint[1])


def warn_of_angles(
    document: Document, goals: Sequence[GoalTrack], units: ClipUnits, rig: Rig | None
) -> None:
    """Warn of orientation angles that seem to be in another unit (CLIP107)."""
    curves = [
        AngleCurve(("goals", i, "orientation"), track.name, value.channel.values)
        for i, track in enumerate(goals)
        if isinstance(value := track.values.get("orientation"), KeyedValue)
        and value.channel.euler
    ]
    warn_of_angle_keys(document, curves, "orientation keys of", "goal", units, rig)


def warn_of_stretch(document: Document, goals: Sequence[GoalModel]) -> None:
    """Warn of a stretch that looks like a percentage (RIG114)."""
    for i, goal in enumerate(goals):
        if goal.stretch is not None:
            warn_of_stretch_percent(document, ("goals", i, "stretch"), goal.stretch)


def warn_of_offsets(
    document: Document, goals: Sequence[GoalModel], units: ClipUnits, rig: Rig
) -> None:
    """Warn of an offset that is far longer than the rig (TGT110)."""
    rig_size = rest_size(rig)
    for i, goal in enumerate(goals):
        offset_length = math.hypot(*goal.offset)
        likely_unit = next(
            (
                unit
                for unit in (LengthUnit.CM, LengthUnit.MM)
                if unit.meters < units.length
                and offset_length * unit.meters <= PLAUSIBLE_OFFSET * rig_size
            ),
            None,
        )
        if offset_length * units.length <= MAX_OFFSET * rig_size or likely_unit is None:
            continue
        factor = likely_unit.meters / units.length
        offset_text = ", ".join(f"{number * factor:.4g}" for number in goal.offset)
        unit = unit_name(units.length)
        message = (
            f"the offset is {length_text(offset_length * units.length)} from "
            f"{goal.effector!r}, with lengths in {unit}; the rig is "
            f"{length_text(rig_size)} tall"
        )
        hint = f"for {likely_unit} write [{offset_text}], or 'units: {{length: "
        hint += f"{likely_unit}}}' for all lengths"
        document.warn("TGT110", ("goals", i, "offset"), message, hint)
        return
