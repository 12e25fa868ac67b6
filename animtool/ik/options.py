"""How to solve, and to within what: the defaults of all that solves."""

from __future__ import annotations

import math
from enum import StrEnum

from animtool.core.options import inherits_docs, option
from animtool.core.record import dataclass
from animtool.core.units import parse_length

# Takes are solved to within these; what is off by more is missed, where nothing else is
# asked: what nobody sees is less. Angles in degrees.
LENGTH_TOLERANCE, ANGLE_TOLERANCE = "0.001mm", 1e-4
MISSED, MISSED_DEGREES = "0.1mm", 0.1


class IkMethod(StrEnum):
    """Which solver.

    Attributes:
        AUTO: The closed form of a limb of two bones, or of an arm of six pins whose
            last three meet or whose middle ones are parallel; else damped steps.
        DAMPED: Damped least squares with restarts: for every problem, and the only one
            that heeds priorities.
        TWO_BONE: The closed form of a limb of two bones; damped steps where the elbow's
            limits stop it.
        GRADIENT: Steepest descent with backtracking.
        NEWTON: Newton's method, with second derivatives of positions and orientations,
            in a region of trust.
        CCD: Cyclic coordinate descent, joint by joint.
        FABRIK: Points drawn to their targets bone by bone, which the joints follow;
            positions only.

    The last four are for comparison: from the start only, without restarts, one step
    or sweep an iteration.
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
    """How to solve.

    Attributes:
        method: ``auto`` takes a closed form where the problem has one, else damped
            least squares; see `IkMethod`.
        tolerance: A position is reached within this share of the problem's length.
        angle_tolerance: An orientation, aim or pole is reached within this [rad].
        iterations: Most steps for one problem, restarts included.
        restarts: Most new starts where damped steps end short of the goals.
        seed: Of the new starts; the same seed gives the same poses.
        seconds: Most time for one problem [s]; 0 is no bound. With a bound, what is
            found depends on the machine.
        ordered: The problems are frames of a clip. One that ends as far from its goals
            as the one before it is not searched all over again.
        warm: They also start where the one before ended, but for the first.
        near: Poses that came of new starts are then drawn to those preferred, while
            goals stay met; that takes longer than finding them.
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
    """How to bring a take to targets.

    Attributes:
        seconds: Most time for one frame [s]; 0 is no bound.
        smooth: Time over which motion that the goals leave free is evened out [s]; 0
            leaves it.
    """

    method: IkMethod = option(
        IkMethod.AUTO,
        "name",
        choices=tuple(IkMethod),
        help="The solver.",
        written=IkMethod.AUTO.value,
    )
    tolerance: float = option(
        parse_length(LENGTH_TOLERANCE),
        "length",
        help="Position tolerance.",
        written=LENGTH_TOLERANCE,
    )
    angle_tolerance: float = option(
        math.radians(ANGLE_TOLERANCE),
        "angle",
        help="Tolerance of orientations, aims and poles.",
        written=ANGLE_TOLERANCE,
    )
    restarts: int = option(
        50,
        "count",
        help="Limit of restarts for a frame that does not reach its goals.",
    )
    seed: int = option(
        0,
        "seed",
        help="Seed of the restarts: the same seed gives the same poses.",
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
