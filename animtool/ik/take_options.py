"""How takes are brought to targets."""

from __future__ import annotations

import math
from dataclasses import dataclass

from animtool.errors import Fault, OptionError
from animtool.ik.methods import IkMethod
from animtool.ik.problem import rest_faults
from animtool.ik.smoothing import rate_faults
from animtool.ik.solving import IkOptions, option_faults


@dataclass(frozen=True, slots=True)
class TakeOptions:
    """How to bring a take to targets.

    Attributes:
        method: Which solver.
        tolerance: A position is reached within this [m].
        angle_tolerance: An orientation, aim or pole is reached within this [rad].
        restarts: Most new starts of a frame that does not reach its goals.
        seed: Of the new starts.
        seconds: Most time for one frame [s]; 0 is no bound.
        joints: Names or patterns of the joints that may move; none is every one that
            moves a goal.
        rest_weight: How strongly the pose that a frame has already is kept.
        smooth: Time over which motion that the goals leave free is evened out [s]; 0
            leaves it.
    """

    method: IkMethod = IkMethod.AUTO
    tolerance: float = 1e-6
    angle_tolerance: float = math.radians(1e-4)
    restarts: int = 50
    seed: int = 0
    seconds: float = 0.0
    joints: tuple[str, ...] = ()
    rest_weight: float = 0.0
    smooth: float = 0.0


def take_option_faults(options: TakeOptions) -> dict[str, list[Fault]]:
    """Return what makes no sense for any take, by option.

    >>> faults = take_option_faults(TakeOptions(seed=-1, smooth=-0.1))
    >>> [name for name, found in faults.items() if found]
    ['seed', 'smooth']
    """
    solving = IkOptions(
        tolerance=options.tolerance,
        angle_tolerance=options.angle_tolerance,
        restarts=options.restarts,
        seed=options.seed,
        seconds=options.seconds,
    )
    return {
        **option_faults(solving),
        "rest_weight": rest_faults(options.rest_weight),
        "smooth": rate_faults(options.smooth, 1.0),
    }


def check_options(options: TakeOptions) -> None:
    """Refuse options that make no sense.

    Raises:
        OptionError: With every fault (IK002, IK014).
    """
    faults = [
        fault for found in take_option_faults(options).values() for fault in found
    ]
    if faults:
        raise OptionError(faults)
