"""Solver options and tolerances, with their defaults."""

from __future__ import annotations

import math
from enum import StrEnum

from animtool.core.options import inherits_docs, option
from animtool.core.record import dataclass
from animtool.core.units import parse_length

# Default solve tolerances of takes, and the miss above which a goal is reported;
# smaller misses are invisible. Angles in degrees.
LENGTH_TOLERANCE, ANGLE_TOLERANCE = "0.001mm", 1e-4
REPORTED_MISS, REPORTED_MISS_DEGREES = "0.1mm", 0.1


class IkMethod(StrEnum):
    """Solver method.

    Attributes:
        AUTO: The closed form of a limb of two bones, or of an arm of six pins whose
            last three axes meet or whose middle axes are parallel; else DAMPED.
        DAMPED: Damped least squares with restarts; works for every problem, and is the
            only method that supports priorities.
        TWO_BONE: The closed form of a limb of two bones; DAMPED where the elbow's
            limits prevent it.
        GRADIENT: Steepest descent with backtracking.
        NEWTON: Newton's method, with second derivatives of positions and orientations,
            in a region of trust.
        CCD: Cyclic coordinate descent, joint by joint.
        FABRIK: Forward and backward reaching; positions only.

    The last four are for comparison: they use the given start only, without restarts,
    with one step or sweep per iteration.
    """

    AUTO = "auto"
    DAMPED = "damped"
    TWO_BONE = "two_bone"
    GRADIENT = "gradient"
    NEWTON = "newton"
    CCD = "ccd"
    FABRIK = "fabrik"


@dataclass(frozen=True, slots=True)
class IkOptions:
    """Options of a solve.

    Attributes:
        method: ``auto`` takes a closed form where the problem has one, else damped
            least squares; see `IkMethod`.
        tolerance: A position is reached within this fraction of the problem's length.
        angle_tolerance: An orientation, aim or pole is reached within this [rad].
        iterations: Maximum number of iterations of one problem, including restarts.
        restarts: Maximum number of restarts if damped steps end short of the goals.
        seed: Seed of the restarts; the same seed gives the same poses.
        seconds: Time limit of one problem [s]; 0 sets none. With a limit, results
            depend on the machine.
        ordered: The problems are consecutive frames. A frame that ends as far from its
            goals as the previous one is not restarted.
        warm: Warm-start each problem from the previous solution.
        near: Pull poses found by restarts towards the preferred pose while the goals
            stay reached; this takes longer than finding them.
    """

    method: IkMethod = IkMethod.AUTO
    tolerance: float = 1e-6
    angle_tolerance: float = 1e-6
    iterations: int = 5000
    restarts: int = 200
    seed: int = 0
    seconds: float = 0.0
    ordered: bool = False
    warm: bool = False
    near: bool = False


@inherits_docs
@dataclass(frozen=True, slots=True)
class TakeOptions:
    """Options of solving a take for targets.

    Attributes:
        seconds: Time limit of one frame [s]; 0 sets none.
        smooth: Time over which motion that the goals leave free is smoothed [s]; 0
            disables it.
    """

    method: IkMethod = option(
        IkMethod.AUTO,
        "name",
        choices=tuple(IkMethod),
        help="The solver.",
        text_default=IkMethod.AUTO.value,
    )
    tolerance: float = option(
        parse_length(LENGTH_TOLERANCE),
        "length",
        help="Position tolerance.",
        text_default=LENGTH_TOLERANCE,
    )
    angle_tolerance: float = option(
        math.radians(ANGLE_TOLERANCE),
        "angle",
        help="Tolerance of orientations, aims and poles.",
        text_default=ANGLE_TOLERANCE,
    )
    restarts: int = option(
        50, "count", help="Limit of restarts for a frame that does not reach its goals."
    )
    seed: int = option(
        0, "seed", help="Seed of the restarts: the same seed gives the same poses."
    )
    seconds: float = option(
        0.0,
        "amount",
        flag="time-budget",
        metavar="SECONDS",
        help="Time limit for one frame, such as 0.01; results then depend on the "
        "machine.  [default: none]",
    )
    joints: tuple[str, ...] = option(
        (),
        "names",
        help="The joints that may move, or patterns such as 'arm_*'.  [default: "
        "every joint that moves a goal]",
    )
    rest_weight: float = option(
        0.0,
        "amount",
        metavar="WEIGHT",
        help="How strongly to keep each frame's pose in START, or the rest pose; the "
        "goals are missed by about as much.",
    )
    smooth: float = option(
        0.0,
        "amount",
        metavar="SECONDS",
        help="Time over which motion that the goals leave free is smoothed.",
    )
