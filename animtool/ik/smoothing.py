"""Whole clips made smoother, while their goals stay as they are and limits kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from animtool._types import ArrayLike, FloatArray
from animtool.errors import Fault, OptionError
from animtool.ik.goals import Targets, by_unit
from animtool.ik.path import Path, path_of
from animtool.ik.result import IkResult, IkStatus
from animtool.ik.solving import IkOptions


def smooth(
    result: IkResult,
    targets: Targets,
    seconds: float,
    *,
    fps: float,
    start: ArrayLike | None = None,
    options: IkOptions | None = None,
) -> IkResult:
    """Return the poses of a clip with less acceleration of the joints.

    Over all frames at once, the sum of ``|q - q0|^2 + seconds^4 |q''|^2`` is brought
    down, where q0 are the poses given: what the goals leave free and changes within
    less than ``seconds`` is evened out, a slower motion stays (the smoothing of
    E. Whittaker, On a new method of graduation, 1923, with second derivatives). Goals
    that are reached stay within the tolerance; in frames that miss one, all goals stay
    where these have them. Limits are kept.

    Args:
        result: F frames of one problem, in the order of time.
        targets: What was asked.
        seconds: Time over which motion is evened out [s]; 0 changes nothing, and .03
            to .3 serve most clips.
        fps: Frames a second.
        start: Poses ``(F, Q)`` of a clip whose own acceleration is kept; only that of
            the change from it is brought down.
        options: Tolerances.

    Raises:
        OptionError: ``seconds`` is less than 0 or ``fps`` not more than 0 (IK014);
            targets or start do not fit (IK010 to IK013).

    Limits of the method: the poses are the least near by; where a path has to turn
    from one way round to another, the turn stays. A goal that jumps makes joints jump.
    It holds the Jacobians of all frames, F M D numbers.
    """
    options = options or IkOptions()
    faults = rate_faults(seconds, fps)
    if faults:
        raise OptionError(faults)
    if seconds == 0 or len(result.coordinates) < 3:
        return result
    path = path_of(result.problem, targets, start, options)
    poses = result.problem.chain.from_rig(result.coordinates)
    poses, misses = path.smoothed(poses, (seconds * fps) ** 4)
    return at_poses(result, poses, misses, path)


def rate_faults(seconds: float, fps: float) -> list[Fault]:
    """Return what is wrong with a time to smooth over, and a rate."""
    faults = []
    if not (np.isfinite(seconds) and seconds >= 0):
        faults.append(Fault("IK014", f"smooth must be at least 0, not {seconds}"))
    if not (np.isfinite(fps) and fps > 0):
        faults.append(Fault("IK014", f"fps must be more than 0, not {fps}"))
    return faults


def at_poses(
    result: IkResult, poses: FloatArray, misses: FloatArray, path: Path
) -> IkResult:
    """Return a result with other poses of the chain ``(F, C)``."""
    chain = result.problem.chain
    met = path.excess(misses) <= 1
    statuses = tuple(
        IkStatus.CONVERGED
        if good
        else IkStatus.NEAREST
        if status is IkStatus.CONVERGED
        else status
        for good, status in zip(met, result.statuses, strict=True)
    )
    return replace(
        result,
        coordinates=chain.into_rig(poses, result.coordinates),
        statuses=statuses,
        misses=misses * by_unit(chain.length, 1.0),
        reached=path.excesses(misses) <= 1,
    )
