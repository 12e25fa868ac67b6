"""Detects root translations with another unit, up axis or sign than the skeleton."""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, warning
from animtool.core.quantities import length_text
from animtool.motion.motion import Motion
from animtool.rig.body_size import find_feet, is_character
from animtool.rig.kinematics import rest_world
from animtool.rig.skeleton import Rig

# Ratios of units that are often confused: m, cm, mm, in.
UNIT_FACTORS = (10.0, 100.0, 1000.0, 39.37)
# Range of ratios of a root's height to its rest height that mean another unit [1].
HIGH_RATIO_RANGE = (25.0, 4000.0)
# Maximum distance of a root from the hips at rest, in leg lengths [1].
MAX_HIPS_DISTANCE = 0.3
# Tolerance of a height that equals the leg length, and its maximum standard deviation,
# in leg lengths [1].
HEIGHT_TOLERANCE, HEIGHT_DEVIATION = 0.15, 0.08
# Minimum range of a root along the up axis that is a path over the ground, in leg
# lengths [1].
MIN_VERTICAL_TRAVEL = 1.0


def height_factor(ratio: float) -> float | None:
    """Return the unit conversion factor nearest to a height ratio; None if implausible.

    Crawling or climbing bodies are lower or higher than at rest, but never by such
    factors.

    >>> [height_factor(ratio) for ratio in (45.0, 1700.0, 12.0, 1e6)]
    [39.37, 1000.0, None, None]
    """
    if not HIGH_RATIO_RANGE[0] < ratio < HIGH_RATIO_RANGE[1]:
        return None
    return min(UNIT_FACTORS, key=lambda factor: abs(math.log(ratio / factor)))


def root_warning(rig: Rig, motion: Motion) -> Fault | None:
    """Return a warning if the root's translations do not fit the skeleton at rest.

    Its height is 25 times the leg length or more, as with another unit (MOT213); or it
    is the leg length below 0, or along a horizontal axis while the root travels
    vertically, as with another up axis (MOT214). Rigs without named feet, with a root
    that is not at the hips, or with several roots have no such warning.
    """
    if not is_character(rig.names) or len(rig.roots) != 1:
        return None
    root, leg_length = int(rig.roots[0]), _leg_length(rig)
    if leg_length is None:
        return None
    name, up = rig.joints[root].name, np.array(rig.up.vector, float)
    ratios = motion.translations.gather(np.array([root]))[:, 0] / leg_length
    problem = _problem(ratios, up, leg_length)
    if problem is None:
        return None
    code, message, hint = problem
    return warning(code, f"the root {name!r} {message}", hint)


def _leg_length(rig: Rig) -> float | None:
    """Return the height of the hips over the feet at rest [m].

    None if the root is elsewhere.
    """
    positions = rest_world(rig).positions[0]
    up, hips = np.array(rig.up.vector, float), _hips(rig)
    feet_height = float((positions[find_feet(rig.names)] @ up).min())
    length = float(positions[hips] @ up) - feet_height
    distance = float(np.linalg.norm(positions[int(rig.roots[0])] - positions[hips]))
    return length if length > 0 and distance <= MAX_HIPS_DISTANCE * length else None


def _problem(
    ratios: FloatArray, up: FloatArray, leg_length: float
) -> tuple[str, str, str] | None:
    """Return the code, the message and the hint for a root's translations.

    ``ratios`` ``(F, 3)`` are the translations over the leg length [m].
    """
    heights, up_name = ratios @ up, "XYZ"[int(up.argmax())]
    height, legs_text = float(np.median(heights)), length_text(leg_length)
    factor = height_factor(height)
    if factor is not None:
        message = f"is {length_text(height * leg_length)} above 0, but the legs are "
        message += f"{legs_text} long: its translations use another unit than the "
        return "MOT213", f"{message}skeleton", f"divide them by {factor:g}"
    if _is_leg_length(-heights):
        message = (
            f"is {length_text(-height * leg_length)} below 0, which is the length "
        )
        message += "of the legs: its height has the other sign"
        return "MOT214", message, f"negate its {up_name} translations"
    travel = float(np.ptp(heights))
    for axis in np.flatnonzero(up == 0) if travel >= MIN_VERTICAL_TRAVEL else ():
        if _is_leg_length(ratios[:, axis]):
            message = f"travels {length_text(travel * leg_length)} along {up_name} and "
            message += f"stays at {legs_text} along {'XYZ'[axis]}, the length of the "
            message += "legs: its translations have another up axis than the skeleton"
            hint = "exchange these two translations, or export the file again"
            return "MOT214", message, hint
    return None


def _is_leg_length(ratios: FloatArray) -> bool:
    """Return whether values ``(F,)`` over the leg length stay close to 1."""
    is_close = abs(float(np.median(ratios)) - 1.0) < HEIGHT_TOLERANCE
    return is_close and float(ratios.std()) < HEIGHT_DEVIATION


def _hips(rig: Rig) -> int:
    """Return the lowest joint whose subtree contains all feet."""
    paths: list[list[int]] = []
    for joint in find_feet(rig.names).tolist():
        path = [joint]
        while rig.parents[path[-1]] >= 0:
            path.append(int(rig.parents[path[-1]]))
        paths.append(path[::-1])
    hips = paths[0][0]
    for ancestors in zip(*paths, strict=False):
        if len(set(ancestors)) > 1:
            break
        hips = ancestors[0]
    return hips
