"""Detects root translations with another unit, up axis or sign than the skeleton."""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import FloatArray, median
from animtool.core.errors import Fault, warning
from animtool.core.quantities import length_text, plain_number, vector_text
from animtool.core.units import unit_name
from animtool.motion.motion import Motion
from animtool.rig.body_size import find_feet, is_character
from animtool.rig.kinematics import rest_size, rest_world
from animtool.rig.skeleton import Rig

# Ratios of units that are often confused: m, cm, mm, in.
UNIT_FACTORS = (10.0, 100.0, 1000.0, 39.37)
# Range of ratios of a root's height to its rest height that mean another unit [1].
HIGH_RATIO_RANGE = (25.0, 4000.0)
# Otherwise, in the correct unit, the lowest joint is this close to 0 of the up axis in
# most frames [size], [1]; or sometimes, as on stairs, and is then static in this
# fraction of frames [size], [size/s], [1].
ZERO_HEIGHT, MIN_ZERO_FRACTION = 0.06, 0.5
MIN_TREAD_FRACTION, TREAD_SPEED, STATIC_TREAD_FRACTION = 0.05, 0.12, 0.4
# Largest ratio of a root's height to the leg length that is checked for a unit in which
# it is too low, and fewest frames of such a check [1].
MAX_LOW_RATIO, MIN_LOW_FRAMES = 0.15, 8
# Largest factor by which a root is too low; 1/10 may be a crouching body [1].
MAX_LOW_FACTOR = 0.03
# Maximum distance of a root from the hips at rest, in leg lengths [1].
MAX_HIPS_DISTANCE = 0.3
# Minimum height of legs that are upright at rest, over the length of their bones [1].
MIN_UPRIGHT_RATIO = 0.6
# Tolerance of a height that equals the leg length, and its maximum standard deviation,
# in leg lengths [1].
HEIGHT_TOLERANCE, HEIGHT_DEVIATION = 0.15, 0.08
# A root that stays this far from the origin, in leg lengths, and moves by no more than
# this fraction of the distance, has a moved origin [1].
MIN_FAR_RATIO, MAX_FAR_TRAVEL = 500.0, 0.1
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


def low_height_factor(
    root_positions: FloatArray,
    body_positions: FloatArray,
    up: FloatArray,
    body_size: float,
    interval: float,
) -> float | None:
    """Return the unit factor by which a root translation is too small, else None.

    Multiplying the translation by the inverse of that factor would put the lowest joint
    on the ground in most frames, also of a crouching or crawling body.

    Args:
        root_positions: Positions of the root ``(F, 3)`` [m].
        body_positions: Positions of the joints that it carries ``(F, B, 3)`` [m].
        up: Unit up vector ``(3,)``.
        body_size: Size of the body [m].
        interval: Time between two frames [s].
    """
    frames = np.arange(1, len(body_positions))
    lowest_joints = (body_positions @ up).argmin(axis=1)
    lowest_points = body_positions[np.arange(len(body_positions)), lowest_joints]
    next_points = body_positions[frames, lowest_joints[:-1]]
    for factor in UNIT_FACTORS:
        lift = (factor - 1.0) * root_positions
        heights_above = (lowest_points + lift) @ up
        is_low = np.abs(heights_above) < ZERO_HEIGHT * body_size
        if float(is_low.mean()) > MIN_ZERO_FRACTION:
            return 1.0 / factor
        lowest = abs(float(np.percentile(heights_above, 5)))
        if lowest > MIN_TREAD_FRACTION * body_size:
            continue
        steps = next_points + lift[1:] - lowest_points[:-1] - lift[:-1]
        is_slow = np.linalg.norm(steps, axis=1) < TREAD_SPEED * body_size * interval
        if float(is_slow.mean()) > STATIC_TREAD_FRACTION:
            return 1.0 / factor
    return None


def factor_text(factor: float) -> str:
    """Return a unit factor as text, as a multiple or a fraction.

    >>> factor_text(100.0), factor_text(0.01)
    ('100 times', '1/100')
    """
    return f"{plain_number(factor)} times" if factor >= 1.0 else f"1/{1.0 / factor:.3g}"


def root_warning(
    rig: Rig, motion: Motion, interval: float | None = None
) -> Fault | None:
    """Return a warning if the root's translations do not fit the skeleton at rest.

    Its height is 25 times the leg length or more, as with another unit (MOT213); or it
    is the leg length below 0, or along a horizontal axis while the root travels
    vertically, as with another up axis (MOT214). Or it stays far from the origin
    (MOT223). Rigs without named feet, with a root that is not at the hips, or with
    several roots have no such warning.

    With an ``interval``, the time between two frames [s], the warning includes roots
    that are too low, as with another unit (MOT213).
    """
    if not motion.frames or not is_character(rig.names) or len(rig.roots) != 1:
        return None
    root, leg_length = int(rig.roots[0]), upright_leg_length(rig)
    if leg_length is None:
        return None
    name, up = rig.joints[root].name, np.array(rig.up.vector, float)
    ratios = motion.translations.gather(np.array([root]))[:, 0] / leg_length
    problem = _translation_problem(ratios, up, leg_length)
    problem = problem or _far_root_problem(rig, ratios, leg_length)
    if problem is None and interval is not None:
        problem = _low_root_problem(rig, motion, ratios @ up, leg_length, interval)
    if problem is None:
        return None
    code, message, hint = problem
    return warning(code, f"the root {name!r} {message}", hint)


def upright_leg_length(rig: Rig) -> float | None:
    """Return the height of the hips over the feet at rest [m].

    None if the root is elsewhere, or if the legs are not upright at rest.
    """
    positions = rest_world(rig).positions[0]
    up, hips = np.array(rig.up.vector, float), find_hips(rig)
    feet = find_feet(rig.names)
    joint = int(feet[(positions[feet] @ up).argmin()])
    leg_length = float((positions[hips] - positions[joint]) @ up)
    bones_length = 0.0
    while joint != hips:
        parent = int(rig.parents[joint])
        bones_length += float(np.linalg.norm(positions[joint] - positions[parent]))
        joint = parent
    distance = float(np.linalg.norm(positions[int(rig.roots[0])] - positions[hips]))
    is_upright = leg_length > MIN_UPRIGHT_RATIO * bones_length
    return (
        leg_length
        if is_upright and distance <= MAX_HIPS_DISTANCE * leg_length
        else None
    )


def _translation_problem(
    ratios: FloatArray, up: FloatArray, leg_length: float
) -> tuple[str, str, str] | None:
    """Return the code, the message and the hint for a root's translations.

    ``ratios`` ``(F, 3)`` are the translations over the leg length [m].
    """
    heights, up_name = ratios @ up, "XYZ"[int(up.argmax())]
    height, legs_text = float(median(heights)), length_text(leg_length)
    factor = height_factor(height)
    if factor is not None:
        message = f"is {length_text(height * leg_length)} above 0, but the legs are "
        message += f"{legs_text} long: its translations use another unit than the "
        return "MOT213", f"{message}skeleton", f"divide them by {factor:g}"
    if _is_leg_length(-heights):
        message = f"is {length_text(-height * leg_length)} below 0, about the length "
        message += "of the legs: its height has the other sign"
        return "MOT214", message, f"negate its {up_name} translations"
    travel = float(np.ptp(heights))
    for axis in np.flatnonzero(up == 0) if travel >= MIN_VERTICAL_TRAVEL else ():
        # The other axis may point up or down.
        middle = float(median(ratios[:, axis]))
        if _is_leg_length(math.copysign(1.0, middle) * ratios[:, axis]):
            distance = length_text(abs(middle) * leg_length)
            message = f"travels {length_text(travel * leg_length)} along {up_name} and "
            message += f"stays {distance} from 0 along {'XYZ'[axis]}, about the length "
            message += "of the legs: its translations have another up axis than the "
            message += "skeleton"
            hint = "exchange these two translations, or export the file again"
            return "MOT214", message, hint
    return None


def _far_root_problem(
    rig: Rig, ratios: FloatArray, leg_length: float
) -> tuple[str, str, str] | None:
    """Return the code, the message and the hint for a root far from the origin.

    ``ratios`` ``(F, 3)`` are its translations over the leg length [1].
    """
    distance = float(np.linalg.norm(ratios, axis=1).min())
    travel = float(np.linalg.norm(np.ptp(ratios, axis=0)))
    if distance < MIN_FAR_RATIO or travel > MAX_FAR_TRAVEL * distance:
        return None
    rounding = float(np.spacing(np.float32(distance * leg_length)))
    message = f"is {length_text(distance * leg_length)} or more from the origin, and "
    message += f"travels {length_text(travel * leg_length)}: single precision rounds "
    message += f"positions there by {length_text(rounding)}"
    first = (1 - np.array(rig.up.vector, float)) * ratios[0] * leg_length
    numbers = vector_text(first / rig.meters_per_unit, 6)
    hint = f"subtract where it starts on the ground, {numbers} "
    hint += f"{unit_name(rig.meters_per_unit)}, or export the take from a scene around "
    return "MOT223", message, f"{hint}the origin"


def _low_root_problem(
    rig: Rig, motion: Motion, ratios: FloatArray, leg_length: float, interval: float
) -> tuple[str, str, str] | None:
    """Return the code, the message and the hint for a root that is too low.

    ``ratios`` ``(F,)`` are its heights over the leg length [1].
    """
    ratio = float(median(ratios))
    if len(ratios) < MIN_LOW_FRAMES or not 0.0 < ratio < MAX_LOW_RATIO:
        return None
    positions, up = motion.world(rig).positions, np.array(rig.up.vector, float)
    root_positions = positions[:, int(rig.roots[0])]
    size = rest_size(rig)
    factor = low_height_factor(root_positions, positions, up, size, interval)
    if factor is None or factor > MAX_LOW_FACTOR:
        return None
    height_text, legs_text = length_text(ratio * leg_length), length_text(leg_length)
    message = f"is {height_text} above 0, but the legs are {legs_text} long: its "
    message += f"translations are {factor_text(factor)} of those that fit, and use "
    message += "another unit than the skeleton"
    return "MOT213", message, f"multiply them by {1.0 / factor:g}"


def _is_leg_length(ratios: FloatArray) -> bool:
    """Return whether values ``(F,)`` over the leg length stay close to 1."""
    is_close = abs(float(median(ratios)) - 1.0) < HEIGHT_TOLERANCE
    return is_close and float(ratios.std()) < HEIGHT_DEVIATION


def find_hips(rig: Rig) -> int:
    """Return the lowest joint whose subtree contains all feet."""
    paths = [set(rig.upwards(foot)) for foot in find_feet(rig.names).tolist()]
    return max(set.intersection(*paths))
