"""Detects characters whose size suggests another unit than the file states."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import IntArray
from animtool.core.quantities import length_text
from animtool.core.units import LengthUnit, unit_name

# Words for feet and hands, alone or in compounds, but not as in flyWHEEL.
_FOOT_WORDS, _HAND_WORDS = "foot|feet|toe|ankle|heel|paw|hoof", "hand|wrist"
_FOOT_PATTERN, _HAND_PATTERN = (
    re.compile(
        rf"(?<![A-Za-z])(?:{words})"
        rf"|{'|'.join(word.capitalize() for word in words.split('|'))}"
        rf"|(?<![A-Za-z])(?:{words.upper()})"
    )
    for words in (_FOOT_WORDS, _HAND_WORDS)
)
# With fewer joints, a rig is a prop of any size.
MIN_CHARACTER_JOINTS = 10
# Plausible diagonal of the joints of rigs with feet, from a bird to a dinosaur [m].
CHARACTER_SIZE_RANGE = (0.1, 25.0)
# Size of people and most animals [m]; a corrected unit must give such a size.
LIKELY_SIZE_RANGE = (0.3, 5.0)
# Ratios of units that are often confused [1].
UNIT_RATIOS = (10.0, 100.0, 1000.0, 0.1, 0.01, 0.001)


def find_feet(joint_names: tuple[str, ...] | list[str]) -> IntArray:
    """Return the indices of the joints whose names are those of feet ``(N,)``.

    >>> find_feet(["hips", "LeftFoot", "toe_l", "flywheel", "l_ankle"]).tolist()
    [1, 2, 4]
    """
    foot_indices = [
        i for i, name in enumerate(joint_names) if _FOOT_PATTERN.search(name)
    ]
    return np.array(foot_indices, np.int64)


def find_hands(names: tuple[str, ...] | list[str]) -> IntArray:
    """Return the indices of hand joints, including those of fingers named for them.

    >>> find_hands(["hips", "LeftHand", "RightHandThumb1", "wrist_l"]).tolist()
    [1, 2, 3]
    """
    hand_indices = [i for i, name in enumerate(names) if _HAND_PATTERN.search(name)]
    return np.array(hand_indices, np.int64)


def is_character(joint_names: Sequence[str]) -> bool:
    """Return whether a rig has the feet and joint count of a person or animal."""
    return (
        len(joint_names) >= MIN_CHARACTER_JOINTS
        and len(find_feet(list(joint_names))) > 0
    )


def fitting_unit(joint_names: Sequence[str], size: float, unit: float) -> float | None:
    """Return a unit [m] in which an implausible character has a likely size, or None.

    Args:
        joint_names: Joints of its rig.
        size: Its size [m].
        unit: Unit in which it is read [m].

    >>> body = ["hips", "foot_l", *"abcdefgh"]
    >>> fitting_unit(body, 214.0, 1.0), fitting_unit(body, 2.14, 1.0)
    (0.01, None)
    """
    smallest, largest = CHARACTER_SIZE_RANGE
    if smallest <= size <= largest or not is_character(joint_names):
        return None
    for ratio in UNIT_RATIOS:
        if LIKELY_SIZE_RANGE[0] <= size * ratio <= LIKELY_SIZE_RANGE[1]:
            return unit * ratio
    return None


def size_warning_texts(
    size: float, unit: float, likely_unit: float, file_format: str = ""
) -> tuple[str, str]:
    """Return a message about a size that fits another unit, and a hint.

    Args:
        size: The size [m].
        unit: Unit in which the file is read [m].
        likely_unit: Unit in which the size is likely [m].
        file_format: ``USD``, ``clip`` for the rig of a clip, or another one.

    >>> size_warning_texts(214.2, 1.0, 0.01, "USD")[1]
    'if its numbers are in cm, set metersPerUnit = 0.01 in the file'
    """
    size_texts = length_text(size, 4), length_text(size * likely_unit / unit, 4)
    current_name, fitting_name = unit_name(unit), unit_name(likely_unit)
    if current_name not in set(LengthUnit):
        current_name = f"units of {current_name}"
    is_usd = file_format == "USD"
    message = f"metersPerUnit = {unit:g}: " if is_usd else ""
    message += f"the character spans {size_texts[0]}"
    message += "; " if is_usd else f", with lengths in {current_name}; "
    if fitting_name not in set(LengthUnit):
        message += f"at {likely_unit / unit:g} times the size it would span "
        return message + size_texts[1], "export it again at its true size"
    condition = f"if its numbers are in {fitting_name}"
    message += f"at metersPerUnit = {likely_unit:g}" if is_usd else f"in {fitting_name}"
    message += f" it would span {size_texts[1]}"
    if is_usd:
        return message, f"{condition}, set metersPerUnit = {likely_unit:g} in the file"
    if file_format == "clip":
        remedy = f"write units: {{length: {fitting_name}}} in the rig"
        return message, f"{condition}, {remedy}"
    unit_argument = argument("source.unit", fitting_name)
    return message, f"{condition}, read it with {unit_argument}"
